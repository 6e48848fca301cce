//! Generated histories of two clocks and of the paths between them that keep the assumptions. No interval may be wrong.

use std::env;

use super::*;

const LIMIT_PPM: f64 = 200.0;
const CHANGE_PPM_PER_S: f64 = 1.0;
/// Length of a history in seconds.
const LENGTH: f64 = 60.0;

/// Trips in the order in which their answers become known, each with the cloud's epoch at that time.
struct History {
    trips: Vec<(Trip, u32)>,
}

/// Returns the number of histories: 1,000, or the value of `PEERNET_HISTORIES`.
fn histories() -> u64 {
    env::var("PEERNET_HISTORIES").ok().and_then(|count| count.parse().ok()).unwrap_or(1_000)
}

fn settings() -> RelationSettings {
    RelationSettings {
        max_drift_ppm: LIMIT_PPM,
        max_drift_change_ppm_per_s: CHANGE_PPM_PER_S,
        clocks: RelatedClocks::Raw,
        ..RelationSettings::default()
    }
}

/// Returns a path of 0.03 to 300 ms in each direction, with jitter and loss.
fn path(random: &mut RandomSource) -> Path {
    let mut log_uniform = |shortest: f64, longest: f64| (random.between(shortest.ln(), longest.ln())).exp();
    let (up, down, jitter, burst) =
        (log_uniform(3e4, 300e6), log_uniform(3e4, 300e6), log_uniform(1e3, 20e6), log_uniform(1e5, 200e6));
    Path { up, down, jitter, loss: if random.chance(0.5) { random.between(0.0, 0.4) } else { 0.0 }, burst }
}

impl History {
    fn generate(random: &mut RandomSource) -> Self {
        let pause = if random.chance(0.4) { random.between(0.5f64.ln(), 600f64.ln()).exp() } else { 0.0 };
        let length = Span::from_seconds_f64(LENGTH + pause + 10.0);
        // Each clock has half of the limit. A third of the clocks drift by this half all the time.
        let clock = |random: &mut RandomSource| {
            let offset = Span::from_nanos(random.between(-1e15, 1e15) as i64);
            let half_limit = LIMIT_PPM / 2.0;
            if random.chance(0.33) {
                return SimulatedClock::drifting(
                    offset,
                    if random.chance(0.5) { half_limit } else { -half_limit },
                );
            }
            SimulatedClock::warming(offset, half_limit, CHANGE_PPM_PER_S / 2.0, length, random)
        };
        let (mut edge, mut cloud) = (clock(random), clock(random));
        // In a fifth of the histories, the path is so short that only the assumptions separate the bounds from the
        // truth.
        let is_tight = random.chance(0.2);
        if is_tight {
            edge = SimulatedClock::drifting(Span::ZERO, 0.0);
            cloud = SimulatedClock::warming(Span::ZERO, LIMIT_PPM, CHANGE_PPM_PER_S, length, random);
        }
        let pause_start = random.between(5.0, LENGTH - 5.0);
        // A cloud that was restarted has another clock, and reports a new epoch.
        let cloud_restarts = random.chance(0.2);
        if cloud_restarts {
            let by = Span::from_nanos(random.between(-1e12, 1e12) as i64);
            cloud = cloud.stepped(Span::from_seconds_f64(pause_start + pause / 2.0), by);
        }
        let host_clocks = HostClocks { edge, cloud };
        let hz = random.between(1f64.ln(), 30f64.ln()).exp() / if is_tight { 4.0 } else { 1.0 };
        let tight_path = Path { up: 1e3, down: 1e3, jitter: 1e3, loss: 0.2, burst: 1e4 };
        let mut route = if is_tight { tight_path } else { path(random) };
        let other_route =
            if random.chance(0.5) { Path { up: route.down, down: route.up, ..route } } else { path(random) };
        let route_change_interval =
            if random.chance(0.4) && !is_tight { random.between(1.0, 20.0) } else { f64::INFINITY };
        let mut trips = Vec::new();
        for (begin, end) in [(0.0, pause_start), (pause_start + pause, LENGTH + pause)] {
            let mut from = begin;
            while from < end {
                let until = (from + route_change_interval).min(end);
                trips.extend(route.trips(&host_clocks, (from, until), hz, random));
                // From the first change on, the route alternates between `other_route` and a route whose upload takes
                // as long as the download of `other_route`.
                if until < end {
                    route = if route.up == other_route.up {
                        Path { up: other_route.down, ..other_route }
                    } else {
                        other_route
                    };
                }
                from = until;
            }
        }
        let restart_time = (pause_start + pause / 2.0) * 1e9;
        // A restarted cloud answers no request that was in flight, and receives none in the second after its restart.
        trips.retain(|trip| {
            !cloud_restarts
                || trip.end < restart_time
                || trip.end - (trip.up + trip.down).nanos() as f64 - 1e9 > restart_time
        });
        let with_epochs =
            trips.into_iter().map(|trip| (trip, u32::from(cloud_restarts && trip.end > restart_time)));
        let mut trips: Vec<(Trip, u32)> = with_epochs.collect();
        // Some answers become known late.
        for (trip, _) in &mut trips {
            trip.end += if random.chance(0.05) { random.exponential(5e8) } else { 0.0 };
        }
        trips.sort_by(|a, b| a.0.end.total_cmp(&b.0.end));
        Self { trips }
    }
}

