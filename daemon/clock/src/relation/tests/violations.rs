//! The effect of a violated assumption on intervals, and how long the effect lasts.

use super::*;

const WINDOW: f64 = 10.0;

/// Observed effect of a violated assumption.
#[derive(Debug, Default)]
struct ViolationEffect {
    /// Number of `ok` or `limited` delays whose interval does not contain the true delay.
    wrong_delays: u32,
    judged_delays: u32,
    /// Seconds from the violation to the last wrong delay.
    seconds_to_last_wrong_delay: f64,
    /// Seconds from the violation to the last `stale` delay.
    seconds_to_last_stale_delay: f64,
    /// Seconds from the violation to the first violated limit, and that limit.
    violated_limit: Option<(f64, ViolatedLimit)>,
    /// Seconds from the violation to the first suspected jump.
    seconds_to_first_jump: Option<f64>,
    /// `true` if a limit was violated at the end.
    violates_limit_at_end: bool,
    jumps: u32,
}

/// Judges ten exchanges per second. `times` are the seconds of the violation and of the end.
fn observe_violation(
    host_clocks: &HostClocks,
    path: Path,
    settings: RelationSettings,
    times: (f64, f64),
) -> ViolationEffect {
    observe_violation_at(10.0, host_clocks, path, settings, times)
}

/// Judges `hz` exchanges per second. `at` and `end` are the seconds of the violation and of the end.
fn observe_violation_at(
    hz: f64,
    host_clocks: &HostClocks,
    path: Path,
    settings: RelationSettings,
    (at, end): (f64, f64),
) -> ViolationEffect {
    let mut relation = Relation::new(settings);
    let mut effect = ViolationEffect::default();
    for trip in path.trips(host_clocks, (0.0, end), hz, &mut RandomSource::new(12)) {
        let judged = relation.judge(&trip.observation());
        let after = trip.end / 1e9 - at;
        for (delay, truth) in [(judged.up, trip.up), (judged.down, trip.down)] {
            effect.judged_delays += 1;
            if delay.verdict == Verdict::Stale {
                effect.seconds_to_last_stale_delay = after;
            }
            let is_trusted = matches!(delay.verdict, Verdict::Ok | Verdict::Limited);
            if is_trusted && !contains(&delay, truth) {
                assert!(after >= 0.0, "{delay:?} {truth} at {}", trip.end);
                effect.wrong_delays += 1;
                effect.seconds_to_last_wrong_delay = after;
            }
        }
        if let Some(limit) = relation.violated_limit() {
            effect.violated_limit.get_or_insert((after, limit));
        }
        if matches!(judged.learn_result, LearnResult::Jumped(_)) {
            effect.jumps += 1;
            effect.seconds_to_first_jump.get_or_insert(after);
        }
    }
    effect.violates_limit_at_end = relation.violates_limit();
    effect
}

fn free_running_limit(max_drift_ppm: f64) -> RelationSettings {
    RelationSettings { max_drift_ppm, clocks: RelatedClocks::Raw, ..RelationSettings::default() }
}

fn path(up: f64, down: f64, jitter: f64) -> Path {
    Path { up: up * 1e6, down: down * 1e6, jitter: jitter * 1e6, loss: 0.01, burst: 5e6 }
}

fn drifting(ppm: f64) -> HostClocks {
    HostClocks {
        edge: SimulatedClock::drifting(Span::ZERO, 0.0),
        cloud: SimulatedClock::drifting(Span::from_seconds(3), ppm),
    }
}

/// Over a long path the interval is far wider than the drift within the window: no delay is wrong, and after some
/// minutes the exchanges prove that the limit is exceeded.
#[test]
fn excess_drift_on_long_path_is_proven() {
    // `proven_after` is `None` if the test is too short for the proof.
    for (ppm, proven_after) in
        [(51.0, None), (75.0, None), (100.0, Some(950.0)), (150.0, Some(500.0)), (-100.0, Some(950.0))]
    {
        let effect =
            observe_violation(&drifting(ppm), path(5.0, 40.0, 1.0), free_running_limit(50.0), (0.0, 1_100.0));
        assert_eq!(effect.wrong_delays, 0, "{ppm}: {effect:?}");
        let noticed_after =
            effect.violated_limit.filter(|(_, limit)| *limit == ViolatedLimit::Drift).map(|(after, _)| after);
        assert_eq!(noticed_after.is_some(), proven_after.is_some(), "{ppm}: {effect:?}");
        assert!(
            noticed_after <= proven_after && effect.violates_limit_at_end == noticed_after.is_some(),
            "{ppm}: {effect:?}"
        );
    }
}

