use super::*;

const STEP: Span = Span::from_seconds(3);

/// Returns host clocks. The edge's clock is stepped by `by` at the tenth second.
fn with_edge_step(by: Span) -> HostClocks {
    let host_clocks = host_clocks(Span::from_millis(5));
    HostClocks { edge: host_clocks.edge.stepped(Span::from_seconds(10), by), ..host_clocks }
}

fn with_cloud_step(by: Span) -> HostClocks {
    let host_clocks = host_clocks(Span::from_millis(5));
    HostClocks { cloud: host_clocks.cloud.stepped(Span::from_seconds(10), by), ..host_clocks }
}

/// Judges ten exchanges per second until the tenth second, then a hundred per second for three seconds. `observe` adds
/// the epochs that the hosts report.
///
/// Returns the time from the step to the first `ok` or `limited` delay, and the relation. Panics if such a delay does
/// not contain the truth.
fn judge_across_step(
    host_clocks: &HostClocks,
    observe: impl Fn(&Trip) -> ExchangeObservation,
) -> (Option<f64>, Relation) {
    let mut relation = relation_with_history(host_clocks);
    let mut recovery_time = None;
    for trip in Path::VETH.trips(host_clocks, (9.95, 13.0), 100.0, &mut RandomSource::new(6)) {
        let JudgedExchange { up, down, .. } = relation.judge(&observe(&trip));
        for (delay, truth) in [(up, trip.up), (down, trip.down)] {
            let is_trusted = matches!(delay.verdict, Verdict::Ok | Verdict::Limited);
            assert!(!is_trusted || contains(&delay, truth), "{delay:?} {truth} at {}", trip.end);
            // An exchange that ends within 2 ms of the step may have stamps from before the step. It shows no
            // recovery.
            if is_trusted && trip.end > 10.002e9 {
                recovery_time.get_or_insert(trip.end / 1e9 - 10.0);
            }
        }
    }
    (recovery_time, relation)
}

#[test]
fn reported_step_starts_new_window_at_once() {
    for by in [STEP, -STEP, Span::from_micros(30), Span::from_micros(-30), Span::from_seconds(-3600)] {
        for host_clocks in [with_edge_step(by), with_cloud_step(by)] {
            let is_edge_stepped = host_clocks.edge.error(20e9) != 0.0;
            let (recovery_time, relation) = judge_across_step(&host_clocks, |trip| {
                let epoch = u32::from(trip.end >= 10e9);
                let (edge_epoch, cloud_epoch) = if is_edge_stepped { (epoch, 0) } else { (0, epoch) };
                ExchangeObservation { edge_epoch, cloud_epoch: Some(cloud_epoch), ..trip.observation() }
            });
            assert_eq!(relation.exchange_counts().restarts, 1);
            // Exchanges are excluded by their stamps on the edge. After a step of some seconds, stamps from after the
            // step can be within the reach of the exclusion, which is 2 s for a step of the edge. After a larger step,
            // no stamp is within the reach.
            let max_recovery_time =
                if by.abs() < Span::from_seconds(10) { by.abs().seconds().min(2.0) + 0.3 } else { 0.3 };
            assert!(recovery_time.is_some_and(|after| after < max_recovery_time), "{by} {recovery_time:?}");
        }
    }
}

#[test]
fn unannounced_step_is_accepted_after_agreement() {
    for by in [STEP, -STEP, Span::from_millis(20), Span::from_millis(-20)] {
        for host_clocks in [with_edge_step(by), with_cloud_step(by)] {
            let (recovery_time, relation) = judge_across_step(&host_clocks, Trip::observation);
            assert_eq!(relation.exchange_counts().restarts, 1, "{by}");
            assert!(recovery_time.is_some_and(|after| after < 0.5), "{by} {recovery_time:?}");
        }
    }
}

