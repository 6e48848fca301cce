use proptest::prelude::*;

use super::*;
use crate::ClockClaim;

proptest! {
    #[test]
    fn arbitrary_stamps_of_a_peer_change_nothing(stamps: Vec<(i64, i64, u32)>) {
        let host_clocks = host_clocks(Span::from_millis(3));
        let mut relation = relation_with_history(&host_clocks);
        let before = all_intervals(&relation);
        for (n, (received, replied, epoch)) in stamps.into_iter().enumerate() {
            let mut wrong_observation = host_clocks.trip(10e9 + n as f64 * 1e7, 3e4, 1e5, 3e4).observation();
            wrong_observation.exchange.received = RawTime::from_nanos(received);
            wrong_observation.exchange.replied = RawTime::from_nanos(replied);
            // Only an impossible exchange has an epoch here: a new epoch of a possible exchange starts a new band.
            wrong_observation.cloud_epoch = Some(epoch).filter(|_| received > replied);
            let judged = relation.judge(&wrong_observation);
            prop_assert!(matches!(judged.learn_result, LearnResult::Refused(_)));
            prop_assert_eq!((judged.up.value, judged.down.value), (None, None));
        }
        prop_assert_eq!(all_intervals(&relation), before);
        prop_assert_eq!(relation.exchange_counts().restarts, 0);
    }

    #[test]
    fn arbitrary_stamps_never_panic(
            stamps: [i64; 4],
            shifts: [u32; 6],
            uncertainty: i64,
            elapsed: Option<i64>,
            epoch: u32,
            at: i64,
        ) {
        let [sent, received, replied, returned] = stamps.map(RawTime::from_nanos);
        let uncertainty = Span::from_nanos(uncertainty);
        let observation = ExchangeObservation {
            exchange: Exchange { sent, received, replied, returned, uncertainty },
            cloud_elapsed: elapsed.map(Span::from_nanos),
            edge_epoch: epoch,
            cloud_epoch: Some(epoch),
        };
        for clocks in [RelatedClocks::Wall, RelatedClocks::Raw] {
            let settings = RelationSettings { clocks, ..RelationSettings::default() };
            let mut relation = Relation::new(settings);
            for shift in shifts.map(|nanos| Span::from_nanos(i64::from(nanos) << 28)) {
                let exchange = Exchange { sent: sent + shift, returned: returned + shift, ..observation.exchange };
                relation.judge(&observation);
                relation.judge(&ExchangeObservation { exchange, ..observation });
                relation.delay(Direction::Down, returned, sent);
                relation.offset(RawTime::from_nanos(at), WallTime::default());
            }
        }
    }

    #[test]
    fn isolated_outliers_change_nothing(seed: u64, by in prop_oneof![-1e9..-1e5f64, 1e5..1e9f64]) {
        let host_clocks = host_clocks(Span::from_millis(3));
        let (mut honest_relation, mut deceived_relation) = (relation_with_history(&host_clocks), relation_with_history(&host_clocks));
        let mut random = RandomSource::new(seed);
        let quiet_path = Path { burst: 0.0, ..Path::VETH };
        let mut wrong_observations = 0;
        for (n, trip) in quiet_path.trips(&host_clocks, (10.0, 30.0), 20.0, &mut random).iter().enumerate() {
            honest_relation.learn(&trip.observation());
            deceived_relation.learn(&trip.observation());
            // Three of four correct exchanges are followed by a wrong exchange.
            if n % 4 < 3 {
                let mut wrong_observation = host_clocks.trip(trip.end, 3e4, 1e5, 3e4).observation();
                wrong_observation.exchange.received = wrong_observation.exchange.received + Span::from_nanos(by as i64);
                wrong_observation.exchange.replied = wrong_observation.exchange.replied + Span::from_nanos(by as i64);
                let learn_result = deceived_relation.learn(&wrong_observation);
                prop_assert_eq!(learn_result, LearnResult::Refused(Refusal::Outlier));
                wrong_observations += 1;
            }
        }
        prop_assert_eq!(all_intervals(&honest_relation), all_intervals(&deceived_relation));
        prop_assert_eq!(deceived_relation.exchange_counts().outliers, wrong_observations);
        prop_assert_eq!(deceived_relation.exchange_counts().restarts, 0);
    }
}

