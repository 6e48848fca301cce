//! Tests of a stopping host: the live state is the same in whatever order the last events arrive.

use super::*;

/// Returns an update with this state of the pipeline and `waiting` events in the spool.
fn update_in_state(testbed: &Testbed, at: f64, state: PipelineState, waiting: u64) -> LiveEvent {
    let live = PipelineLive { state, ..pipeline("line", vec![]) };
    let accounting = Accounting { produced: 100, stored: 100 - waiting, waiting, ..Accounting::default() };
    with_accounting(update(testbed.host, wall(at), vec![live]), accounting)
}

/// Returns whether the host is connected, whether it left cleanly, and the state of its only pipeline.
fn departure_state(testbed: &mut Testbed, at: f64) -> (bool, bool, PipelineState) {
    let snapshot = testbed.snapshot(at);
    (snapshot.hosts[0].connected, snapshot.hosts[0].has_left, snapshot.pipelines[0].state.clone())
}

/// [`departure_state`] of a host that stopped cleanly.
const LEFT_CLEANLY: (bool, bool, PipelineState) = (false, true, PipelineState::Finished);
/// [`departure_state`] of a host that became silent.
const AWAY: (bool, bool, PipelineState) = (false, false, PipelineState::Away);

#[test]
fn host_leaves_cleanly_before_or_after_last_commit() {
    for stored_first in [true, false] {
        let mut testbed = Testbed::new();
        testbed.live.apply(update_in_state(&testbed, 1.0, PipelineState::Running, 41), now(1.0));
        let stored = StoredCounts { events: 100, ..StoredCounts::default() };
        let commit = LiveEvent::Stored(testbed.host, stored, Some(wall(1.2)));
        let last_update = update_in_state(&testbed, 1.2, PipelineState::Finished, 0);
        let goodbye = LiveEvent::Goodbye(testbed.host);
        let order =
            if stored_first { [commit, last_update, goodbye] } else { [last_update, goodbye, commit] };
        for event in order {
            assert!(testbed.live.apply(event, now(1.2)));
        }
        assert_eq!(departure_state(&mut testbed, 1.2), LEFT_CLEANLY);
        testbed.live.expire(now(60.0));
        assert_eq!(departure_state(&mut testbed, 60.0), LEFT_CLEANLY, "the state does not change with time");
        let host = &testbed.snapshot(60.0).hosts[0];
        assert_eq!((host.accounting.waiting, host.behind), (0, None));
    }
}

#[test]
fn goodbye_finishes_pipelines_also_after_silence() {
    for silent in [false, true] {
        let mut testbed = Testbed::new();
        testbed.live.apply(update_in_state(&testbed, 1.0, PipelineState::Running, 0), now(1.0));
        if silent {
            testbed.live.expire(now(9.0));
            assert_eq!(departure_state(&mut testbed, 9.0), AWAY);
        }
        testbed.live.apply(LiveEvent::Goodbye(testbed.host), now(10.0));
        assert_eq!(departure_state(&mut testbed, 10.0), LEFT_CLEANLY);
        if !silent {
            testbed.live.expire(now(19.0));
            assert_eq!(departure_state(&mut testbed, 19.0), LEFT_CLEANLY);
        }
    }
}

#[test]
fn goodbye_keeps_failed_state() {
    let mut testbed = Testbed::new();
    let failed = PipelineState::Failed("no pictures".to_owned());
    testbed.live.apply(update_in_state(&testbed, 1.0, failed.clone(), 0), now(1.0));
    testbed.live.apply(LiveEvent::Goodbye(testbed.host), now(1.1));
    assert_eq!(departure_state(&mut testbed, 1.1), (false, true, failed));
}

#[test]
fn host_with_waiting_events_does_not_leave_cleanly() {
    let mut testbed = Testbed::new();
    testbed.live.apply(update_in_state(&testbed, 1.0, PipelineState::Finished, 41), now(1.0));
    testbed.live.apply(LiveEvent::Goodbye(testbed.host), now(1.1));
    assert_eq!(departure_state(&mut testbed, 1.1), (false, false, PipelineState::Finished));
}

#[test]
fn new_process_keeps_previous_state_of_host() {
    let mut testbed = Testbed::new();
    let hello = |testbed: &mut Testbed, process, at| {
        testbed.live.apply(LiveEvent::Hello(Box::new(description(testbed.host, "edge")), process), now(at));
    };
    testbed.live.apply(update_in_state(&testbed, 1.0, PipelineState::Finished, 0), now(1.0));
    testbed.live.apply(LiveEvent::Goodbye(testbed.host), now(1.1));
    hello(&mut testbed, 2, 2.0);
    assert_eq!(departure_state(&mut testbed, 2.0), LEFT_CLEANLY);
    testbed.live.apply(update_in_state(&testbed, 2.1, PipelineState::Running, 0), now(2.1));
    assert_eq!(departure_state(&mut testbed, 2.1), (true, false, PipelineState::Running));
    // The second process crashes; the third runs no pipeline and says goodbye.
    hello(&mut testbed, 3, 3.0);
    assert_eq!(departure_state(&mut testbed, 3.0), AWAY);
    testbed.live.apply(LiveEvent::Goodbye(testbed.host), now(3.1));
    assert_eq!(departure_state(&mut testbed, 3.1).2, PipelineState::Away);
}
