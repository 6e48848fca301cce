//! A full spool: what is dropped, how it is counted, where the gap stands.

use super::*;
use crate::{Anchor, Measure, Name, NodeId, RunId, Slug, Tree, Unit, stage};

fn tree() -> Tree {
    Tree::new(stage::ITERATION, Anchor { host: HostId::random(), wall: WallTime::from_unix_nanos(0) })
}

fn iteration(run: RunId, number: u64, tree: Tree) -> Event {
    let outcome = Outcome::Ok;
    Event::Iteration(Iteration { run, number, episode: 0, step: 0, warm_up: false, outcome, tree })
}

fn started(run: RunId) -> Event {
    Event::RunStarted(RunDescription {
        run,
        pipeline: "line".parse().expect("a name"),
        started: WallTime::from_unix_nanos(0),
        placement: Placement {
            kind: PlacementKind::Local,
            peer: None,
            network: None,
            address: None,
            model: "echo".parse().expect("a name"),
            device: None,
        },
        facts: Vec::new(),
        configuration: String::new(),
        version: "0.1.0".into(),
    })
}

fn of(most: u64) -> Sending<MemorySpool> {
    let spool = MemorySpool::new(Usage { events: most, bytes: 1_000_000 });
    Sending::new(config(), host(HostId::random(), "edge"), 7, spool)
}

/// The events of everything that can be sent, acknowledged on the way.
fn drain(sending: &mut Sending<MemorySpool>, now: i64) -> Vec<Event> {
    sending.flush(at(now).wall);
    sending.connected(at(now).mono);
    let stream = sending.spool().stream();
    let (aggregator, stored) = ("base".parse().expect("a name"), sending.spool().oldest() - 1);
    sending.transmit(at(now).mono).expect("memory");
    let welcome = ToAgent::Welcome { aggregator, stream, stored };
    sending.received(&welcome, at(now)).expect("memory");
    let mut events = Vec::new();
    loop {
        let messages = frames(sending, at(now));
        let Some(through) = numbers(&messages).last().copied() else { return events };
        for message in messages {
            let ToAggregator::Batch(batch) = message else { continue };
            events.extend(batch.events);
        }
        sending.received(&ToAgent::Ack { stream, through }, at(now)).expect("memory");
        sending.flush(at(now).wall);
    }
}

#[test]
fn the_newest_iterations_are_dropped_and_a_gap_names_their_pipeline_and_run() {
    let (mut sending, run) = (of(10), RunId::random());
    sending.offer(&started(run), at(0));
    for number in 1..=20 {
        sending.offer(&iteration(run, number, tree()), at(number as i64));
    }
    let before = sending.accounting();
    assert_eq!((before.offered, before.waiting, before.dropped), (21, 8, 13));

    let events = drain(&mut sending, 100);
    assert!(matches!(events[0], Event::RunStarted(_)));
    let kept: Vec<u64> = events
        .iter()
        .filter_map(|event| if let Event::Iteration(it) = event { Some(it.number) } else { None })
        .collect();
    assert_eq!(kept, [1, 2, 3, 4, 5, 6, 7]);
    let Some(Event::Gap(gap)) = events.last() else { panic!("a gap at the end: {events:?}") };
    assert_eq!((gap.count, gap.run, gap.pipeline.as_ref().map(Slug::as_str)), (13, Some(run), Some("line")));
    assert_eq!((gap.from, gap.to), (at(8).wall, at(20).wall));

    let after = sending.accounting();
    assert_eq!((after.offered, after.stored, after.waiting, after.dropped), (22, 9, 0, 13));
}

#[test]
fn a_run_can_still_be_ended_when_iterations_no_longer_fit() {
    let (mut sending, run) = (of(10), RunId::random());
    (1..=20).for_each(|number| sending.offer(&iteration(run, number, tree()), at(0)));
    let dropped = sending.accounting().dropped;
    let ended = RunEnded { run, ended: at(1).wall, reason: "finished".into() };
    sending.offer(&Event::RunEnded(ended), at(1));
    assert_eq!(sending.accounting().dropped, dropped);
    let events = drain(&mut sending, 2);
    // The gap stands where the iterations would have stood: before the end of their run.
    assert!(matches!(events[events.len() - 2..], [Event::Gap(_), Event::RunEnded(_)]));
}

#[test]
fn what_the_aggregator_would_refuse_is_not_sent_and_holds_up_nothing() {
    let (mut sending, run) = (of(100), RunId::random());
    let mut broken = tree();
    let node = broken.add(NodeId::ROOT, Name::from("x"), Span::ZERO, Measure::Value(1.0, Unit::NONE));
    *broken.measure_mut(node).expect("added") = Measure::Value(f64::NAN, Unit::NONE);
    sending.offer(&iteration(run, 1, broken), at(0));
    sending.offer(&iteration(run, 2, tree()), at(1));
    let events = drain(&mut sending, 2);
    let [Event::Gap(gap), Event::Iteration(kept)] = &events[..] else { panic!("{events:?}") };
    assert_eq!((gap.count, kept.number), (1, 2));
    assert!(gap.reason.contains("not a number"), "{}", gap.reason);
}

#[test]
fn a_loss_that_goes_on_is_reported_once_a_second_and_before_its_run_ends() {
    let (mut sending, run) = (of(10_000), RunId::random());
    let mut broken = tree();
    let node = broken.add(NodeId::ROOT, Name::from("x"), Span::ZERO, Measure::Value(1.0, Unit::NONE));
    *broken.measure_mut(node).expect("added") = Measure::Value(f64::NAN, Unit::NONE);
    sending.offer(&started(run), at(0));
    for n in 0..1_500 {
        sending.offer(&iteration(run, 2 * n, broken.clone()), at(2 * n as i64));
        sending.offer(&iteration(run, 2 * n + 1, tree()), at(2 * n as i64 + 1));
    }
    let ended = RunEnded { run, ended: at(3_000).wall, reason: "finished".into() };
    sending.offer(&Event::RunEnded(ended), at(3_000));
    let before = sending.accounting();
    assert_eq!((before.dropped, before.offered), (1_500, before.waiting + before.dropped));
    let events = drain(&mut sending, 4_000);
    let counts =
        events.iter().filter_map(|event| if let Event::Gap(gap) = event { Some(gap.count) } else { None });
    assert_eq!(counts.collect::<Vec<_>>(), [1, 500, 500, 499]);
    assert!(matches!(events[events.len() - 2..], [Event::Gap(_), Event::RunEnded(_)]));
}
