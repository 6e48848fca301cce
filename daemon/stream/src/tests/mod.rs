//! Tests of both ends: each end alone with readable examples, both together with generated faults in a [`simulation`],
//! and exhaustively on a small model.

mod admission;
mod challenges;
mod disturbed;
mod exhaustive;
mod limits;
mod progress;
mod random;
mod simulation;
mod versions;

pub(super) use self::admission::hello;

use peernet_clock::{ClockIdentity, MonoTime, Span, Stamp, WallTime};

use super::*;
use peernet_logger::HostId;

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
    Stamp::default() + Span::from_millis(millis)
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

fn receiving() -> Receiving {
    Receiving::new(ReceivingConfig::new("base".parse().expect("a name")))
}