#[test]
fn excess_drift_on_short_path_is_noticed_within_window() {
    for ppm in [75.0, 100.0, 150.0] {
        let effect = observe_violation(&drifting(ppm), Path::VETH, free_running_limit(50.0), (0.0, 300.0));
        assert!(
            effect.seconds_to_last_wrong_delay < WINDOW && effect.violates_limit_at_end,
            "{ppm}: {effect:?}"
        );
        assert!(
            matches!(effect.violated_limit, Some((after, ViolatedLimit::Drift)) if after < WINDOW),
            "{ppm}: {effect:?}"
        );
    }
}

/// A jump as after the migration of a virtual machine. It is smaller than the round trip, so no exchange
/// contradicts the others.
#[test]
fn unannounced_jump_is_suspected_by_first_exchanges() {
    for (delays, jitter) in [((20.0, 20.0), 1.0), ((20.0, 20.0), 5.0), ((5.0, 40.0), 1.0)] {
        for millis in [-39, -10, 10, 39] {
            let jump = Span::from_millis(millis);
            let host_clocks = drifting(20.0);
            let host_clocks =
                HostClocks { cloud: host_clocks.cloud.stepped(Span::from_seconds(30), jump), ..host_clocks };
            let effect = observe_violation(
                &host_clocks,
                path(delays.0, delays.1, jitter),
                free_running_limit(200.0),
                (30.0, 90.0),
            );
            // Waiting on the network moves the middle of an exchange's bounds by half of the waiting time. A jump of
            // 39 ms exceeds this movement even if the exchange waited for a short time. A jump of 10 ms shows only in
            // an exchange that did not wait.
            let latest_suspicion = if jitter > 1.0 && millis.abs() < 39 { 5.0 } else { 0.5 };
            assert!(
                effect.seconds_to_first_jump.is_some_and(|after| after < latest_suspicion),
                "{delays:?} {jump}: {effect:?}"
            );
            assert!(
                effect.seconds_to_last_wrong_delay < 0.5
                    && effect.jumps == 1
                    && effect.violated_limit.is_none(),
                "{delays:?} {jump}: {effect:?}"
            );
        }
    }
}

/// A jump of the edge's clock while exchanges are in flight. After a jump back, these exchanges seem shorter than the
/// path.
#[test]
fn edge_jump_is_suspected_with_exchanges_in_flight() {
    for (delays, jitter) in [((20.0, 20.0), 0.2), ((20.0, 20.0), 1.0), ((5.0, 40.0), 1.0), ((0.5, 0.5), 0.02)]
    {
        for millis in [-39, -15, -3, 3, 15, 39] {
            let jump = Span::from_millis(millis);
            let host_clocks = drifting(20.0);
            let host_clocks =
                HostClocks { edge: host_clocks.edge.stepped(Span::from_seconds(30), jump), ..host_clocks };
            let effect = observe_violation_at(
                60.0,
                &host_clocks,
                path(delays.0, delays.1, jitter),
                free_running_limit(200.0),
                (30.0, 90.0),
            );
            // Waiting may explain a jump of 3 ms. On the path with a round trip of 1 ms, the larger jumps contradict
            // the band and are steps.
            let is_suspected = delays.0 > 1.0 && millis.abs() >= 15;
            let in_time = |after: f64| after < 0.1;
            assert!(
                !is_suspected || effect.seconds_to_first_jump.is_some_and(in_time),
                "{delays:?} {jitter} {jump}: {effect:?}"
            );
            assert!(in_time(effect.seconds_to_last_wrong_delay), "{delays:?} {jitter} {jump}: {effect:?}");
        }
    }
}

