use proptest::prelude::*;

use super::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn interval_of_judged_delay_contains_truth(
        seed: u64,
        up in 1e3..100e6f64,
        down in 1e3..100e6f64,
        jitter in 1e2..5e6f64,
        is_edge_clock_wrong: bool,
        ppm in prop_oneof![Just(-50.0), Just(50.0), -50.0..50.0f64],
    ) {
        let mut random = RandomSource::new(seed);
        let wrong_clock = SimulatedClock::drifting(Span::from_seconds(1), ppm);
        let correct_clock = SimulatedClock::drifting(Span::ZERO, 0.0);
        let host_clocks =
            if is_edge_clock_wrong {
                HostClocks { edge: wrong_clock, cloud: correct_clock }
            } else {
                HostClocks { edge: correct_clock, cloud: wrong_clock }
            };
        let path = Path { up, down, jitter, loss: 0.02, burst: 20.0 * jitter };
        let trips = path.trips(&host_clocks, (0.0, 60.0), 30.0, &mut random);
        let mut relation = relation();
        for (count, trip) in trips.iter().enumerate() {
            let judged = relation.judge(&trip.observation());
            // Jitter alone looks like a jump now and then, which makes no delay wrong.
            prop_assert!(!matches!(judged.learn_result, LearnResult::Restarted(_) | LearnResult::Refused(_)), "{:?}", judged.learn_result);
            for (delay, truth) in [(judged.up, trip.up), (judged.down, trip.down)] {
                prop_assert!(contains(&delay, truth), "{delay:?} {truth}");
                let (value, bounds) = (delay.value.expect("has a value"), delay.bounds.expect("has bounds"));
                prop_assert!(bounds.contains(value) && !bounds.lo.is_negative());
                prop_assert_eq!(delay.source, DelaySource::InBand);
                prop_assert_eq!(delay.verdict == Verdict::Stale, count < 2);
            }
            // The exchange itself determines the sum of both delays, up to a few times the largest drift between its
            // start and its end. The 10 ns allow for the rounding of the stamps.
            let sum = judged.up.value.expect("a value") + judged.down.value.expect("a value");
            let slack = Span::from_nanos(relation.bands.limit().max_change_over((trip.exchange.returned - trip.exchange.sent).nanos()) + 10);
            prop_assert!((sum - (trip.up + trip.down)).abs() <= slack + slack + slack, "{sum} {} {}", trip.up, trip.down);
        }
    }

    #[test]
    fn delay_judged_later_contains_truth(seed: u64, wander in 0.0..50.0f64) {
        let mut random = RandomSource::new(seed);
        let length = Span::from_seconds(60);
        let host_clocks = HostClocks {
            edge: SimulatedClock::drifting(Span::ZERO, 0.0),
            cloud: SimulatedClock::wandering(Span::from_seconds(-1), wander, length, &mut random),
        };
        let trips = Path { loss: 0.3, ..Path::VETH }.trips(&host_clocks, (0.0, 60.0), 2.0, &mut random);
        let settings = RelationSettings { clocks: RelatedClocks::Wall, retention: length, ..RelationSettings::default() };
        let mut relation = Relation::new(settings);
        let first: Vec<JudgedExchange> = trips.iter().map(|trip| relation.judge(&trip.observation())).collect();
        for (trip, first) in trips.iter().zip(first) {
            let exchange = &trip.exchange;
            let up = relation.delay(Direction::Up, exchange.sent, exchange.received);
            let down = relation.delay(Direction::Down, exchange.replied, exchange.returned);
            for (late, early, truth) in [(up, first.up, trip.up), (down, first.down, trip.down)] {
                prop_assert!(contains(&late, truth));
                prop_assert_eq!(late.raw, early.raw);
            }
        }
    }

    #[test]
    fn interval_of_reception_difference_contains_truth(seed: u64, ppm in -50.0..50.0f64, late in 0..200_000_000i64) {
        let mut random = RandomSource::new(seed);
        let host_clocks = HostClocks {
            edge: SimulatedClock::drifting(Span::ZERO, 0.0),
            cloud: SimulatedClock::drifting(Span::from_seconds(9), ppm),
        };
        let mut relation = relation();
        // The edge's receiver gets the message this long after the edge sends the message. The receiver gets the answer
        // this long after the answer arrives at the edge.
        let late = Span::from_nanos(late);
        for (count, trip) in Path::VETH.trips(&host_clocks, (0.0, 5.0), 20.0, &mut random).iter().enumerate() {
            let exchange = &trip.exchange;
            let up = (exchange.sent + late, exchange.received);
            let down = (exchange.replied, exchange.returned + late);
            let differences = relation.reception_differences(up, down);
            let counts = relation.exchange_counts();
            for (difference, truth) in differences.iter().zip([trip.up - late, trip.down + late]) {
                prop_assert_eq!(difference.verdict == Verdict::Unsynchronised, count == 0);
                prop_assert!(count == 0 || contains(difference, truth), "{difference:?} {truth}");
            }
            let single_difference = relation.reception_difference(Direction::Up, up.0, up.1);
            prop_assert_eq!(single_difference.bounds, differences[0].bounds);
            prop_assert_eq!(relation.exchange_counts(), counts, "the relation learns nothing from a reception difference");
            relation.learn(&trip.observation());
        }
    }
}

