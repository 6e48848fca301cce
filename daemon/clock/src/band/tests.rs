use proptest::prelude::*;

use super::*;
use crate::simulation::{HostClocks, Path, RandomSource, SimulatedClock, Trip};

const LIMIT_PPM: f64 = 50.0;

fn model() -> DriftModel {
    DriftModel { limit: DriftLimit::new(LIMIT_PPM), change_limit: None }
}

fn band(window: Span) -> Band {
    Band::new(model(), window, window)
}

/// Returns pairs of clocks, one of which drifts at the limit in either direction, or wanders within the limit.
fn host_clock_pairs(offset: Span, length: Span, random: &mut RandomSource) -> Vec<HostClocks> {
    let correct_clock = SimulatedClock::drifting(Span::ZERO, 0.0);
    let mut host_clock_pairs = Vec::new();
    for ppm in [-LIMIT_PPM, LIMIT_PPM] {
        let drifting = SimulatedClock::drifting(offset, ppm);
        host_clock_pairs.push(HostClocks { edge: drifting.clone(), cloud: correct_clock.clone() });
        host_clock_pairs.push(HostClocks { edge: correct_clock.clone(), cloud: drifting });
    }
    host_clock_pairs.push(HostClocks {
        edge: correct_clock.clone(),
        cloud: SimulatedClock::wandering(offset, LIMIT_PPM, length, random),
    });
    host_clock_pairs.push(HostClocks {
        edge: SimulatedClock::wandering(offset, LIMIT_PPM, length, random),
        cloud: correct_clock,
    });
    host_clock_pairs
}

/// Delays some answers, so that the trips are learnt in another order than they were sent.
fn delay_some_answers(trips: &mut [Trip], random: &mut RandomSource) {
    for trip in trips.iter_mut() {
        trip.end += if random.chance(0.1) { random.exponential(2e9) } else { 0.0 };
    }
    trips.sort_by(|a, b| a.end.total_cmp(&b.end));
}

fn contains(interval: Interval, truth: f64) -> bool {
    interval.lo.nanos() as f64 <= truth && truth <= interval.hi.nanos() as f64
}

fn paths() -> impl Strategy<Value = Path> {
    (1e3..50e6f64, 1e3..50e6f64, 100.0..5e6f64, 0.0..0.5f64, 1e5..1e9f64)
        .prop_map(|(up, down, jitter, loss, burst)| Path { up, down, jitter, loss, burst })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn interval_contains_true_offset(seed: u64, path in paths(), ahead in -1_000_000_000i64..1_000_000_000) {
        let mut random = RandomSource::new(seed);
        let (window, retention) = (Span::from_seconds(10), Span::from_seconds(40));
        for host_clocks in host_clock_pairs(Span::from_nanos(ahead), Span::from_seconds(120), &mut random) {
            let mut trips = path.trips(&host_clocks, (0.0, 100.0), 20.0, &mut random);
            delay_some_answers(&mut trips, &mut random);
            let mut band = Band::new(model(), window, retention);
            for trip in &trips {
                let bounds = Bounds::from(&trip.exchange);
                prop_assert!(band.contradiction(&bounds).is_none());
                band.insert(&bounds);
                for from_now in [0.0, random.between(-40e9, 0.0), random.between(0.0, 10e9)] {
                    let at = trip.exchange.returned + Span::from_nanos(from_now as i64);
                    let interval = band.interval(at).expect("has exchanges").interval;
                    let truth = host_clocks.offset(at);
                    prop_assert!(contains(interval, truth), "{interval:?} {truth} {from_now}");
                    prop_assert!(interval.contains(band.estimate(at, interval)));
                }
            }
        }
    }

    #[test]
    fn hulls_stay_in_order_after_sparse_exchanges(
        exchanges in proptest::collection::vec((any::<bool>(), 0i64..200, 1i64..400, 0i64..1_000), 1..120),
    ) {
        let ms = 1_000_000;
        let (mut sent, mut all_bounds) = (0, Vec::new());
        for (is_sparse, gap, round_trip, bound) in exchanges {
            sent += if is_sparse { 2_000 * ms } else { gap * ms };
            let upper = Point { x: sent, bound: bound * ms };
            all_bounds.push(Bounds { upper, lower: Point { x: sent + round_trip * ms, bound: bound * ms } });
        }
        // Answers with a long round trip arrive after answers to later requests.
        all_bounds.sort_by_key(|bounds| bounds.lower.x);
        let limit = DriftLimit::new(LIMIT_PPM);
        let drift = DriftModel { limit, change_limit: Some(DriftChangeLimit::new(1.0, limit)) };
        let mut band = Band::new(drift, Span::from_seconds(10), Span::from_seconds(10));
        for bounds in &all_bounds {
            band.insert(bounds);
            prop_assert!(band.hulls.are_in_order_of_time(), "{:?}", band.hulls);
        }
    }

    #[test]
    fn present_interval_equals_interval_of_all_exchanges(seed: u64, path in paths(), hz in 0.2..50.0f64) {
        let mut random = RandomSource::new(seed);
        let host_clocks = HostClocks {
            edge: SimulatedClock::drifting(Span::ZERO, 0.0),
            cloud: SimulatedClock::wandering(
                Span::from_seconds(1),
                LIMIT_PPM,
                Span::from_seconds(60),
                &mut random,
            ),
        };
        let mut trips = path.trips(&host_clocks, (0.0, 60.0), hz, &mut random);
        delay_some_answers(&mut trips, &mut random);
        let (window, drift) = (Span::from_seconds(10), DriftLimit::new(LIMIT_PPM));
        let mut band = band(window);
        let mut all_bounds: Vec<Bounds> = Vec::new();
        for trip in &trips {
            let bounds = Bounds::from(&trip.exchange);
            band.insert(&bounds);
            all_bounds.push(bounds);
            all_bounds.sort_by_key(|bounds| bounds.lower.x);
            let q = band.newest_return().expect("has exchanges").nanos();
            // The newest exchanges bound the offset at any age.
            let first_at_any_age = all_bounds.len().saturating_sub(MIN_BOUNDING_EXCHANGES);
            let lowest_bound = |point: fn(&Bounds) -> Point, reach: i64| {
                let is_used = |(n, bounds): &(usize, &Bounds)| *n >= first_at_any_age || point(bounds).x >= q - reach;
                let used = all_bounds.iter().enumerate().filter(is_used);
                used.map(|(_, bounds)| point(bounds).bound_at(drift, q)).min().expect("has exchanges")
            };
            let actual = band.interval(RawTime::from_nanos(q)).expect("has exchanges").interval;
            // The band keeps only the best point of each slot of 0.5 s. When this point leaves the window, younger
            // points of its slot are missing, so the bound may be that of a window that is shorter by a slot.
            let shortened_window = window.nanos() - 500_000_000;
            // A lower point is an upper bound of the negated offset.
            for (point, bound) in [
                ((|bounds| bounds.upper) as fn(&Bounds) -> Point, actual.hi.nanos()),
                (|bounds| bounds.lower, -actual.lo.nanos()),
            ] {
                let (best, worst) = (lowest_bound(point, window.nanos()), lowest_bound(point, shortened_window) + 2);
                prop_assert!(best <= bound && bound <= worst, "{best} {bound} {worst}");
            }
        }
    }
}

