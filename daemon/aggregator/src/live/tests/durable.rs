//! Tests of the durable lane's effect on the live state: the durable lane changes only counts.

use super::super::MAX_HOSTS;
use super::*;
use crate::live_state::{RejectedBatches, Totals};

/// Applies 40 updates of a pipeline within ten seconds; with a `backlog`, also events of the durable lane between them.
fn state_after_updates(testbed: &mut Testbed, backlog: bool) -> LiveState {
    for step in 0..40 {
        let at = 0.25 * f64::from(step);
        let lost = u64::from(step == 3);
        let second = second(at as i64, &[0.010 + 0.001 * f64::from(step % 7), 0.012], lost);
        let mut accounting = Accounting::default();
        if backlog {
            accounting = Accounting {
                produced: 5_000_000,
                stored: 10_000 * step as u64,
                waiting: 5_000_000 - 10_000 * step as u64,
                oldest: Some(wall(-80_000.0 + 100.0 * at)),
                ..accounting
            };
            for batch in 0..200 {
                let events = u64::try_from(step * 200 + batch).expect("positive");
                let stored = StoredCounts { events, nodes: 12 * events, ..StoredCounts::default() };
                testbed.live.apply(
                    LiveEvent::Stored(testbed.host, stored, Some(wall(-80_000.0 + 100.0 * at))),
                    now(at),
                );
                testbed.live.apply(LiveEvent::Duplicate(testbed.host), now(at));
                testbed.live.apply(LiveEvent::Deferred(testbed.host), now(at));
                testbed.live.apply(LiveEvent::Run(testbed.host, RunId::random(), 7), now(at));
            }
        }
        let event = update(testbed.host, wall(at), vec![pipeline("line", vec![second])]);
        testbed.live.apply(with_accounting(event, accounting), now(at));
    }
    testbed.snapshot(9.8)
}

#[test]
fn backlog_changes_no_live_pipeline_or_link() {
    let (mut idle, mut busy) = (Testbed::new(), Testbed::new());
    busy.host = idle.host;
    busy.live = LiveTracker::new(slug("here"), "tcp://127.0.0.1:5550".into(), Span::from_seconds(3_600));
    busy.live.apply(LiveEvent::Hello(Box::new(description(busy.host, "edge")), 1), now(0.0));
    let (without_backlog, with_backlog) =
        (state_after_updates(&mut idle, false), state_after_updates(&mut busy, true));
    let to_json = |snapshot: &LiveState| {
        serde_json::to_string(&(&snapshot.pipelines, &snapshot.links)).expect("plain data")
    };
    assert_eq!(to_json(&without_backlog), to_json(&with_backlog));
    assert_eq!((without_backlog.hosts[0].behind, without_backlog.hosts[0].catching_up), (None, None));
    let host = &with_backlog.hosts[0];
    assert_eq!(host.behind, Some(Span::from_seconds_f64(80_000.0 - 99.0 * 9.75)));
    let catching_up = host.catching_up.expect("the lag falls by 99 s a second");
    assert!(
        (catching_up.rate - 99.0).abs() < 0.1 && (catching_up.events_per_second - 40_000.0).abs() < 40.0,
        "{catching_up:?}"
    );
}

#[test]
fn totals_include_absent_hosts_and_never_decrease() {
    let mut testbed = Testbed::new();
    let (gone, stranger) = (HostId::random(), HostId::random());
    let stored = |events| StoredCounts {
        events,
        nodes: 10 * events,
        quarantined: events / 100,
        ..StoredCounts::default()
    };
    testbed.live.apply(LiveEvent::Stored(gone, stored(100), None), now(0.0));
    assert_eq!(testbed.live.snapshot(now(0.0)).absent, 1, "the host has stored events and has not connected");
    testbed.live.apply(LiveEvent::Hello(Box::new(description(gone, "gone")), 1), now(0.0));
    assert_eq!(testbed.live.snapshot(now(0.0)).absent, 0);
    testbed.live.apply(LiveEvent::Hello(Box::new(description(stranger, "stranger")), 1), now(0.0));
    testbed.live.apply(LiveEvent::Stored(gone, stored(150), None), now(1.0));
    testbed.live.apply(LiveEvent::Damaged(testbed.host), now(1.0));
    testbed.send(3_500.0, vec![]);
    testbed.live.expire(now(3_601.0));
    let snapshot = testbed.snapshot(3_601.0);
    assert_eq!(
        (snapshot.hosts.len(), snapshot.absent),
        (1, 1),
        "`gone` and `stranger` were removed from the snapshot, and only `gone` has stored events"
    );
    let expected = |events, damaged| Totals {
        stored: StoredCounts { quarantined: 1, ..stored(events) },
        rejected_batches: RejectedBatches { deferred: 0, damaged },
        ..Totals::default()
    };
    assert_eq!(snapshot.totals, expected(150, 1));
    assert_eq!(snapshot.hosts[0].rejected_batches.damaged, 1);
    // The host returns; the counts stored before are not added again.
    testbed.live.apply(LiveEvent::Hello(Box::new(description(gone, "gone")), 1), now(3_602.0));
    testbed.live.apply(LiveEvent::Stored(gone, stored(160), None), now(3_602.0));
    let snapshot = testbed.snapshot(3_602.0);
    assert_eq!(snapshot.totals, expected(160, 1));
    assert_eq!(snapshot.hosts.iter().map(|host| host.stored.events).max(), Some(160));
}

#[test]
fn evicted_host_without_stored_events_is_not_absent() {
    let mut testbed = Testbed::new();
    for _ in 0..=MAX_HOSTS {
        let guest = description(HostId::random(), "guest");
        testbed.live.apply(LiveEvent::Hello(Box::new(guest), 1), now(0.0));
    }
    let snapshot = testbed.snapshot(0.0);
    assert_eq!((snapshot.hosts.len(), snapshot.absent), (MAX_HOSTS, 0));
}

#[test]
fn disconnected_host_has_no_catching_up_rate() {
    let mut testbed = Testbed::new();
    state_after_updates(&mut testbed, true);
    assert!(testbed.snapshot(9.8).hosts[0].catching_up.is_some());
    testbed.live.apply(LiveEvent::Goodbye(testbed.host), now(9.9));
    let snapshot = testbed.snapshot(9.9);
    assert_eq!(snapshot.hosts[0].catching_up, None);
    assert!(snapshot.hosts[0].behind.is_some(), "the last reported lag remains");
}