/// The path connects two network namespaces of one machine. The clocks are one second apart and drift by 50 ppm.
#[test]
fn intervals_of_ten_thousand_iterations_contain_truth() {
    for (edge, cloud) in [((1, 50.0), (0, 0.0)), ((-1, -50.0), (0, 0.0)), ((0, 0.0), (1, -50.0))] {
        let wall = |(seconds, ppm)| SimulatedClock::drifting(Span::from_seconds(seconds), ppm);
        let host_clocks = HostClocks { edge: wall(edge), cloud: wall(cloud) };
        let mut relation = relation();
        let (mut errors, mut judged_delays) = (0.0, 0u32);
        for trip in Path::VETH.trips(&host_clocks, (0.0, 100.0), 100.0, &mut RandomSource::new(4)) {
            let JudgedExchange { up, down, .. } = relation.judge(&trip.observation());
            for (delay, truth) in [(up, trip.up), (down, trip.down)] {
                assert!(contains(&delay, truth), "{delay:?} {truth}");
                errors += (delay.value.expect("a value") - truth).abs().seconds() * 1e6;
                judged_delays += 1;
            }
        }
        let mean = errors / f64::from(judged_delays);
        assert!(judged_delays > 19_000 && mean < 15.0, "{judged_delays} {mean} µs");
    }
}

#[test]
fn exchange_with_long_service_and_drift_is_accepted() {
    let host_clocks = HostClocks {
        edge: SimulatedClock::drifting(Span::ZERO, 0.0),
        cloud: SimulatedClock::drifting(Span::ZERO, 50.0),
    };
    let mut relation = relation();
    for n in 0..20 {
        // Ten seconds of service: the cloud's clock gains 500 µs meanwhile, and both directions together take 60 µs.
        let trip = host_clocks.trip(f64::from(n) * 1e9, 30e3, 10e9, 30e3);
        let judged = relation.judge(&trip.observation());
        assert_eq!(judged.learn_result, LearnResult::Accepted);
        assert!(contains(&judged.up, trip.up) && contains(&judged.down, trip.down));
    }
}

/// A second of one clock is not a second of the other clock. The interval contains the delay as measured by either
/// clock.
#[test]
fn interval_of_long_delay_holds_by_either_clock() {
    let host_clocks = HostClocks {
        edge: SimulatedClock::drifting(Span::ZERO, 0.0),
        cloud: SimulatedClock::drifting(Span::ZERO, 50.0),
    };
    let mut relation = relation();
    for n in 0..100 {
        relation.learn(&host_clocks.trip(f64::from(n) * 1e8, 500.0, 1e3, 500.0).observation());
    }
    let judged = relation.judge(&host_clocks.trip(10e9, 5e9, 1e3, 5e9).observation());
    for delay in [judged.up, judged.down] {
        let bounds = delay.bounds.expect("the clocks are related");
        assert!(bounds.contains(Span::from_seconds(5)), "{delay:?}");
        assert!(bounds.contains(Span::from_seconds(5) + Span::from_micros(250)), "{delay:?}");
    }
}
