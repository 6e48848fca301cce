//! Tests of jumps that no host reports.

use super::*;

/// There are ten exchanges a second. The middle of their bounds moves by 8 ms from the 20th exchange on, and back from
/// the 40th exchange on.
#[test]
fn suspected_jump_begins_relation_period_and_is_reported_once() {
    let mut clock_state = clock_state();
    let before = clock_state.latest_sample(&network(), now(0)).relation_period;
    let (mut jumps, mut periods) = (Vec::new(), BTreeSet::new());
    for number in 0..60 {
        let sent = number * 100;
        let mut observation = exchange(sent, 0);
        let movement = Span::from_millis(if (20..40).contains(&number) { 8 } else { 0 });
        let stamps = &mut observation.exchange;
        (stamps.received, stamps.replied) = (stamps.received + movement, stamps.replied + movement);
        // The round trip takes 12 ms, so the exchanges before and after the movement do not contradict each other.
        stamps.sent = stamps.sent - Span::from_millis(5);
        stamps.returned = stamps.returned + Span::from_millis(5);
        let (_, changes) = clock_state.judge(&network(), &observation, MESSAGE_DELAYS, now(sent + 9));
        jumps.extend(changes.jump);
        assert!(changes.restart.is_none() && changes.excess_skew.is_none(), "{changes:?}");
        periods.insert(clock_state.latest_sample(&network(), now(sent + 9)).relation_period);
    }
    // The second jump is not reported, because jumps are reported at most once a minute.
    let [jump] = jumps[..] else { panic!("{jumps:?}") };
    assert!(
        (jump.movement - Span::from_millis(8)).abs() < Span::from_millis(1) && jump.unreported == 0,
        "{jump:?}"
    );
    assert!(periods.contains(&before) && periods.len() == 3, "{periods:?}");
}

/// Returns an exchange that was sent at `sent`, with a cloud whose clock is ahead of the edge's by the milliseconds of
/// `ahead`: the first number when the cloud receives the message, the second when it answers. The delays are `up` and 20
/// milliseconds, and `service` is the time on the cloud.
fn exchange_across_jump(sent: i64, ahead: (i64, i64), up: i64, service: i64) -> ExchangeObservation {
    let (received, replied) = (sent + up, sent + up + service);
    let exchange = Exchange {
        sent: RawTime::from_wall(at(sent)),
        received: RawTime::from_wall(at(received + ahead.0)),
        replied: RawTime::from_wall(at(replied + ahead.1)),
        returned: RawTime::from_wall(at(replied + 20)),
        uncertainty: Span::ZERO,
    };
    ExchangeObservation { exchange, ..super::exchange(sent, 0) }
}

/// The cloud's clock jumps by 39 ms. One exchange after the jump does not show it, because its message waited. An answer
/// to a request from before the jump arrives after the exchange that shows the jump.
#[test]
fn samples_around_jump_have_no_exchange_of_other_side() {
    let mut clock_state = clock_state();
    let judge = |clock_state: &mut LinkClockState, observation: &ExchangeObservation| {
        let returned = (observation.exchange.returned - RawTime::from_wall(at(0))).nanos() / MS;
        clock_state.judge(&network(), observation, MESSAGE_DELAYS, now(returned)).1
    };
    for number in 0..25 {
        let _ = judge(&mut clock_state, &exchange_across_jump(number * 100, (0, 0), 20, 2));
    }
    let before = clock_state.latest_sample(&network(), now(2_450)).relation_period;
    let changes = judge(&mut clock_state, &exchange_across_jump(2_500, (39, 39), 60, 2));
    assert!(changes.jump.is_none() && changes.samples.is_empty(), "{changes:?}");

    let first_after_jump = exchange_across_jump(2_600, (39, 39), 20, 2);
    let changes = judge(&mut clock_state, &first_after_jump);
    assert!(changes.jump.is_some() && changes.restart.is_none(), "{changes:?}");
    let [sample] = &changes.samples[..] else { panic!("{changes:?}") };
    assert_eq!((sample.relation_period, sample.upper, sample.lower), (before, None, None));
    assert!(sample.up.is_some_and(|up| up.count == 6), "{sample:?}");

    let changes = judge(&mut clock_state, &exchange_across_jump(2_450, (0, 39), 20, 180));
    assert!(changes.jump.is_none() && changes.samples.is_empty(), "{changes:?}");
    let changes = clock_state.advance_second(now(3_001));
    let [sample] = &changes.samples[..] else { panic!("{changes:?}") };
    assert_ne!(sample.relation_period, before);
    let best = Some(first_after_jump.exchange);
    assert_eq!((sample.upper, sample.lower), (best, best));
}
