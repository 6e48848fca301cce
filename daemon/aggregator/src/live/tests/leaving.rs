//! Tests of a stopping host: the picture is the same in whatever order the last events arrive.

use super::*;

/// Returns an update with this state of the pipeline and `waiting` events in the spool.
fn told(bed: &Bed, at: f64, state: PipelineState, waiting: u64) -> News {
    let line = PipelineLive { state, ..pipeline("line", vec![]) };
    let accounting = Accounting { produced: 100, stored: 100 - waiting, waiting, ..Accounting::default() };
    with(update(bed.host, wall(at), vec![line]), accounting)
}

/// Returns whether the host is connected, whether it left in order, and the state of its only pipeline.
fn standing(bed: &mut Bed, at: f64) -> (bool, bool, PipelineState) {
    let picture = bed.picture(at);
    (picture.hosts[0].connected, picture.hosts[0].left, picture.pipelines[0].state.clone())
}

/// [`standing`] of a host that stopped in order.
const GONE_WELL: (bool, bool, PipelineState) = (false, true, PipelineState::Finished);
/// [`standing`] of a host that became silent.
const AWAY: (bool, bool, PipelineState) = (false, false, PipelineState::Away);

#[test]
fn a_host_that_took_its_leave_is_not_away_however_late_its_last_batches_are_stored() {
    for stored_first in [true, false] {
        let mut bed = Bed::new();
        bed.live.take(told(&bed, 1.0, PipelineState::Running, 41), now(1.0));
        let stored = Stored { events: 100, ..Stored::default() };
        let durable = News::Stored(bed.host, stored, Some(wall(1.2)));
        let live = told(&bed, 1.2, PipelineState::Finished, 0);
        let goodbye = News::Goodbye(bed.host);
        let order = if stored_first { [durable, live, goodbye] } else { [live, goodbye, durable] };
        for news in order {
            assert!(bed.live.take(news, now(1.2)));
        }
        assert_eq!(standing(&mut bed, 1.2), GONE_WELL);
        bed.live.age(now(60.0));
        assert_eq!(standing(&mut bed, 60.0), GONE_WELL, "time does not make it away");
        let host = &bed.picture(60.0).hosts[0];
        assert_eq!((host.accounting.waiting, host.behind), (0, None));
    }
}

#[test]
fn a_goodbye_ends_what_its_host_last_told_of_before_the_silence_or_after_it() {
    for silent in [false, true] {
        let mut bed = Bed::new();
        bed.live.take(told(&bed, 1.0, PipelineState::Running, 0), now(1.0));
        if silent {
            bed.live.age(now(9.0));
            assert_eq!(standing(&mut bed, 9.0), AWAY);
        }
        bed.live.take(News::Goodbye(bed.host), now(10.0));
        assert_eq!(standing(&mut bed, 10.0), GONE_WELL);
        if !silent {
            bed.live.age(now(19.0));
            assert_eq!(standing(&mut bed, 19.0), GONE_WELL);
        }
    }
}

#[test]
fn a_failure_stays_a_failure() {
    let mut bed = Bed::new();
    let failed = PipelineState::Failed("no pictures".to_owned());
    bed.live.take(told(&bed, 1.0, failed.clone(), 0), now(1.0));
    bed.live.take(News::Goodbye(bed.host), now(1.1));
    assert_eq!(standing(&mut bed, 1.1), (false, true, failed));
}

#[test]
fn a_host_that_left_with_events_in_its_spool_is_to_be_looked_at() {
    let mut bed = Bed::new();
    bed.live.take(told(&bed, 1.0, PipelineState::Finished, 41), now(1.0));
    bed.live.take(News::Goodbye(bed.host), now(1.1));
    assert_eq!(standing(&mut bed, 1.1), (false, false, PipelineState::Finished));
}

#[test]
fn the_next_process_of_a_host_finds_it_as_it_was_left_and_does_not_answer_for_one_that_crashed() {
    let mut bed = Bed::new();
    let hello = |bed: &mut Bed, process, at| {
        bed.live.take(News::Hello(Box::new(description(bed.host, "edge")), process), now(at));
    };
    bed.live.take(told(&bed, 1.0, PipelineState::Finished, 0), now(1.0));
    bed.live.take(News::Goodbye(bed.host), now(1.1));
    hello(&mut bed, 2, 2.0);
    assert_eq!(standing(&mut bed, 2.0), GONE_WELL);
    bed.live.take(told(&bed, 2.1, PipelineState::Running, 0), now(2.1));
    assert_eq!(standing(&mut bed, 2.1), (true, false, PipelineState::Running));
    // The second process crashes; the third runs no pipeline and says goodbye.
    hello(&mut bed, 3, 3.0);
    assert_eq!(standing(&mut bed, 3.0), AWAY);
    bed.live.take(News::Goodbye(bed.host), now(3.1));
    assert_eq!(standing(&mut bed, 3.1).2, PipelineState::Away);
}
