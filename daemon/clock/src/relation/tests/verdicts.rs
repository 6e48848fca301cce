use super::*;

#[test]
fn unrelated_clocks_have_no_offset() {
    let relation = relation();
    let delay = relation.delay(Direction::Up, at(1), at(2));
    assert_eq!(delay, OneWayDelay::unsynchronised(Span::from_seconds(1)));
    assert_eq!(relation.offset(at(1), WallTime::default()), None);
}

#[test]
fn shared_clock_gives_exact_delays_until_step() {
    let mut relation = Relation::new(RelationSettings::default());
    relation.set_same_clock(true);
    assert!(relation.is_same_clock());
    let delay = relation.delay(Direction::Down, at(3), at(3) + Span::from_nanos(250));
    assert_eq!((delay.value, delay.source), (Some(Span::from_nanos(250)), DelaySource::SameClock));
    assert_eq!(delay.verdict, Verdict::Ok);

    let host_clocks = HostClocks {
        edge: SimulatedClock::drifting(Span::ZERO, 40.0),
        cloud: SimulatedClock::drifting(Span::ZERO, 40.0),
    };
    for trip in Path::VETH.trips(&host_clocks, (0.0, 5.0), 20.0, &mut RandomSource::new(2)) {
        let judged = relation.judge(&trip.observation());
        assert_eq!(judged.up, OneWayDelay::same_clock(judged.up.raw));
        assert_eq!(judged.down, OneWayDelay::same_clock(judged.down.raw));
    }
    // The shared clock is set forward while the cloud serves. Both delays stay positive, so only the cloud's monotonic
    // clock shows the step.
    let mut observation = host_clocks.trip(6e9, 30e3, 100e3, 30e3).observation();
    observation.exchange.replied = observation.exchange.replied + Span::from_seconds(1);
    observation.exchange.returned = observation.exchange.returned + Span::from_seconds(1);
    observation.cloud_elapsed = Some(Span::from_micros(100));
    let judged = relation.judge(&observation);
    assert_eq!((judged.down.verdict, judged.down.value), (Verdict::Stepped, None));
}

#[test]
fn exchanges_contradict_wrong_proof_of_same_clock() {
    let mut relation = Relation::new(RelationSettings::default());
    relation.set_same_clock(true);
    for trip in
        Path::VETH.trips(&host_clocks(Span::from_millis(5)), (0.0, 5.0), 20.0, &mut RandomSource::new(2))
    {
        let judged = relation.judge(&trip.observation());
        assert_eq!((judged.up.verdict, judged.up.value), (Verdict::Inconsistent, None));
    }
    let offset = relation.offset(at(5), WallTime::default()).expect("two sources");
    assert_eq!(offset.verdict, Verdict::Inconsistent);
    assert_eq!(offset.sources.len(), 2);
    assert!(offset.bounds.contains(Span::ZERO) && offset.bounds.contains(Span::from_millis(5)));
}

#[test]
fn exchanges_relate_clocks_before_and_after_proof() {
    let correct_clock = || SimulatedClock::drifting(Span::ZERO, 0.0);
    let host_clocks = HostClocks { edge: correct_clock(), cloud: correct_clock() };
    let mut relation = relation_with_history(&host_clocks);
    let mut sources = Vec::new();
    for (second, is_proven) in [(11.0, false), (12.0, true), (13.0, false)] {
        relation.set_same_clock(is_proven);
        let trip = host_clocks.trip(second * 1e9, 40e3, 100e3, 30e3);
        let judged = relation.judge(&trip.observation());
        assert!(contains(&judged.up, trip.up) && contains(&judged.down, trip.down));
        sources.push(judged.up.source);
    }
    assert_eq!(sources, [DelaySource::InBand, DelaySource::SameClock, DelaySource::InBand]);
}

#[test]
fn free_running_and_wall_clock_are_never_same_clock() {
    let settings = RelationSettings { clocks: RelatedClocks::RawToWall, ..RelationSettings::default() };
    let mut relation = Relation::new(settings);
    relation.set_same_clock(true);
    assert!(!relation.is_same_clock());
}