/// Checks a jump that is smaller than the round trips, so that no exchange contradicts it. The jump makes intervals
/// wrong only for the length of the window.
#[test]
fn undetected_jump_spoils_intervals_for_length_of_window() {
    let jump = Span::from_millis(15);
    let cloud = SimulatedClock::drifting(Span::ZERO, 0.0).stepped(Span::from_seconds(30), jump);
    let host_clocks = HostClocks { edge: SimulatedClock::drifting(Span::ZERO, 0.0), cloud };
    let path = Path { up: 20e6, down: 20e6, jitter: 1e6, loss: 0.0, burst: 0.0 };
    let mut band = band(Span::from_seconds(10));
    let mut wrong_intervals = 0;
    for trip in path.trips(&host_clocks, (0.0, 90.0), 20.0, &mut RandomSource::new(4)) {
        let bounds = Bounds::from(&trip.exchange);
        assert!(band.contradiction(&bounds).is_none(), "the jump is smaller than the round trip");
        band.insert(&bounds);
        let at = trip.exchange.returned;
        let is_inside = contains(band.interval(at).expect("has exchanges").interval, host_clocks.offset(at));
        let is_spoilt = (30e9..40.1e9).contains(&trip.end);
        assert!(is_inside || is_spoilt, "at {}", trip.end);
        wrong_intervals += u32::from(!is_inside);
    }
    assert!(wrong_intervals <= 210, "{wrong_intervals}");
}

#[test]
fn rare_exchanges_bound_offset_at_any_age() {
    let host_clocks = HostClocks {
        edge: SimulatedClock::drifting(Span::ZERO, 0.0),
        cloud: SimulatedClock::drifting(Span::ZERO, 12.0),
    };
    let mut band = band(Span::from_seconds(10));
    let short_trip = host_clocks.trip(0.0, 10e3, 0.0, 10e3);
    band.insert(&Bounds::from(&short_trip.exchange));
    for n in 1..12 {
        let trip = host_clocks.trip(f64::from(n) * 60e9, 900e6, 0.0, 900e6);
        let at = trip.exchange.returned;
        band.insert(&Bounds::from(&trip.exchange));
        let interval = band.interval(at).expect("has exchanges").interval;
        assert!(contains(interval, host_clocks.offset(at)));
        let is_narrow = interval.width() < Span::from_millis(100);
        assert_eq!(is_narrow, n < MIN_BOUNDING_EXCHANGES as i32, "{n}: {interval:?}");
    }
}

