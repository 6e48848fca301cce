//! Tests of the seconds in which the delays of a link count.

use peernet_clock::{Clock, Exchange, ManualClock, SharedClock, WallTime};
use peernet_logger::{Name, stage};
use peernet_networks::{FIRST_PART_DOWNLOAD, RequestError};
use peernet_stream::Hardware;

use super::super::shared::{LinkContext, ProbeSettings};
use super::super::transit_stamps::HostStamp;
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

/// A message takes 1 ms to the cloud, the first partial answer 1 ms and the final answer 20 ms back. The estimate of the
/// offset is therefore wrong by 9.5 ms.
#[test]
fn delay_of_first_partial_answer_is_not_negative() {
    let identity = ClockIdentity::new("boot", "system");
    let clock = Arc::new(ManualClock::new(WallTime::from_unix_nanos(100_000_000), identity));
    let shared_clock: SharedClock = Arc::<ManualClock>::clone(&clock);
    let (link, _receiver) = link(&shared_clock);
    let start = clock.stamp();
    let after = |millis: i64| start + Span::from_millis(millis);
    let mut recorder = Recorder::new(Arc::clone(&shared_clock), HostId::random());
    // The clocks of both hosts agree.
    let mut add_transit = |name: Name, from: i64, to: i64| {
        let [sender, receiver] = [from, to].map(|millis| {
            let Stamp { wall, raw, .. } = after(millis);
            HostStamp { wall, raw, epoch: Some(0) }
        });
        let measure = Measure::Transit(Box::new(TransitStamps { sender, receiver }.transit(None)));
        recorder.tree_mut().add(NodeId::ROOT, name, Span::from_millis(from), measure)
    };
    let upload = add_transit(stage::UPLOAD, 0, 1);
    let first_partial_answer = add_transit(FIRST_PART_DOWNLOAD, 2, 3);
    let download = add_transit(stage::DOWNLOAD, 3, 23);
    clock.advance(Span::from_millis(23));
    let exchange = Exchange {
        sent: after(0).raw,
        received: after(1).raw,
        replied: after(3).raw,
        returned: after(23).raw,
        uncertainty: Span::ZERO,
    };
    let mut completed = CompletedRequest {
        recorder,
        result: Err(RequestError::Failed("the answer has no payload".to_owned())),
        arrived_at: Some(after(23)),
        upload: Some(upload),
        download: Some(download),
        first_partial_answer: Some(first_partial_answer),
        observation: Some(ExchangeObservation {
            exchange,
            cloud_elapsed: None,
            edge_epoch: 0,
            cloud_epoch: Some(0),
        }),
    };
    link.correct(&NetworkName::default(), &mut completed);
    let node = completed.recorder.tree().get(first_partial_answer).expect("it was added");
    let Measure::Transit(transit) = &node.measure else { panic!("{node:?}") };
    let delay = transit.delay.expect("it is judged");
    let bounds = delay.bounds.expect("the exchange bounds the offset");
    assert!(!bounds.lo.is_negative() && bounds.contains(Span::from_millis(1)), "{delay:?}");
    assert!(delay.value.is_some_and(|value| bounds.contains(value)), "{delay:?}");
}
