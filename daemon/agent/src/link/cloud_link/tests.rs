//! Tests of the seconds in which the delays of a link count.

use peernet_clock::{Clock, ManualClock, SharedClock, WallTime};
use peernet_stream::Hardware;

use super::super::shared::{LinkContext, ProbeSettings};
use super::*;
use crate::config::AgentConfig;
use crate::event_queue::{self, EventCounter, QueueReceiver};
use crate::incidents::Incidents;

/// Returns a link without sessions, and the queue of its clock samples.
fn link(clock: &SharedClock) -> (CloudLink, QueueReceiver) {
    let (event_queue, receiver) = event_queue::channel(Arc::clone(clock), EventCounter::default());
    let (_announcements, host_clock) = watch::channel(PeerClock::default());
    let host = LinkContext {
        name: "edge".parse().expect("a name"),
        clock: Arc::clone(clock),
        host_clock,
        event_queue: event_queue.clone(),
        incidents: Incidents::new(Arc::clone(clock), event_queue),
    };
    let AgentConfig { clock: clock_config, probes, .. } = AgentConfig::default();
    let probes = ProbeSettings::read(&probes, &clock_config).expect("no key is needed");
    let shared = SharedLinkState { host, relation: clock_config.relation_settings(), probes };
    let accepted = SessionAccepted {
        host: HostId::random(),
        name: "cloud".parse().expect("a name"),
        clock: ClockIdentity::new("other boot", "system"),
        version: "0.0.0".to_owned(),
        model: Slug::any(),
        device: "cpu".to_owned(),
        facts: Vec::new(),
        host_clock: PeerClock::default(),
        probes: None,
        instance: 1,
        probe_key: None,
        conditions: Vec::new(),
        hardware: Hardware::default(),
    };
    (CloudLink::new(&Arc::new(shared), &accepted, RelatedClocks::Raw), receiver)
}

#[test]
fn delay_judged_after_its_second_counts_in_current_second() {
    let identity = ClockIdentity::new("boot", "system");
    let clock = Arc::new(ManualClock::new(WallTime::from_unix_nanos(900_000_000), identity));
    let shared_clock: SharedClock = Arc::<ManualClock>::clone(&clock);
    let (link, mut receiver) = link(&shared_clock);
    let arrived = clock.stamp();
    clock.advance(Span::from_millis(200));
    // The task of the link closes the second before the pipeline handles the answer.
    link.advance_second();
    let message_delay = MessageDelay { raw: Span::ZERO, bits: None };
    let (_, changes) = link.judge(&NetworkName::default(), None, [message_delay; 2], arrived);
    link.report(changes);
    clock.advance(Span::from_seconds(1));
    link.advance_second();
    let event = receiver.queue.try_recv().expect("a second with a delay was closed");
    let Event::Clock(sample) = event else { panic!("{event:?}") };
    assert_eq!(
        (sample.at, sample.up.map(|up| up.count)),
        (WallTime::from_unix_nanos(2_000_000_000), Some(1))
    );
}
