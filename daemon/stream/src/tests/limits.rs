//! Dropped events of runs: their counts, and the places of the gaps.

use super::super::EndReason;
use super::simulation::Simulation;
use super::*;
use peernet_logger::{Anchor, Measure, Name, NodeId, RunId, Slug, Tree, Unit, stage};

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
        experiment: None,
        conditions: Vec::new(),
    })
}

/// Returns a simulation in which `events` events fit into memory, with a disk that has not performed any action yet.
fn simulation_with_memory_for(events: u64) -> Simulation {
    let capacity = 100;
    Simulation::new(SendingConfig { memory: Usage { events, bytes: 1_000_000 }, ..roomy_config() }, capacity)
}

/// Returns the default configuration with a reserve of 2 events.
fn roomy_config() -> SendingConfig {
    SendingConfig { reserve_events: 2, ..SendingConfig::default() }
}

fn offer(simulation: &mut Simulation, event: &Event, now: i64) {
    simulation.now = now;
    simulation.agent(|sending, now| sending.offer(event, now));
}

/// Returns all events that are stored in the end.
fn drain(simulation: &mut Simulation) -> Vec<Event> {
    simulation.settle();
    // Some losses are reported only after the first call has freed space.
    simulation.settle();
    let bodies = simulation.expected_content.bodies.iter();
    bodies
        .flat_map(|(count, body)| codec::decode_events(body, *count).expect("stored events are readable"))
        .collect()
}

#[test]
fn newest_iterations_are_dropped_and_gap_names_their_pipeline_and_run() {
    let (mut simulation, run) = (simulation_with_memory_for(10), RunId::random());
    offer(&mut simulation, &started(run), 0);
    for number in 1..=20 {
        offer(&mut simulation, &iteration(run, number, tree()), number as i64);
    }
    let before = simulation.sending.accounting();
    // The start and seven iterations wait. Two of the ten places are reserved for events other than iterations.
    assert_eq!((before.produced, before.waiting, before.dropped), (21, 8, 13));

    let events = drain(&mut simulation);
    assert!(matches!(events[0], Event::RunStarted(_)));
    let stored_numbers: Vec<u64> = events
        .iter()
        .filter_map(
            |event| if let Event::Iteration(iteration) = event { Some(iteration.number) } else { None },
        )
        .collect();
    assert_eq!(stored_numbers, [1, 2, 3, 4, 5, 6, 7]);
    let Some(Event::Gap(gap)) = events.last() else { panic!("expected a gap at the end: {events:?}") };
    assert_eq!((gap.count, gap.run, gap.pipeline.as_ref().map(Slug::as_str)), (13, Some(run), Some("line")));
    assert_eq!((gap.from, gap.to), (at(8).wall, at(20).wall));

    let after = simulation.sending.accounting();
    assert_eq!((after.produced, after.stored, after.waiting, after.dropped), (22, 9, 0, 13));
}

#[test]
fn end_of_run_is_stored_although_its_iterations_are_dropped() {
    let (mut simulation, run) = (simulation_with_memory_for(10), RunId::random());
    (1..=20).for_each(|number| offer(&mut simulation, &iteration(run, number, tree()), 0));
    let dropped = simulation.sending.accounting().dropped;
    let ended = RunEnded { run, ended: at(1).wall, reason: EndReason::Finished };
    offer(&mut simulation, &Event::RunEnded(ended), 1);
    assert_eq!(simulation.sending.accounting().dropped, dropped);
    let events = drain(&mut simulation);
    // The gap is in the place of the iterations: before the end of their run.
    assert!(matches!(events[events.len() - 2..], [Event::Gap(_), Event::RunEnded(_)]));
}

#[test]
fn invalid_event_is_not_sent_and_blocks_no_other_event() {
    let (mut simulation, run) = (simulation_with_memory_for(100), RunId::random());
    let mut invalid_tree = tree();
    let node = invalid_tree.add(NodeId::ROOT, Name::from("x"), Span::ZERO, Measure::Value(1.0, Unit::NONE));
    *invalid_tree.measure_mut(node).expect("the node was added") = Measure::Value(f64::NAN, Unit::NONE);
    offer(&mut simulation, &iteration(run, 1, invalid_tree), 0);
    offer(&mut simulation, &iteration(run, 2, tree()), 1);
    let events = drain(&mut simulation);
    let [Event::Gap(gap), Event::Iteration(stored)] = &events[..] else { panic!("{events:?}") };
    assert_eq!((gap.count, stored.number), (1, 2));
    assert!(gap.reason.contains("not a number"), "{}", gap.reason);
}

#[test]
fn continuing_loss_is_reported_each_second_and_at_end() {
    let (mut simulation, run) = (simulation_with_memory_for(10_000), RunId::random());
    let mut invalid_tree = tree();
    let node = invalid_tree.add(NodeId::ROOT, Name::from("x"), Span::ZERO, Measure::Value(1.0, Unit::NONE));
    *invalid_tree.measure_mut(node).expect("the node was added") = Measure::Value(f64::NAN, Unit::NONE);
    offer(&mut simulation, &started(run), 0);
    for n in 0..1_500 {
        offer(&mut simulation, &iteration(run, 2 * n, invalid_tree.clone()), 2 * n as i64);
        offer(&mut simulation, &iteration(run, 2 * n + 1, tree()), 2 * n as i64 + 1);
    }
    let ended = RunEnded { run, ended: at(3_000).wall, reason: EndReason::Finished };
    offer(&mut simulation, &Event::RunEnded(ended), 3_000);
    let before = simulation.sending.accounting();
    assert_eq!((before.dropped, before.produced), (1_500, before.waiting + before.dropped));
    let events = drain(&mut simulation);
    let counts =
        events.iter().filter_map(|event| if let Event::Gap(gap) = event { Some(gap.count) } else { None });
    // The first dropped event is reported at once, then a gap reports each second. The end of the run reports the rest.
    assert_eq!(counts.collect::<Vec<_>>(), [1, 500, 500, 499]);
    assert!(matches!(events[events.len() - 2..], [Event::Gap(_), Event::RunEnded(_)]));
}