#[test]
fn first_exchange_after_step_states_step_size() {
    let host_clocks = with_cloud_step(STEP);
    let mut relation = relation_with_history(&host_clocks);
    let mut sizes = Vec::new();
    for trip in Path::VETH.trips(&host_clocks, (10.0, 11.0), 50.0, &mut RandomSource::new(6)) {
        if let LearnResult::Restarted(by) =
            relation.learn(&ExchangeObservation { cloud_epoch: Some(1), ..trip.observation() })
        {
            sizes.push(by.expect("the offset was known before the step"));
        }
    }
    assert_eq!(sizes.len(), 1);
    assert!((sizes[0] - STEP).abs() < Span::from_millis(1), "{}", sizes[0]);
}

#[test]
fn exchange_spanning_cloud_step_is_refused() {
    let host_clocks = host_clocks(Span::ZERO);
    let mut relation = relation_with_history(&host_clocks);
    let before = all_intervals(&relation);
    let trip = host_clocks.trip(10e9, 300e3, 1e6, 300e3);
    let observation_with_step = |by: i64| ExchangeObservation {
        cloud_elapsed: Some(trip.exchange.replied - trip.exchange.received + Span::from_micros(by)),
        ..trip.observation()
    };
    // The relation tolerates a difference of 50 µs between the cloud's clock and its monotonic clock.
    for by in [60, -60] {
        assert_eq!(relation.learn(&observation_with_step(by)), LearnResult::Refused(Refusal::Stepped));
    }
    assert_eq!(all_intervals(&relation), before);
    assert_eq!(relation.learn(&observation_with_step(40)), LearnResult::Accepted);
    // In ten seconds, a cloud's clock with an injected drift of -100 ppm loses 1 ms. This is no step.
    let long_trip = host_clocks.trip(11e9, 300e3, 10e9, 300e3);
    let elapsed = long_trip.exchange.replied - long_trip.exchange.received;
    let drifted = ExchangeObservation {
        cloud_elapsed: Some(elapsed + Span::from_millis(1)),
        ..long_trip.observation()
    };
    assert_eq!(relation.learn(&drifted), LearnResult::Accepted);
}

/// The step is too small for the comparison with the monotonic clock, so only the epoch shows the step. The epoch was
/// read after the stamps, so even the exchange that reports the step may have been sent before the step.
#[test]
fn exchange_sent_before_step_report_is_refused() {
    for (host_clocks, edge_epoch, cloud_epoch) in
        [(with_cloud_step(Span::from_micros(-40)), 0, 1), (with_edge_step(Span::from_micros(40)), 1, 0)]
    {
        let observation_of = |trip: Trip| ExchangeObservation {
            edge_epoch,
            cloud_epoch: Some(cloud_epoch),
            ..trip.observation()
        };
        let mut relation = relation_with_history(&host_clocks);
        let (reporting_trip, spanning_trip) =
            (host_clocks.trip(10.0001e9, 3e4, 1e4, 3e4), host_clocks.trip(9.9999e9, 5e4, 2e5, 5e4));
        assert_eq!(relation.learn(&observation_of(reporting_trip)), LearnResult::Refused(Refusal::Stepped));
        assert_eq!(relation.exchange_counts().restarts, 1);
        assert_eq!(relation.learn(&observation_of(spanning_trip)), LearnResult::Refused(Refusal::Stepped));
        let after = relation.learn(&observation_of(host_clocks.trip(10.001e9, 3e4, 1e4, 3e4)));
        assert!(matches!(after, LearnResult::Restarted(Some(_))), "{after:?}");
    }
}

