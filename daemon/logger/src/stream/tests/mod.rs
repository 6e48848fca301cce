//! Both ends together: by hand for what is worth reading, and by the thousand with a transport that loses, repeats
//! and reorders while either end is started anew.

mod admission;
mod disturbed;
mod lane;
mod limits;

use peernet_clock::{ClockIdentity, MonoTime, Span, Stamp, WallTime};

use super::*;
use crate::HostId;

fn host(id: HostId, name: &str) -> HostDescription {
    HostDescription {
        id,
        name: name.parse().expect("a name"),
        clock: ClockIdentity::new("boot", "system"),
        version: "0.1.0".into(),
        hardware: Hardware::default(),
        serves: None,
        models: Vec::new(),
    }
}

fn at(millis: i64) -> Stamp {
    let span = Span::from_millis(millis);
    Stamp { wall: WallTime::from_unix_nanos(0) + span, mono: MonoTime::from_nanos(0) + span }
}

fn incident(text: &str) -> Event {
    Event::Incident(Incident {
        at: WallTime::from_unix_nanos(0),
        kind: IncidentKind::Control,
        pipeline: None,
        run: None,
        peer: None,
        text: text.into(),
    })
}

/// Small limits, so that a few events reach all of them.
fn config() -> SendingConfig {
    SendingConfig { batch_nodes: 3, window: 3, reserve_events: 2, ..SendingConfig::default() }
}

fn receiving() -> Receiving {
    Receiving::new(ReceivingConfig::new("base".parse().expect("a name")))
}

/// Everything that is to be sent now.
fn frames<S: Spool>(sending: &mut Sending<S>, now: Stamp) -> Vec<ToAggregator> {
    std::iter::from_fn(|| sending.transmit(now.mono).expect("the spool is in memory"))
        .map(|frame| codec::decode(&frame).expect("our own frame"))
        .collect()
}

/// Numbers of the batches among messages.
fn numbers(messages: &[ToAggregator]) -> Vec<u64> {
    let number = |message: &ToAggregator| match message {
        ToAggregator::Batch(batch) => Some(batch.number),
        _ => None,
    };
    messages.iter().filter_map(number).collect()
}