#[test]
fn repeated_wrong_exchange_counts_once() {
    let mut relation = relation_with_history(&host_clocks(Span::ZERO));
    let before = all_intervals(&relation);
    let wrong_observation = host_clocks(Span::from_millis(40)).trip(10e9, 3e4, 1e5, 3e4).observation();
    for _ in 0..20 {
        assert_eq!(relation.learn(&wrong_observation), LearnResult::Refused(Refusal::Outlier));
    }
    assert_eq!(all_intervals(&relation), before);
}

#[test]
fn wide_exchange_does_not_end_suspicion() {
    let (before, after) = (host_clocks(Span::ZERO), host_clocks(Span::from_millis(1)));
    let mut relation = relation_with_history(&before);
    // Every second exchange is wide and agrees with both offsets. The fourth narrow exchange (`n` is 6) proves the
    // step.
    let learn_results: Vec<LearnResult> = (0..8)
        .map(|n| {
            let one_way = if n % 2 == 0 { 3e4 } else { 5e6 };
            let judged =
                relation.judge(&after.trip(10e9 + f64::from(n) * 1e8, one_way, 1e5, one_way).observation());
            let is_trusted = matches!(judged.up.verdict, Verdict::Ok | Verdict::Limited);
            assert!(!is_trusted || n >= 6, "{n} {judged:?}");
            judged.learn_result
        })
        .collect();
    assert!(matches!(learn_results[6], LearnResult::Restarted(_)), "{learn_results:?}");
}

#[test]
fn impossible_exchanges_are_recognised() {
    let host_clocks = host_clocks(Span::ZERO);
    let mut relation = relation_with_history(&host_clocks);
    let result_after = |edit: fn(&mut Exchange)| {
        let mut observation = host_clocks.trip(10e9, 3e4, 1e5, 3e4).observation();
        edit(&mut observation.exchange);
        (relation.learn(&observation), relation.exchange_counts().impossible)
    };
    let edits: [fn(&mut Exchange); 5] = [
        |exchange| exchange.replied = exchange.received - Span::from_nanos(1),
        |exchange| exchange.returned = exchange.sent - Span::from_nanos(1),
        |exchange| exchange.replied = exchange.received + Span::from_seconds(1),
        |exchange| exchange.uncertainty = Span::from_nanos(-1),
        |exchange| exchange.received = RawTime::from_nanos(i64::MIN),
    ];
    let impossible = LearnResult::Refused(Refusal::Impossible);
    let refusals: Vec<_> = edits.into_iter().map(result_after).collect();
    assert_eq!(refusals, (1..=5).map(|count| (impossible, count)).collect::<Vec<_>>());
}

/// A peer that shifts both of its stamps by the same amount looks like a peer with another clock; exchanges cannot
/// detect this. Claims of both hosts' time daemons can, because they do not depend on the peer's stamps.
#[test]
fn consistently_wrong_stamps_contradict_time_daemons_only() {
    let (true_clocks, claimed_clocks) = (host_clocks(Span::ZERO), host_clocks(Span::from_millis(40)));
    let mut relation = relation_with_history(&true_clocks);
    let trips = Path::VETH.trips(&claimed_clocks, (10.0, 20.0), 20.0, &mut RandomSource::new(3));
    for trip in &trips {
        relation.learn(&trip.observation());
    }
    let offset = relation.offset(at(20), WallTime::default()).expect("the clocks are related");
    assert_eq!((offset.verdict, relation.exchange_counts().restarts), (Verdict::Ok, 1));
    assert!((offset.estimate - Span::from_millis(40)).abs() < Span::from_millis(1));

    let claimed_error = Interval { lo: Span::from_millis(-2), hi: Span::from_millis(2) };
    let claim = ClockClaim { source: DelaySource::Chrony, error: claimed_error };
    relation.set_claims(Some(claim), Some(claim), at(20));
    let offset = relation.offset(at(20), WallTime::default()).expect("the clocks are related");
    assert_eq!(offset.verdict, Verdict::Inconsistent);
    let trip = claimed_clocks.trip(20e9, 3e4, 1e5, 3e4);
    let judged = relation.judge(&trip.observation());
    assert_eq!((judged.up.verdict, judged.up.value, judged.up.bounds), (Verdict::Inconsistent, None, None));
}