/// A route change that shortens the path gives narrower bounds and no jump.
#[test]
fn shorter_path_is_not_suspected_as_jump() {
    let host_clocks = drifting(20.0);
    let mut relation = Relation::new(free_running_limit(200.0));
    let (mut random, mut widths) = (RandomSource::new(4), Vec::new());
    for (route, seconds) in [(path(20.0, 20.0, 0.2), (0.0, 30.0)), (path(5.0, 5.0, 0.2), (30.0, 60.0))] {
        for trip in route.trips(&host_clocks, seconds, 20.0, &mut random) {
            let judged = relation.judge(&trip.observation());
            assert_eq!(judged.learn_result, LearnResult::Accepted);
            assert!(contains(&judged.up, trip.up) && contains(&judged.down, trip.down), "{judged:?}");
            widths.push((trip.end, judged.up.bounds.expect("bounds").width()));
        }
    }
    let after_change = widths.iter().filter(|(end, _)| *end > 30.3e9);
    assert!(after_change.clone().all(|(_, width)| *width < Span::from_millis(14)), "{widths:?}");
}

/// Covers random paths, jumps and changes of rate.
#[test]
fn violated_assumption_spoils_at_most_one_window() {
    let mut longest: f64 = 0.0;
    for seed in 0..300 {
        let mut random = RandomSource::new(seed);
        let mut log_uniform = |from: f64, to: f64| random.between(from.ln(), to.ln()).exp();
        let path = path(log_uniform(0.03, 300.0), log_uniform(0.03, 300.0), log_uniform(0.01, 20.0));
        let (jump, ppm) = (log_uniform(1e4, 3e8) as i64, log_uniform(5.0, 180.0));
        let at = Span::from_seconds(30);
        let host_clocks = drifting(10.0);
        let change = |clock: SimulatedClock| match seed % 4 {
            0 => clock.stepped(at, Span::from_nanos(jump)),
            1 => clock.stepped(at, Span::from_nanos(-jump)),
            2 => clock.faster(at, ppm),
            _ => clock.faster(at, -ppm),
        };
        let host_clocks = match seed % 8 < 4 {
            true => HostClocks { cloud: change(host_clocks.cloud), ..host_clocks },
            false => HostClocks { edge: change(host_clocks.edge), ..host_clocks },
        };
        let effect = observe_violation(&host_clocks, path, free_running_limit(200.0), (30.0, 60.0));
        assert!(effect.seconds_to_last_wrong_delay <= WINDOW + 0.5, "{seed}: {path:?} {effect:?}");
        assert!(effect.seconds_to_last_stale_delay <= WINDOW + 0.5, "{seed}: {path:?} {effect:?}");
        longest = longest.max(effect.seconds_to_last_wrong_delay);
    }
    assert!(longest > 0.1, "nothing was violated: {longest}");
}

/// Under jitter, few exchanges after the change contradict the exchanges before it. They are too few to prove a step,
/// and the other exchanges fit both the time before the change and the time after it.
#[test]
fn suspicion_after_change_of_rate_ends_with_window() {
    let mut seconds_to_last_stale_delay: f64 = 0.0;
    for seed in 0..100 {
        let host_clocks = drifting(0.0);
        let host_clocks =
            HostClocks { edge: host_clocks.edge.faster(Span::from_seconds(30), 180.0), ..host_clocks };
        let mut relation = Relation::new(free_running_limit(200.0));
        let mut random = RandomSource::new(seed);
        for n in 0..2_400 {
            let begin = 15e9 + f64::from(n) * 20e6;
            let mut delay = || 5e4 + random.between(0.0, 2e6) + random.between(0.0, 2e6);
            let (up, down) = (delay(), delay());
            let judged =
                relation.judge(&host_clocks.trip(begin, up.floor(), 1e5, down.floor()).observation());
            let after = begin / 1e9 - 30.0;
            if judged.up.verdict == Verdict::Stale && after > 0.0 {
                seconds_to_last_stale_delay = seconds_to_last_stale_delay.max(after);
            }
        }
    }
    assert!(seconds_to_last_stale_delay > 1.0, "nothing was suspected: {seconds_to_last_stale_delay}");
    assert!(seconds_to_last_stale_delay <= WINDOW, "{seconds_to_last_stale_delay}");
}