#[test]
fn delays_of_generated_histories_contain_truth() {
    let (mut judged_delays, mut trusted_delays, mut jumps) = (0_u64, 0_u64, 0_u64);
    for seed in 0..histories() {
        let history = History::generate(&mut RandomSource::new(seed.wrapping_mul(0x5851_F42D_4C95_7F2D)));
        let settings = RelationSettings { retention: Span::from_seconds(30), ..settings() };
        let mut relation = Relation::new(settings);
        let mut newest_epoch = 0;
        for (n, (trip, epoch)) in history.trips.iter().enumerate() {
            newest_epoch = newest_epoch.max(*epoch);
            let judged_exchange =
                relation.judge(&ExchangeObservation { cloud_epoch: Some(*epoch), ..trip.observation() });
            jumps += u64::from(matches!(judged_exchange.learn_result, LearnResult::Jumped(_)));
            let is_stepped = judged_exchange.learn_result == LearnResult::Refused(Refusal::Stepped);
            assert!(
                is_stepped || !matches!(judged_exchange.learn_result, LearnResult::Refused(_)),
                "history {seed}, exchange {n}: {judged_exchange:?}"
            );
            let mut check = |delay: OneWayDelay, truth: Span| {
                judged_delays += 1;
                trusted_delays += u64::from(matches!(delay.verdict, Verdict::Ok | Verdict::Limited));
                assert!(delay.verdict != Verdict::Inconsistent, "history {seed}, exchange {n}: {delay:?}");
                let is_inside = delay.bounds.is_none_or(|bounds| bounds.contains(truth));
                assert!(is_inside, "history {seed}, exchange {n}: {delay:?}, truth {truth}");
            };
            check(judged_exchange.up, trip.up);
            check(judged_exchange.down, trip.down);
            // Judges an earlier delay again, with the exchanges that followed it. After a restart of the cloud, the
            // relation is that of its new clock.
            let earlier = n - n.min((n * 7919) % 50);
            let (earlier_trip, _) = &history.trips[earlier];
            if newest_epoch == 0 {
                let exchange = &earlier_trip.exchange;
                check(relation.delay(Direction::Up, exchange.sent, exchange.received), earlier_trip.up);
                check(
                    relation.delay(Direction::Down, exchange.replied, exchange.returned),
                    earlier_trip.down,
                );
            }
        }
    }
    assert!(trusted_delays * 2 > judged_delays, "{trusted_delays} of {judged_delays}");
    assert!(jumps > 0, "no change of the route was noticed");
}