#[test]
fn drift_beyond_limit_withdraws_all_delays() {
    let host_clocks = HostClocks {
        edge: SimulatedClock::drifting(Span::ZERO, 0.0),
        cloud: SimulatedClock::drifting(Span::ZERO, 400.0),
    };
    let mut relation = relation();
    let mut random = RandomSource::new(5);
    let quiet_path = Path { burst: 0.0, ..Path::VETH };
    let trips = quiet_path.trips(&host_clocks, (10.0, 40.0), 50.0, &mut random);
    let (early, late) = trips.split_at(trips.len() / 3);
    for trip in early {
        relation.judge(&trip.observation());
    }
    assert!(relation.violates_limit(), "{:?}", relation.exchange_counts());
    for trip in late {
        let judged = relation.judge(&trip.observation());
        assert_eq!((judged.up.value, judged.down.value), (None, None));
        assert!(!matches!(judged.up.verdict, Verdict::Ok | Verdict::Limited | Verdict::Stale));
    }
}

#[test]
fn rare_unannounced_steps_violate_no_limit() {
    let cloud = SimulatedClock::drifting(Span::ZERO, 10.0)
        .stepped(Span::from_seconds(20), Span::from_millis(50))
        .stepped(Span::from_seconds(100), Span::from_millis(-70));
    let host_clocks = HostClocks { edge: SimulatedClock::drifting(Span::ZERO, 0.0), cloud };
    let mut relation = relation();
    for trip in Path::VETH.trips(&host_clocks, (10.0, 130.0), 20.0, &mut RandomSource::new(6)) {
        relation.judge(&trip.observation());
        assert!(!relation.violates_limit());
    }
    assert_eq!(relation.exchange_counts().restarts, 2);
}

#[test]
fn suspicion_ends_with_window_if_nothing_refutes_it() {
    let (before, after) = (host_clocks(Span::ZERO), host_clocks(Span::from_millis(1)));
    let mut relation = relation_with_history(&before);
    let wrong_observation = after.trip(10e9, 3e4, 1e5, 3e4).observation();
    assert_eq!(relation.learn(&wrong_observation), LearnResult::Refused(Refusal::Outlier));
    let is_trusted = |judged: &JudgedExchange| matches!(judged.up.verdict, Verdict::Ok | Verdict::Limited);
    for n in 1..=120 {
        let seconds = 10.0 + f64::from(n) / 10.0;
        let judged = relation.judge(&before.trip(seconds * 1e9, 5e6, 1e5, 5e6).observation());
        // The suspect is from 10 s. It contradicts exchanges with short round trips. The last of these exchanges
        // returned at 9.5 s and leaves the window of 10 s at 19.5 s. The suspect leaves the window at 20 s.
        assert!(seconds < 20.2 || is_trusted(&judged), "{seconds} s: {judged:?}");
        assert!(seconds > 19.4 || !is_trusted(&judged), "{seconds} s: {judged:?}");
    }
}

/// The newest eight exchanges bound the offset at any age. While some of them are older than the suspect, either these
/// or the suspect may be wrong.
#[test]
fn suspicion_lasts_while_earlier_rare_exchanges_count() {
    let (before, after) = (host_clocks(Span::ZERO), host_clocks(Span::from_millis(1)));
    let mut relation = relation_with_history(&before);
    assert_eq!(
        relation.learn(&after.trip(10e9, 3e4, 1e5, 3e4).observation()),
        LearnResult::Refused(Refusal::Outlier)
    );
    for n in 1..=12 {
        let at = 10.0 + f64::from(n) * 6.0;
        let judged = relation.judge(&before.trip(at * 1e9, 1.5e7, 1e5, 1.5e7).observation());
        let is_trusted = matches!(judged.up.verdict, Verdict::Ok | Verdict::Limited);
        assert!(n > 7 || !is_trusted, "exchange {n}: {judged:?}");
        assert!(n < 9 || is_trusted, "exchange {n}: {judged:?}");
    }
}