/// Checks trips without delay, for which only drift and rounding separate the bounds from the truth.
#[test]
fn interval_without_delay_contains_truth() {
    let mut random = RandomSource::new(11);
    for (n, host_clocks) in
        host_clock_pairs(Span::from_millis(3), Span::from_seconds(700), &mut random).iter().enumerate()
    {
        let mut band = band(Span::from_seconds(600));
        let mut t = 0.0;
        while t < 600e9 {
            let trip = host_clocks.trip(t, 0.0, 0.0, 0.0);
            let bounds = Bounds::from(&trip.exchange);
            assert!(band.contradiction(&bounds).is_none(), "pair {n}");
            band.insert(&bounds);
            for _ in 0..20 {
                let at = host_clocks.edge.shows(random.between(0.0, 650e9).floor());
                let (interval, truth) =
                    (band.interval(at).expect("has exchanges").interval, host_clocks.offset(at));
                assert!(contains(interval, truth), "pair {n}: {interval:?} {truth}");
            }
            t += random.exponential(3e9).floor();
        }
    }
}

/// Returns the mean and the largest distance of the estimate from the truth in microseconds, at the newest exchange,
/// from 10 s on.
fn errors(host_clocks: &HostClocks, path: Path, hz: f64) -> (f64, f64) {
    let mut random = RandomSource::new(7);
    let mut band = band(Span::from_seconds(600));
    let mut errors = Vec::new();
    for trip in path.trips(host_clocks, (0.0, 120.0), hz, &mut random) {
        band.insert(&Bounds::from(&trip.exchange));
        if trip.end > 10e9 {
            let at = trip.exchange.returned;
            let estimate = band.estimate(at, band.interval(at).expect("has exchanges").interval);
            errors.push((estimate.nanos() as f64 - host_clocks.offset(at)).abs() / 1e3);
        }
    }
    (errors.iter().sum::<f64>() / errors.len() as f64, errors.iter().copied().fold(0.0, f64::max))
}

#[test]
fn estimate_is_accurate_on_symmetric_path() {
    let mut random = RandomSource::new(3);
    for (n, host_clocks) in
        host_clock_pairs(Span::from_seconds(-1), Span::from_seconds(120), &mut random).iter().enumerate()
    {
        // The clocks of the last two pairs wander by tens of ppm within seconds, which no crystal does.
        let (max_mean, max_error) = if n < 4 { (2.0, 15.0) } else { (20.0, 150.0) };
        for hz in [10.0, 200.0] {
            let (mean, largest) = errors(host_clocks, Path::VETH, hz);
            assert!(mean < max_mean && largest < max_error, "pair {n}, {hz} Hz: {mean} {largest}");
        }
    }
}

#[test]
fn steady_skew_is_estimated_from_enough_exchanges() {
    let host_clocks = HostClocks {
        edge: SimulatedClock::drifting(Span::ZERO, 0.0),
        cloud: SimulatedClock::drifting(Span::ZERO, 12.0),
    };
    let mut band = band(Span::from_seconds(600));
    for trip in Path::VETH.trips(&host_clocks, (0.0, 60.0), 10.0, &mut RandomSource::new(5)) {
        band.insert(&Bounds::from(&trip.exchange));
        if trip.end < 4e9 {
            assert_eq!(band.skew_ppm(), None);
        }
    }
    let skew = band.skew_ppm().expect("a minute of exchanges");
    assert!((skew - 12.0).abs() < 0.5, "{skew}");
}

#[test]
fn later_exchanges_narrow_past_interval() {
    let host_clocks = HostClocks {
        edge: SimulatedClock::drifting(Span::ZERO, 0.0),
        cloud: SimulatedClock::drifting(Span::ZERO, 30.0),
    };
    let trips = Path::VETH.trips(&host_clocks, (0.0, 60.0), 1.0, &mut RandomSource::new(9));
    let mut band = band(Span::from_seconds(600));
    let at = RawTime::from_nanos(35_000_000_000);
    let (earlier_trips, later_trips) = trips.split_at(20);
    earlier_trips.iter().for_each(|trip| band.insert(&Bounds::from(&trip.exchange)));
    let early = band.interval(at).expect("has exchanges").interval;
    later_trips.iter().for_each(|trip| band.insert(&Bounds::from(&trip.exchange)));
    let late = band.interval(at).expect("has exchanges").interval;
    assert!(late.width().nanos() * 2 < early.width().nanos(), "{early:?} {late:?}");
    assert!(contains(late, host_clocks.offset(at)));
}
