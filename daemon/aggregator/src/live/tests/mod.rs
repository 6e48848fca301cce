//! Tests of the live state: its numbers compared with exact values, under clocks that jump and agents that send invalid
//! data.

mod durable;
mod interval_ends;
mod leaving;
mod links;
mod over_time;

use std::sync::Arc;

use peernet_clock::{ClockIdentity, MonoTime, Span, Stamp, Verdict, WallTime};
use peernet_logger::{HostId, Name, RunId, Slug, stage};
use peernet_statistics::Summary;
use peernet_stream::{
    Accounting, Hardware, HostClock, HostDescription, HostMetrics, LiveUpdate, OutcomeCounts, PipelineLive,
    PipelineState, Placement, PlacementKind, Second,
};
use proptest::prelude::*;

use super::{LiveEvent, LiveTracker, MAX_HOST_PIPELINES, MAX_NAMES, MAX_RUN_NUMBERS};
use crate::live_state::{LiveState, RefusedFrames, RefusedHost};
use peernet_store::StoredCounts;

/// Wall time of the tests' start, Unix seconds.
const START: i64 = 1_750_000_000;

/// Returns the aggregator's clocks `seconds` after the start.
fn now(seconds: f64) -> Stamp {
    let start = Stamp { wall: wall(0.0), mono: MonoTime::from_nanos(7), ..Stamp::default() };
    start + Span::from_seconds_f64(seconds)
}

/// Returns the wall time `seconds` after the start.
fn wall(seconds: f64) -> WallTime {
    WallTime::from_unix_nanos(START * 1_000_000_000) + Span::from_seconds_f64(seconds)
}

fn slug(name: &str) -> Slug {
    name.parse().expect("a name")
}

fn description(id: HostId, name: &str) -> HostDescription {
    HostDescription {
        id,
        name: slug(name),
        clock: ClockIdentity::new("boot", "test"),
        version: "0.1.0".into(),
        hardware: Hardware::default(),
        serves: None,
        models: vec![],
    }
}

fn pipeline(name: &str, seconds: Vec<Second>) -> PipelineLive {
    PipelineLive {
        pipeline: slug(name),
        state: PipelineState::Running,
        run: None,
        placement: Placement {
            kind: PlacementKind::Local,
            peer: None,
            network: None,
            address: None,
            model: slug("model"),
            device: None,
        },
        load: "5 Hz".into(),
        seconds,
    }
}

fn update(host: HostId, sent: WallTime, pipelines: Vec<PipelineLive>) -> LiveEvent {
    LiveEvent::Update(Box::new(LiveUpdate {
        host,
        sent,
        pipelines,
        links: vec![],
        clock: HostClock::default(),
        metrics: HostMetrics { cpu: Some(0.5), ..HostMetrics::default() },
        accounting: Accounting::default(),
    }))
}

/// Replaces the accounting of an update.
fn with_accounting(event: LiveEvent, accounting: Accounting) -> LiveEvent {
    let LiveEvent::Update(mut update) = event else { panic!("an update") };
    update.accounting = accounting;
    LiveEvent::Update(update)
}

/// Returns a second in which iterations with these total latencies succeeded and `lost` iterations were lost.
fn second(at: i64, totals: &[f64], lost: u64) -> Second {
    let mut summary = Summary::default();
    totals.iter().for_each(|total| summary.record(*total));
    let mut half_width = Summary::default();
    totals.iter().for_each(|_| half_width.record(40e-6));
    Second {
        at: START + at,
        counts: OutcomeCounts { ok: totals.len() as u64, lost, ..OutcomeCounts::default() },
        values: vec![(stage::TOTAL, summary.clone()), (stage::UPLOAD, summary)],
        bounds: vec![(stage::UPLOAD, half_width)],
        verdicts: vec![(stage::UPLOAD, Name::from("limited"), totals.len() as u64)],
    }
}

/// The live state with one connected host.
struct Testbed {
    live: LiveTracker,
    host: HostId,
}