#[test]
fn flapping_route_widens_few_intervals_and_at_most_twofold() {
    let host_clocks = drifting(20.0);
    let (there, back) = (path(10.0, 30.0, 1.0), path(30.0, 10.0, 1.0));
    let mut relation = Relation::new(free_running_limit(200.0));
    let mut random = RandomSource::new(3);
    let (mut widths, mut jumps) = (Vec::new(), 0);
    for n in 0..24 {
        let route = if n % 2 == 0 { there } else { back };
        let seconds = (f64::from(n) * 5.0, f64::from(n + 1) * 5.0);
        for trip in route.trips(&host_clocks, seconds, 10.0, &mut random) {
            let judged = relation.judge(&trip.observation());
            jumps += u32::from(matches!(judged.learn_result, LearnResult::Jumped(_)));
            for (delay, truth) in [(judged.up, trip.up), (judged.down, trip.down)] {
                assert!(contains(&delay, truth), "{delay:?} {truth}");
                widths.push(delay.bounds.expect("bounds").width());
            }
        }
    }
    widths.sort();
    let (median, widest) = (widths[widths.len() / 2], widths[widths.len() - 1]);
    assert!(median < Span::from_millis(42) && widest < Span::from_millis(80), "{median} {widest}");
    assert!((10..24).contains(&jumps), "{jumps}");
    assert!(!relation.violates_limit());
}

/// A delay from before a suspected jump is not judged by the exchanges after the jump. A delay between the last
/// exchange before the jump and the first exchange after it is judged by both windows.
#[test]
fn suspected_jump_is_a_boundary_for_earlier_delays() {
    let jump = Span::from_millis(30);
    let host_clocks = drifting(20.0);
    let host_clocks =
        HostClocks { cloud: host_clocks.cloud.stepped(Span::from_seconds(30), jump), ..host_clocks };
    let settings = RelationSettings { retention: Span::from_seconds(60), ..free_running_limit(200.0) };
    let mut relation = Relation::new(settings);
    let trips = path(20.0, 20.0, 1.0).trips(&host_clocks, (0.0, 60.0), 10.0, &mut RandomSource::new(5));
    trips.iter().for_each(|trip| _ = relation.learn(&trip.observation()));
    assert_eq!(relation.exchange_counts().restarts, 1);
    let mut hulls = 0;
    for trip in trips.iter().filter(|trip| (5e9..55e9).contains(&trip.end)) {
        let exchange = &trip.exchange;
        let spans_the_jump = trip.end > 30e9 && trip.end - 60e6 < 30e9;
        for (delay, truth) in [
            (relation.delay(Direction::Up, exchange.sent, exchange.received), trip.up),
            (relation.delay(Direction::Down, exchange.replied, exchange.returned), trip.down),
        ] {
            assert!(spans_the_jump || contains(&delay, truth), "{delay:?} {truth} at {}", trip.end);
            // The interval of one band is about 40 ms wide. An interval above 60 ms is the hull of two bands.
            hulls += u32::from(delay.bounds.is_some_and(|bounds| bounds.width() > Span::from_millis(60)));
            // Delays are `limited` for 10 s after a suspected jump, which is the length of the window.
            let is_near_suspected_jump = (30.3e9..39.5e9).contains(&trip.end);
            assert!(!is_near_suspected_jump || delay.verdict == Verdict::Limited, "{delay:?}");
        }
    }
    assert!((2..30).contains(&hulls), "{hulls}");
}

/// An exchange after a jump does not show the jump if its message waited. Such an exchange must not bound delays from
/// before the jump.
#[test]
fn exchange_that_hides_jump_bounds_no_earlier_delay() {
    let host_clocks = drifting(0.0);
    let host_clocks = HostClocks {
        cloud: host_clocks.cloud.stepped(Span::from_seconds(30), Span::from_millis(39)),
        ..host_clocks
    };
    let mut relation = Relation::new(free_running_limit(200.0));
    let unloaded_trip = |t: f64| host_clocks.trip(t * 1e9, 20e6, 1e5, 20e6);
    (0..300).for_each(|n| _ = relation.learn(&unloaded_trip(f64::from(n) / 10.0).observation()));
    let waited = host_clocks.trip(30.02e9, 60e6, 1e5, 20e6);
    assert_eq!(relation.learn(&waited.observation()), LearnResult::Accepted);
    assert!(matches!(relation.learn(&unloaded_trip(30.1).observation()), LearnResult::Jumped(_)));
    let before = unloaded_trip(29.8);
    let delay = relation.delay(Direction::Up, before.exchange.sent, before.exchange.received);
    assert!(contains(&delay, before.up), "{delay:?}");
}