#[test]
fn step_report_ends_window_once() {
    let host_clocks = with_cloud_step(STEP);
    let mut relation = relation_with_history(&host_clocks);
    relation.restart_after_cloud_step(1);
    assert_eq!(
        (relation.exchange_counts().restarts, relation.offset(at(10), WallTime::default())),
        (1, None)
    );
    relation.restart_after_cloud_step(1);
    let observation_of = |trip: Trip| ExchangeObservation { cloud_epoch: Some(1), ..trip.observation() };
    // The first exchange may have been in flight during the step.
    let first = relation.judge(&observation_of(host_clocks.trip(10.1e9, 3e4, 1e5, 3e4)));
    assert_eq!(first.learn_result, LearnResult::Refused(Refusal::Stepped));
    for delay in [first.up, first.down] {
        assert_eq!(
            (delay.value, delay.verdict),
            (None, Verdict::Stepped),
            "the clocks were related before the step"
        );
    }
    let second = relation.learn(&observation_of(host_clocks.trip(10.2e9, 3e4, 1e5, 3e4)));
    assert!(matches!(second, LearnResult::Restarted(Some(_))), "{second:?}");
    relation.restart_after_cloud_step(1);
    relation.restart_after_edge_step(0);
    assert_eq!(relation.exchange_counts().restarts, 1);
    relation.restart_after_edge_step(1);
    assert_eq!(relation.exchange_counts().restarts, 2);
}

#[test]
fn lower_epoch_is_refused_until_restart_is_assumed() {
    let host_clocks = host_clocks(Span::ZERO);
    let mut relation = relation();
    let observation_of = |n: u32, epoch| ExchangeObservation {
        cloud_epoch: Some(epoch),
        ..host_clocks.trip(f64::from(n) * 1e8, 3e4, 1e5, 3e4).observation()
    };
    (0..5).for_each(|n| assert_eq!(relation.learn(&observation_of(n, 7)), LearnResult::Accepted));
    // Two lower epochs in a row may come from late answers.
    for n in 5..20 {
        let epoch = if n % 3 == 0 { 7 } else { 6 };
        let learn_result = relation.learn(&observation_of(n, epoch));
        assert_eq!(learn_result == LearnResult::Accepted, epoch == 7);
    }
    assert_eq!(relation.exchange_counts().restarts, 0);
    // The agent of the cloud was restarted, so its epochs begin at 0 again.
    let learn_results: Vec<LearnResult> = (20..40).map(|n| relation.learn(&observation_of(n, 0))).collect();
    assert_eq!(relation.exchange_counts().restarts, 1);
    // The eighth answer in a row with a lower epoch shows the restart and is itself refused. The ninth answer starts a
    // new band.
    assert!(matches!(learn_results[8], LearnResult::Restarted(_)), "{learn_results:?}");
    assert!(learn_results[9..].iter().all(|learn_result| *learn_result == LearnResult::Accepted));
}

/// A clock is set while the cloud computes an answer, and no host reports it. The exchanges that show the step end before
/// this answer arrives.
#[test]
fn exchange_across_unannounced_step_is_refused() {
    for host_clocks in [with_edge_step(STEP), with_cloud_step(-STEP)] {
        let mut relation = relation_with_history(&host_clocks);
        let trip = |t: f64, service: f64| host_clocks.trip(t * 1e9, 3e4, service, 3e4);
        (1..=5).for_each(|n| _ = relation.learn(&trip(10.0 + f64::from(n) / 10.0, 1e5).observation()));
        assert_eq!(relation.exchange_counts().restarts, 1);
        let judged = relation.judge(&trip(9.9, 5e9).observation());
        assert_eq!(judged.learn_result, LearnResult::Refused(Refusal::Stepped));
        for delay in [judged.up, judged.down] {
            assert_eq!((delay.value, delay.verdict), (None, Verdict::Stepped));
        }
        // The new band does not bound the offset before the step.
        let before = trip(9.8, 1e5).exchange;
        assert_eq!(relation.delay(Direction::Up, before.sent, before.received).bounds, None);
        let after = trip(11.0, 1e5);
        let delay = relation.delay(Direction::Up, after.exchange.sent, after.exchange.received);
        assert!(contains(&delay, after.up), "{delay:?}");
    }
}