impl Testbed {
    fn new() -> Self {
        let mut live =
            LiveTracker::new(slug("here"), "tcp://127.0.0.1:5550".into(), Span::from_seconds(3_600));
        let host = HostId::random();
        live.apply(LiveEvent::Hello(Box::new(description(host, "edge")), 1), now(0.0));
        Self { live, host }
    }

    /// Applies an update sent at `at` on both clocks.
    fn send(&mut self, at: f64, seconds: Vec<Second>) {
        let event = update(self.host, wall(at), vec![pipeline("line", seconds)]);
        assert!(self.live.apply(event, now(at)));
    }

    fn snapshot(&mut self, at: f64) -> LiveState {
        self.live.snapshot(now(at))
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn windows_match_exact_statistics(
        totals in prop::collection::vec(prop::collection::vec(0.001_f64..0.1, 0..8), 1..90),
        elapsed_fraction in 0.0_f64..0.99,
    ) {
        let mut testbed = Testbed::new();
        for (at, totals) in totals.iter().enumerate() {
            // Each second is reported twice: half of its iterations, then all. The later report replaces the earlier.
            let first_half = &totals[..totals.len() / 2];
            testbed.send(at as f64 + elapsed_fraction / 2.0, vec![second(at as i64, first_half, 0)]);
            testbed.send(at as f64 + elapsed_fraction, vec![second(at as i64, totals, 1)]);
        }
        let end = totals.len() - 1;
        let snapshot = testbed.snapshot(end as f64 + elapsed_fraction);
        for (window, seconds) in snapshot.pipelines[0].windows.iter().zip([1, 10, 60]) {
            let covered_totals = &totals[end.saturating_sub(seconds)..];
            let mut exact: Vec<f64> = covered_totals.iter().flatten().copied().collect();
            exact.sort_by(f64::total_cmp);
            prop_assert_eq!(window.seconds as usize, seconds);
            let covered = (seconds.min(end) as f64 + elapsed_fraction).max(1.0);
            prop_assert!((window.covered_s - covered).abs() < 1e-6);
            prop_assert_eq!((window.counts.ok, window.counts.lost), (exact.len() as u64, covered_totals.len() as u64));
            prop_assert!((window.rate_hz - window.counts.total() as f64 / window.covered_s).abs() < 1e-9);
            let Some(statistics) = window.value("total") else {
                prop_assert!(exact.is_empty());
                continue;
            };
            let mean = exact.iter().sum::<f64>() / exact.len() as f64;
            prop_assert_eq!(statistics.count, exact.len() as u64);
            prop_assert!((statistics.mean - mean).abs() < 1e-12);
            prop_assert_eq!((statistics.min, statistics.max), (exact[0], exact[exact.len() - 1]));
            let median = (exact[(exact.len() - 1) / 2] + exact[exact.len() / 2]) / 2.0;
            prop_assert!((statistics.p50 - median).abs() <= 0.0101 * median);
            // The 95th percentile needs 60 values.
            prop_assert_eq!(statistics.p95.is_some(), exact.len() >= 60);
            prop_assert_eq!(&window.bounds[0].verdicts, &[(Verdict::Limited, exact.len() as u64)]);
        }
    }
}

#[test]
fn late_and_unanswered_iterations_miss_their_deadline() {
    let mut testbed = Testbed::new();
    let second_with_deadline = |at: i64, totals: &[f64], lost: u64, flags: &[f64]| {
        let mut summary = Summary::default();
        flags.iter().for_each(|flag| summary.record(*flag));
        let mut second = second(at, totals, lost);
        second.values.push((Name::from("deadline-missed"), summary));
        second
    };
    testbed.send(0.9, vec![second(0, &[0.1; 4], 1)]);
    assert_eq!(
        testbed.snapshot(0.9).pipelines[0].windows[0].miss_rate,
        None,
        "no miss rate without a deadline"
    );
    testbed.send(9.9, vec![second_with_deadline(9, &[0.1; 3], 0, &[0.0, 1.0, 0.0])]);
    testbed.send(10.5, vec![second_with_deadline(10, &[], 3, &[])]);
    let rates = |testbed: &mut Testbed, at| {
        testbed.snapshot(at).pipelines[0].windows.each_ref().map(|window| window.miss_rate)
    };
    assert_eq!(rates(&mut testbed, 10.5)[0], Some(4.0 / 6.0));
    testbed.send(12.5, vec![second_with_deadline(12, &[], 2, &[])]);
    assert_eq!(rates(&mut testbed, 12.5)[0], Some(1.0), "all iterations were lost");
}

#[test]
fn series_covers_ten_minutes() {
    let mut testbed = Testbed::new();
    for at in 0..700 {
        testbed.send(at as f64 + 0.9, vec![second(at, &[0.25, 0.75], 0)]);
    }
    let snapshot = testbed.snapshot(699.9);
    let series = &snapshot.pipelines[0].series;
    assert_eq!((series.len(), series[0].at, series[599].at), (600, START + 100, START + 699));
    assert_eq!(series[0].means, [(stage::UPLOAD, 0.5), (stage::TOTAL, 0.5)]);
    assert_eq!(snapshot.hosts[0].history.len(), 120);
}

#[test]
fn silent_host_has_empty_windows_and_is_disconnected() {
    let mut testbed = Testbed::new();
    testbed.send(0.5, vec![second(0, &[0.010; 100], 0)]);
    assert_eq!(testbed.snapshot(0.6).pipelines[0].windows[0].counts.ok, 100);
    assert!(testbed.live.expire(now(5.0)));
    let snapshot = testbed.snapshot(5.0);
    let windows = &snapshot.pipelines[0].windows;
    assert_eq!(windows.each_ref().map(|window| window.counts.ok), [0, 100, 100]);
    assert!(windows[0].failed_fraction.is_none() && windows[0].rate_hz == 0.0);
    assert!(!snapshot.hosts[0].connected);
    assert_eq!(snapshot.pipelines[0].state, PipelineState::Away, "its activity is unknown");
    assert_eq!(snapshot.hosts[0].last_seen, wall(0.5));
    assert!(testbed.live.expire(now(100.0)));
    assert_eq!(testbed.snapshot(100.0).pipelines[0].windows[2].counts.ok, 0);
    assert!(!testbed.live.expire(now(101.0)), "nothing changes any more");
    assert_eq!((testbed.snapshot(101.0).hosts.len(), testbed.snapshot(101.0).pipelines.len()), (1, 1));
    assert!(testbed.live.expire(now(3_700.0)));
    assert!(testbed.snapshot(3_700.0).hosts.is_empty(), "forgotten after a long absence");
}

#[test]
fn windows_follow_wrong_and_stepped_agent_clock() {
    let mut testbed = Testbed::new();
    // The agent's clock is two days ahead of the aggregator's. The windows end at the present of the agent's clock.
    let ahead_s = 172_800;
    let host = testbed.host;
    let sent = |at: f64| wall(ahead_s as f64 + at);
    let pipelines = |at: i64| vec![pipeline("line", vec![second(at, &[0.010; 5], 0)])];
    for at in 0..5 {
        testbed
            .live
            .apply(update(host, sent(at as f64 + 0.5), pipelines(ahead_s + at)), now(at as f64 + 0.5));
    }
    let snapshot = testbed.snapshot(4.6);
    assert_eq!(snapshot.pipelines[0].windows.each_ref().map(|window| window.counts.ok), [10, 25, 25]);
    assert_eq!(snapshot.hosts[0].clock_ahead, Span::from_seconds(ahead_s));
    // The clock is set back to the right time: later seconds are discarded, and new seconds are shown at once.
    testbed.live.apply(update(host, wall(6.5), pipelines(6)), now(6.5));
    let snapshot = testbed.snapshot(6.5);
    assert_eq!(snapshot.pipelines[0].windows.each_ref().map(|window| window.counts.ok), [5, 5, 5]);
    assert_eq!(snapshot.pipelines[0].series.len(), 1);
}

#[test]
fn repeated_seconds_of_clock_set_back_count_once() {
    let mut testbed = Testbed::new();
    for at in 0..20 {
        testbed.send(at as f64 + 0.5, vec![second(at, &[0.010; 5], 0)]);
    }
    // The clock is set back by five seconds; the rate is five iterations a second throughout.
    for at in 15..17 {
        let host = testbed.host;
        let pipelines = vec![pipeline("line", vec![second(at, &[0.010; 5], 0)])];
        testbed.live.apply(update(host, wall(at as f64 + 0.5), pipelines), now(at as f64 + 5.5));
    }
    let snapshot = testbed.snapshot(21.6);
    let pipeline = &snapshot.pipelines[0];
    assert_eq!(pipeline.series.iter().map(|second| second.at).max(), Some(START + 16));
    assert_eq!(pipeline.windows.each_ref().map(|window| window.counts.ok), [10, 55, 85]);
    assert_eq!(pipeline.series.len(), 17, "seconds before the new time are kept");
}

#[test]
fn impossible_seconds_are_discarded_and_counted() {
    let mut testbed = Testbed::new();
    testbed.send(1_000.5, vec![second(1_000, &[0.010; 5], 0)]);
    // Second 2,000 is in the future, and second 300 is more than ten minutes old.
    testbed.send(
        1_000.6,
        [i64::MAX - START, i64::MIN + START, 2_000, 300].map(|at| second(at, &[0.5], 0)).into(),
    );
    let snapshot = testbed.snapshot(1_000.6);
    assert_eq!(snapshot.pipelines[0].windows[2].counts.ok, 5);
    assert_eq!((snapshot.pipelines[0].series.len(), snapshot.hosts[0].live_left_out), (1, 4));
}

#[test]
fn excess_pipelines_and_names_are_cut_and_counted() {
    let mut testbed = Testbed::new();
    let mut wide = second(0, &[0.010], 0);
    wide.values = (0..1_000).map(|n| (Name::from(format!("n{n}")), wide.values[0].1.clone())).collect();
    let mut pipelines = vec![pipeline("wide", vec![wide])];
    pipelines.extend((0..1_000).map(|n| pipeline(&format!("p{n}"), vec![])));
    testbed.live.apply(update(testbed.host, wall(0.5), pipelines), now(0.5));
    let snapshot = testbed.snapshot(0.5);
    assert_eq!(snapshot.pipelines.len(), MAX_HOST_PIPELINES);
    let wide = snapshot
        .pipelines
        .iter()
        .find(|pipeline| pipeline.pipeline.as_str() == "wide")
        .expect("the first pipeline");
    assert_eq!(wide.windows[0].values.len(), MAX_NAMES);
    assert_eq!(snapshot.hosts[0].live_left_out, 1_000 - MAX_NAMES as u64 + 1_001 - MAX_HOST_PIPELINES as u64);
}

#[test]
fn unchanged_snapshots_are_shared() {
    let mut testbed = Testbed::new();
    let other = HostId::random();
    testbed.live.apply(LiveEvent::Hello(Box::new(description(other, "other")), 1), now(0.0));
    testbed.live.apply(update(other, wall(0.1), vec![pipeline("quiet", vec![])]), now(0.1));
    testbed.send(0.2, vec![second(0, &[0.010], 0)]);
    let before = testbed.snapshot(0.3);
    testbed.send(0.4, vec![second(0, &[0.010, 0.020], 0)]);
    let after = testbed.snapshot(0.5);
    assert!(
        Arc::ptr_eq(&before.pipelines[1], &after.pipelines[1])
            && Arc::ptr_eq(&before.hosts[1], &after.hosts[1])
    );
    assert!(!Arc::ptr_eq(&before.pipelines[0], &after.pipelines[0]));
}

#[test]
fn run_gets_its_number_from_store_event() {
    let mut testbed = Testbed::new();
    let run = RunId::random();
    let mut pipeline_live = pipeline("line", vec![]);
    pipeline_live.run = Some(run);
    testbed.live.apply(update(testbed.host, wall(0.1), vec![pipeline_live.clone()]), now(0.1));
    assert_eq!(testbed.snapshot(0.1).pipelines[0].run_number, None);
    testbed.live.apply(LiveEvent::Run(testbed.host, run, 412), now(0.2));
    assert_eq!(testbed.snapshot(0.2).pipelines[0].run_number, Some(412));
    // Run numbers beyond the limit are discarded; the number of a shown run is kept.
    for number in 0..MAX_RUN_NUMBERS as i64 {
        testbed.live.apply(LiveEvent::Run(testbed.host, RunId::random(), number), now(0.3));
    }
    testbed.live.apply(update(testbed.host, wall(0.4), vec![pipeline_live]), now(0.4));
    assert_eq!(testbed.snapshot(0.4).pipelines[0].run_number, Some(412));
    assert!(testbed.live.run_numbers.len() <= MAX_RUN_NUMBERS);
}

#[test]
fn counts_of_host_and_database_are_shown() {
    let mut testbed = Testbed::new();
    let accounting = Accounting {
        produced: 10,
        stored: 4,
        waiting: 6,
        oldest: Some(wall(12.0)),
        trouble: Some("é".repeat(1_000)),
        ..Accounting::default()
    };
    testbed
        .live
        .apply(with_accounting(update(testbed.host, wall(30.0), vec![]), accounting.clone()), now(30.0));
    let stored = StoredCounts { events: 4, nodes: 80, ..StoredCounts::default() };
    testbed.live.apply(LiveEvent::Stored(testbed.host, stored, Some(wall(12.0))), now(30.1));
    testbed.live.apply(LiveEvent::Duplicate(testbed.host), now(30.2));
    let snapshot = testbed.snapshot(30.2);
    assert_eq!(snapshot.hosts[0].behind, Some(Span::from_seconds(18)));
    assert_eq!(snapshot.hosts[0].newest_stored, Some(wall(12.0)));
    assert_eq!(snapshot.hosts[0].stored, StoredCounts { duplicates: 1, ..stored });
    // A text is cut to 512 bytes, and `é` has two bytes.
    let truncated = Some("é".repeat(256));
    assert_eq!(snapshot.hosts[0].accounting, Accounting { trouble: truncated, ..accounting });
    let idle = Accounting { waiting: 0, ..accounting };
    testbed.live.apply(with_accounting(update(testbed.host, wall(30.5), vec![]), idle), now(30.5));
    assert_eq!(testbed.snapshot(30.5).hosts[0].behind, None, "no event waits");
    assert!(testbed.live.apply(LiveEvent::Goodbye(testbed.host), now(31.0)));
    assert!(!testbed.snapshot(31.0).hosts[0].connected);
}

#[test]
fn restarted_host_is_connected_from_first_update() {
    let mut testbed = Testbed::new();
    let account = |produced| Accounting { produced, ..Accounting::default() };
    let first = update(testbed.host, wall(1.0), vec![pipeline("line", vec![])]);
    testbed.live.apply(with_accounting(first, account(10)), now(1.0));
    let mut hello = |process, at| {
        testbed.live.apply(LiveEvent::Hello(Box::new(description(testbed.host, "edge")), process), now(at));
        let snapshot = testbed.live.snapshot(now(at));
        (
            snapshot.hosts[0].connected,
            snapshot.hosts[0].accounting.produced,
            snapshot.pipelines[0].state.clone(),
        )
    };
    // The same process on a new connection, then another process.
    assert_eq!(hello(1, 1.1), (true, 10, PipelineState::Running));
    assert_eq!(hello(2, 1.2), (false, 10, PipelineState::Away));
    testbed.live.apply(with_accounting(update(testbed.host, wall(1.3), vec![]), account(12)), now(1.3));
    let host = &testbed.snapshot(1.3).hosts[0];
    assert_eq!((host.connected, host.accounting.produced), (true, 12));
}

#[test]
fn connected_host_is_first_of_its_name() {
    let mut live = LiveTracker::new(slug("here"), "tcp://127.0.0.1:5550".into(), Span::from_seconds(3_600));
    // The order of the ids is the opposite of the expected order.
    let [old, new] = [1, 2].map(|byte| HostId::from_bytes([byte; 16]));
    let report = |live: &mut LiveTracker, host, at| {
        live.apply(LiveEvent::Hello(Box::new(description(host, "edge")), 1), now(at));
        live.apply(update(host, wall(at), vec![pipeline("line", vec![])]), now(at));
    };
    let order = |live: &mut LiveTracker, at| {
        let snapshot = live.snapshot(now(at));
        let hosts: Vec<HostId> = snapshot.hosts.iter().map(|host| host.id).collect();
        assert_eq!(snapshot.pipelines.iter().map(|pipeline| pipeline.host).collect::<Vec<_>>(), hosts);
        assert_eq!(snapshot.pipeline("edge", "line").map(|pipeline| pipeline.host), Some(hosts[0]));
        hosts
    };
    report(&mut live, old, 0.0);
    live.expire(now(20.0));
    report(&mut live, new, 20.0);
    assert_eq!(order(&mut live, 20.0), [new, old]);
    live.expire(now(40.0));
    assert_eq!(order(&mut live, 40.0), [new, old], "the silent host that reported last");
    report(&mut live, old, 60.0);
    assert_eq!(order(&mut live, 60.0), [old, new]);
}

#[test]
fn frames_of_unknown_hosts_are_counted() {
    let mut testbed = Testbed::new();
    assert!(testbed.live.apply(LiveEvent::Unreadable, now(0.1)));
    assert!(
        testbed.live.apply(LiveEvent::Stranger, now(0.1))
            && testbed.live.apply(LiveEvent::Stranger, now(0.2))
    );
    assert_eq!(testbed.snapshot(0.2).totals.refused, RefusedFrames { unreadable: 1, strangers: 2 });
}

#[test]
fn refused_host_is_shown_once_for_ten_minutes() {
    let mut testbed = Testbed::new();
    let refused = |name: &str, at| RefusedHost {
        name: slug(name),
        address: None,
        reason: "the name is taken".into(),
        at,
    };
    for at in 0..50 {
        testbed.live.apply(LiveEvent::Refused(refused("twin", wall(f64::from(at)))), now(f64::from(at)));
    }
    testbed.live.apply(LiveEvent::Refused(refused("other", wall(60.0))), now(60.0));
    let snapshot = testbed.snapshot(60.0);
    let shown: Vec<_> = snapshot.refused.iter().map(|refused| (refused.name.as_str(), refused.at)).collect();
    assert_eq!(shown, [("other", wall(60.0)), ("twin", wall(49.0))]);
    assert!(testbed.live.expire(now(655.0)));
    assert_eq!(testbed.snapshot(655.0).refused.len(), 1);
}

#[test]
fn host_without_stored_events_is_removed_early() {
    let mut live = LiveTracker::new(slug("base"), "tcp://127.0.0.1:1".into(), Span::from_seconds(86_400));
    let (stored_host, stranger) = (HostId::random(), HostId::random());
    let stored = StoredCounts { events: 7, nodes: 70, ..StoredCounts::default() };
    assert!(!live.apply(LiveEvent::Stored(stored_host, stored, None), now(0.0)));
    live.apply(LiveEvent::Hello(Box::new(description(stored_host, "known")), 1), now(1.0));
    live.apply(LiveEvent::Hello(Box::new(description(stranger, "stranger")), 1), now(1.0));
    let snapshot = live.snapshot(now(1.0));
    assert_eq!(snapshot.hosts.iter().map(|host| host.stored.events).collect::<Vec<_>>(), [7, 0]);
    live.expire(now(600.0));
    assert_eq!(live.snapshot(now(600.0)).hosts.len(), 2);
    assert!(live.expire(now(602.0)));
    let snapshot = live.snapshot(now(602.0));
    assert_eq!(snapshot.hosts.iter().map(|host| host.id).collect::<Vec<_>>(), [stored_host]);
}
