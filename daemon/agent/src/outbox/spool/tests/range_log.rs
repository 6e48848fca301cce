//! Tests of the log lines about iterations in the spool.

use peernet_clock::Stamp;
use peernet_logger::{Recorder, RunId};
use peernet_stream::{
    Action, Event, HostDescription, Iteration, Outcome, Sending, SendingConfig, SpoolState,
};

use super::super::range_log::iteration_ranges;
use super::*;
use crate::telemetry;

fn iteration(clock: &SharedClock, run: RunId, number: u64) -> Event {
    let tree = Recorder::new(SharedClock::clone(clock), host()).finish();
    Event::Iteration(Iteration {
        run,
        number,
        episode: 0,
        step: 0,
        warm_up: false,
        outcome: Outcome::Ok,
        tree,
    })
}

/// Returns the batch that the state machine makes of these events.
pub(super) fn batch(clock: &SharedClock, state: SpoolState, events: &[Event]) -> SpooledBatch {
    let description = HostDescription {
        id: host(),
        name: "edge".parse().expect("a name"),
        clock: clock.identity().clone(),
        version: "1".to_owned(),
        hardware: telemetry::hardware(),
        serves: None,
        models: Vec::new(),
    };
    let (secret, process) = (peernet_stream::HostSecret::random(), 1);
    let mut state_machine = Sending::new(SendingConfig::default(), description, secret, process, state);
    let now: Stamp = clock.stamp();
    events.iter().for_each(|event| state_machine.offer(event, now));
    state_machine.flush(now.wall);
    match state_machine.next(now.mono) {
        Some(Action::Append { mut batches, .. }) if batches.len() == 1 => batches.remove(0),
        action => panic!("{action:?}"),
    }
}

#[tokio::test]
async fn consecutive_iterations_of_run_are_one_range() {
    let (clock, spool_folder) = (clock(), SpoolFolder::new());
    let (_, state) = spool_folder.open_undamaged().await;
    let mut runs = [RunId::random(), RunId::random()];
    runs.sort();
    let [first, second] = runs;
    // Iterations in flight end in any order, and some iterations are not in the batch.
    let iterations = [(second, 7), (first, 4), (first, 2), (second, 6), (first, 3), (first, 9)];
    let events: Vec<Event> =
        iterations.iter().map(|(run, number)| iteration(&clock, *run, *number)).collect();
    let batch = batch(&clock, state, &events);
    assert_eq!(iteration_ranges(&batch), [(first, 2, 4), (first, 9, 9), (second, 6, 7)]);
    let undecodable = SpooledBatch { events: 99, ..batch };
    assert!(iteration_ranges(&undecodable).is_empty(), "a batch that cannot be decoded has no ranges");
}