#[test]
fn delay_without_fresh_exchange_is_stale() {
    let host_clocks = host_clocks(Span::from_millis(5));
    let mut relation = relation_with_history(&host_clocks);
    // An image whose transfer takes half a second, so the interval is narrow beside the delay and the verdict is not
    // `limited`.
    let trip_with_large_image = |t: f64| host_clocks.trip(t, 500e6, 100e3, 30e3);
    assert_eq!(relation.judge(&trip_with_large_image(10.5e9).observation()).up.verdict, Verdict::Ok);
    let late_trip = trip_with_large_image(40e9);
    let judged = relation.judge(&late_trip.observation());
    assert_eq!((judged.learn_result, judged.up.verdict), (LearnResult::Accepted, Verdict::Stale));
    assert!(contains(&judged.up, late_trip.up) && judged.up.value.is_some());
    // The exchange of the late trip is fresh for the next delay, and for its own delay if that is judged again later.
    assert_eq!(relation.judge(&trip_with_large_image(42e9).observation()).up.verdict, Verdict::Ok);
    let delay_judged_later =
        relation.delay(Direction::Up, late_trip.exchange.sent, late_trip.exchange.received);
    assert_eq!(delay_judged_later.verdict, Verdict::Ok);
    assert_eq!(relation.offset(at(41), WallTime::default()).map(|offset| offset.verdict), Some(Verdict::Ok));
    assert_eq!(
        relation.offset(at(90), WallTime::default()).map(|offset| offset.verdict),
        Some(Verdict::Stale)
    );
}

#[test]
fn delays_of_first_two_exchanges_are_stale() {
    let host_clocks = host_clocks(Span::ZERO);
    let mut relation = relation();
    let verdicts: Vec<Verdict> = (0..4)
        .map(|n| {
            relation.judge(&host_clocks.trip(f64::from(n) * 1e8, 500e6, 1e3, 30e3).observation()).up.verdict
        })
        .collect();
    assert_eq!(verdicts[..2], [Verdict::Stale, Verdict::Stale]);
    assert!(!verdicts[2..].contains(&Verdict::Stale));
}

/// The departure of an answer is first stamped by the program, and later by the kernel.
#[test]
fn exchange_with_better_stamp_counts_once() {
    let host_clocks = host_clocks(Span::ZERO);
    let mut relation = relation();
    let mut last_return = at(0);
    for n in 0..10_u32 {
        let observation = host_clocks.trip(f64::from(n) * 20e9, 1e6, 1e5, 1e6).observation();
        let mut refined = observation;
        refined.exchange.replied = refined.exchange.replied + Span::from_micros(50);
        assert_eq!(relation.learn(&observation), LearnResult::Accepted);
        assert_eq!(relation.refine(&refined), LearnResult::Accepted);
        assert_eq!(relation.exchange_counts().accepted, u64::from(n) + 1);
        last_return = observation.exchange.returned;
        let offset = relation.offset(last_return, WallTime::default()).expect("the clocks are related");
        assert_eq!((offset.exchanges, offset.verdict == Verdict::Stale), (u64::from(n) + 1, n < 2));
    }
    // The newest eight exchanges bound the offset at any age.
    let span = relation.window_span(last_return).expect("it has exchanges");
    assert!(Span::from_seconds(140) <= span && span < Span::from_seconds(141), "{span}");
}

#[test]
fn large_possible_asymmetry_yields_limited_verdict() {
    let host_clocks = host_clocks(Span::ZERO);
    let mut relation = relation();
    let path = Path { up: 40e6, down: 5e6, jitter: 2e6, loss: 0.02, burst: 5e6 };
    let mut last = None;
    for trip in path.trips(&host_clocks, (0.0, 20.0), 10.0, &mut RandomSource::new(8)) {
        let judged = relation.judge(&trip.observation());
        assert!(contains(&judged.up, trip.up) && contains(&judged.down, trip.down));
        last = Some(judged);
    }
    let judged = last.expect("some exchanges are not lost");
    assert_eq!((judged.up.verdict, judged.down.verdict), (Verdict::Limited, Verdict::Limited));
    let width = judged.up.bounds.expect("bounds").width();
    assert!(width < Span::from_millis(47), "{width} is not close to the shortest round trip, which is 45 ms");
}

#[test]
fn offset_states_age_and_number_of_exchanges() {
    let host_clocks = host_clocks(Span::from_millis(-7));
    let relation = relation_with_history(&host_clocks);
    let offset = relation.offset(at(12), WallTime::default()).expect("the clocks are related");
    assert_eq!((offset.source, offset.verdict), (DelaySource::InBand, Verdict::Ok));
    assert_eq!(offset.sources, [(DelaySource::InBand, offset.bounds)]);
    assert_eq!(offset.exchanges, relation.exchange_counts().accepted);
    let age = offset.age.expect("the clocks are related");
    assert!(Span::from_seconds(2) <= age && age < Span::from_seconds(3), "{age}");
    assert!((offset.skew_ppm.expect("the exchanges of ten seconds have a skew") - 10.0).abs() < 5.0);
    assert!(offset.bounds.contains(offset.estimate));
    assert!(relation.memory_bytes() > 0);
}