/// The first exchange after a jump waits as long in both directions. It does not show the jump, and the middle of its
/// bounds is that of the exchanges that follow it.
#[test]
fn exchange_that_waited_evenly_does_not_hide_jump() {
    let jump = Span::from_millis(39);
    let host_clocks = drifting(0.0);
    let host_clocks =
        HostClocks { cloud: host_clocks.cloud.stepped(Span::from_seconds(30), jump), ..host_clocks };
    let mut relation = Relation::new(free_running_limit(200.0));
    let trip = |t: f64, one_way: f64| host_clocks.trip(t * 1e9, one_way, 1e5, one_way);
    (0..300).for_each(|n| _ = relation.learn(&trip(f64::from(n) / 10.0, 20e6).observation()));
    // The shortest round trip of each half-second is kept, and this exchange is the first one of its half-second.
    assert_eq!(relation.learn(&trip(30.02, 30e6).observation()), LearnResult::Accepted);
    let next = trip(30.1, 20e6);
    let judged = relation.judge(&next.observation());
    let LearnResult::Jumped(movement) = judged.learn_result else { panic!("{judged:?}") };
    assert!((movement - jump).abs() < Span::from_millis(1), "{movement}");
    assert!(contains(&judged.up, next.up) && contains(&judged.down, next.down), "{judged:?}");
}

/// An exchange is in flight together with the last exchange before a jump, and its message arrives after the jump. Its
/// answer waits, so that it does not show the jump.
#[test]
fn exchange_in_flight_at_jump_bounds_no_earlier_delay() {
    let host_clocks = drifting(0.0);
    let host_clocks = HostClocks {
        cloud: host_clocks.cloud.stepped(Span::from_millis(29_545), Span::from_millis(-39)),
        ..host_clocks
    };
    let mut relation = Relation::new(free_running_limit(200.0));
    let unloaded_trip = |t: f64| host_clocks.trip(t * 1e9, 20e6, 1e5, 20e6);
    (0..296).for_each(|n| _ = relation.learn(&unloaded_trip(f64::from(n) / 10.0).observation()));
    let waited = host_clocks.trip(29.53e9, 20e6, 1e5, 60e6);
    assert_eq!(relation.learn(&waited.observation()), LearnResult::Accepted);
    assert!(matches!(relation.learn(&unloaded_trip(29.6).observation()), LearnResult::Jumped(_)));
    let before = unloaded_trip(29.4);
    let delay = relation.delay(Direction::Up, before.exchange.sent, before.exchange.received);
    assert!(contains(&delay, before.up), "{delay:?}");
}

/// The cloud's clock jumps every three seconds. More bands end than are kept.
#[test]
fn kept_band_bounds_no_delay_of_removed_band() {
    let clocks = drifting(0.0);
    let jumps = (1..=20).map(|n| Span::from_seconds(3 * n));
    let cloud = jumps.fold(clocks.cloud, |cloud, at| cloud.stepped(at, Span::from_millis(-15)));
    let host_clocks = HostClocks { cloud, ..clocks };
    let settings = RelationSettings { retention: Span::from_seconds(60), ..free_running_limit(200.0) };
    let mut relation = Relation::new(settings);
    let trip = |t: f64| host_clocks.trip(t * 1e9, 20e6, 1e5, 20e6);
    (0..620).for_each(|n| _ = relation.learn(&trip(f64::from(n) / 10.0).observation()));
    assert_eq!(relation.exchange_counts().restarts, 20);
    for n in 0..20 {
        let trip = trip(1.5 + 3.0 * f64::from(n));
        let delay = relation.delay(Direction::Up, trip.exchange.sent, trip.exchange.received);
        // Sixteen bands are kept besides the current one.
        assert_eq!(delay.bounds.is_some(), n >= 4, "{n}: {delay:?}");
        assert!(n < 4 || contains(&delay, trip.up), "{n}: {delay:?}");
    }
}
