//! Tests of seconds, relation periods and restarts. The relation itself is tested in the crate `clock`.

mod jumps;

use peernet_clock::{ClockClaim, Exchange, Interval, RelationSettings, Verdict};
use peernet_networks::RawClock;

use super::*;

const MS: i64 = 1_000_000;
/// Argument of [`LinkClockState::handle_probe_result`].
const IS_AUTHENTICATED: bool = true;
const MESSAGE_DELAY: MessageDelay = MessageDelay { raw: Span::ZERO, bits: None };
const MESSAGE_DELAYS: [MessageDelay; 2] = [MESSAGE_DELAY, MESSAGE_DELAY];

fn at(millis: i64) -> WallTime {
    WallTime::from_unix_nanos(1_000_000 * MS + millis * MS)
}

/// Returns the stamp of the edge's clocks at `at(millis)`.
fn now(millis: i64) -> Stamp {
    Stamp { wall: at(millis), raw: RawTime::from_wall(at(millis)), ..Stamp::default() }
}

/// Returns a host's announcement in this epoch of its free-running clock, which agrees with its wall clock.
fn announcement(epoch: u32, claim: Option<ClockClaim>) -> PeerClock {
    let wall_ahead = Interval::exactly(Span::ZERO);
    let raw = Some(RawClock { epoch, wall_ahead, clocksource: "tsc".into() });
    PeerClock { raw, claim, ..PeerClock::default() }
}

/// Returns an exchange that was sent at `sent`, with a cloud whose clock is `ahead` milliseconds ahead of the edge's.
/// The delays are 1 ms in each direction and 2 ms on the cloud.
fn exchange(sent: i64, ahead: i64) -> ExchangeObservation {
    let exchange = Exchange {
        sent: RawTime::from_wall(at(sent)),
        received: RawTime::from_wall(at(sent + 1 + ahead)),
        replied: RawTime::from_wall(at(sent + 3 + ahead)),
        returned: RawTime::from_wall(at(sent + 4)),
        uncertainty: Span::ZERO,
    };
    ExchangeObservation { exchange, cloud_elapsed: None, edge_epoch: 0, cloud_epoch: Some(0) }
}

fn clock_state() -> LinkClockState {
    clock_state_of(RelatedClocks::Raw)
}

fn clock_state_of(clocks: RelatedClocks) -> LinkClockState {
    let settings = RelationSettings { clocks, trust_time_daemons: true, ..RelationSettings::default() };
    let relation = Relation::new(settings);
    let peer = (HostId::random(), "cloud".parse().expect("a name"));
    let mut clock_state =
        LinkClockState::new(peer, relation, (announcement(0, None), announcement(0, None)), now(0));
    clock_state.join(&network());
    clock_state
}

fn network() -> NetworkName {
    NetworkName::default()
}

#[test]
fn announcement_without_step_keeps_relation_period() {
    let mut clock_state = clock_state();
    clock_state.handle_edge_announcement(announcement(0, None), now(0).raw);
    let _ = clock_state.handle_cloud_announcement(announcement(0, None), now(0).raw);
    let ([up, _], _) = clock_state.judge(&network(), &exchange(0, 0), MESSAGE_DELAYS, now(4));
    assert!(up.value.is_some(), "{up:?}");
    let _ = clock_state.handle_cloud_announcement(
        PeerClock { text: "something else".into(), ..announcement(0, None) },
        now(5).raw,
    );
    assert_eq!(clock_state.judge(&network(), &exchange(10, 0), MESSAGE_DELAYS, now(14)).1.restart, None);
}

#[test]
fn nonempty_second_is_reported_once_when_over() {
    let mut clock_state = clock_state();
    for sent in [0, 300, 600] {
        let ([up, down], changes) = clock_state.judge(
            &network(),
            &exchange(sent, 5000),
            [MessageDelay { raw: Span::ZERO, bits: Some(1e6) }, MESSAGE_DELAY],
            now(sent + 4),
        );
        assert!(changes.samples.is_empty() && changes.restart.is_none());
        for delay in [up, down] {
            let bounds = delay.bounds.expect("the exchange itself bounds the delay");
            assert!(bounds.lo <= Span::from_millis(1) && Span::from_millis(1) <= bounds.hi, "{delay:?}");
        }
    }
    let _ = clock_state.handle_probe_result(&ProbeResult::Sent, IS_AUTHENTICATED, now(700));
    let _ = clock_state.handle_probe_result(
        &ProbeResult::Answered(exchange(700, 5000)),
        IS_AUTHENTICATED,
        now(704),
    );
    assert_eq!(
        clock_state.latest_sample(&network(), now(800)).up.map(|up| up.count),
        Some(3),
        "the sample covers the part of the second that has passed"
    );

    let changes = clock_state.advance_second(now(1001));
    let [sample] = &changes.samples[..] else { panic!("{changes:?}") };
    assert_eq!(sample.at, at(1000));
    assert_eq!((sample.probes.sent, sample.probes.answered, sample.probes.lost), (1, 1, 0));
    assert_eq!(sample.basis.and_then(|basis| basis.probes_authenticated), Some(true));
    assert_eq!(sample.round_trip.map(|trip| trip.min), Some(Span::from_millis(2)));
    assert_eq!((sample.up.map(|up| up.count), sample.down.map(|down| down.count)), (Some(3), Some(3)));
    assert_eq!(sample.exchanges.accepted, 4);
    assert!(sample.upper.is_some() && sample.lower.is_some());
    let offset = sample.offset.as_ref().expect("known");
    let truth = Span::from_seconds(5);
    assert!(offset.bounds.lo <= truth && truth <= offset.bounds.hi, "{offset:?}");
    assert_eq!(clock_state.latest_sample(&network(), now(1500)), *sample);

    assert!(clock_state.advance_second(now(2500)).samples.is_empty(), "nothing new to report");
    assert!(clock_state.latest_sample(&network(), now(2600)).up.is_none());
}

#[test]
fn probe_with_better_stamp_counts_as_one_exchange() {
    let mut clock_state = clock_state();
    let observation = exchange(100, 0);
    let mut refined = observation;
    refined.exchange.replied = refined.exchange.replied + Span::from_micros(500);
    for result in [ProbeResult::Sent, ProbeResult::Answered(observation), ProbeResult::Refined(refined)] {
        let _ = clock_state.handle_probe_result(&result, IS_AUTHENTICATED, now(200));
    }
    let sample = clock_state.latest_sample(&network(), now(200));
    assert_eq!((sample.probes.answered, sample.exchanges.accepted), (1, 1));
    assert_eq!((sample.upper, sample.lower), (Some(observation.exchange), Some(refined.exchange)));
}

#[test]
fn step_of_cloud_begins_relation_period_and_is_reported() {
    let mut clock_state = clock_state();
    for sent in [0, 100, 200] {
        let _ = clock_state.judge(&network(), &exchange(sent, 0), MESSAGE_DELAYS, now(sent + 4));
    }
    let before = clock_state.latest_sample(&network(), now(250)).relation_period;
    let _ = clock_state.handle_cloud_announcement(announcement(1, None), now(250).raw);
    // An exchange that was in flight when the step was announced is not used, even if it is plausible.
    let in_flight = ExchangeObservation { cloud_epoch: Some(1), ..exchange(300, 3000) };
    let ([up, down], changes) = clock_state.judge(&network(), &in_flight, MESSAGE_DELAYS, now(304));
    assert_eq!((up.value, down.value, changes.restart), (None, None, None));
    assert_eq!((up.verdict, down.verdict), (Verdict::Stepped, Verdict::Stepped));
    let [sample] = &changes.samples[..] else { panic!("{changes:?}") };
    assert_eq!(
        (sample.relation_period, sample.at),
        (before, at(304)),
        "exchanges before the step belong to the old relation period"
    );
    assert!(sample.upper.is_some() && sample.offset.is_none(), "{sample:?}");
    let after = ExchangeObservation { cloud_epoch: Some(1), ..exchange(400, 3000) };
    let (_, changes) = clock_state.judge(&network(), &after, MESSAGE_DELAYS, now(404));
    let restart = changes.restart.expect("reported");
    assert!((restart.edge_stepped, restart.cloud_stepped) == (false, true), "{restart:?}");
    // The relation may not know the size of the step.
    if let Some(movement) = restart.movement {
        assert!((movement - Span::from_seconds(3)).abs() < Span::from_millis(10), "{movement}");
    }
    assert!(changes.samples.is_empty(), "{changes:?}");
    let changes = clock_state.advance_second(now(1000));
    assert_ne!(changes.samples[0].relation_period, before);
    assert_eq!(changes.samples[0].upper, Some(after.exchange));

    // The cloud repeats its announcement, which contains no further step.
    let _ = clock_state.handle_cloud_announcement(announcement(1, None), now(250).raw);
    let later = ExchangeObservation { cloud_epoch: Some(1), ..exchange(1100, 3000) };
    assert_eq!(
        clock_state.judge(&network(), &later, MESSAGE_DELAYS, now(1104)).1.restart,
        None,
        "the step is reported once"
    );
}

#[test]
fn exchange_across_step_is_counted_without_value() {
    let mut clock_state = clock_state();
    let message_delay = MessageDelay { raw: Span::from_seconds(3), bits: None };
    let (delays, _) = clock_state.judge_interrupted(&network(), [message_delay, message_delay], now(4));
    for delay in delays {
        assert_eq!((delay.raw, delay.value, delay.verdict), (Span::from_seconds(3), None, Verdict::Stepped));
    }
    let changes = clock_state.finish(now(500));
    assert_eq!(
        (changes.samples[0].up.map(|up| (up.count, up.median)), changes.samples[0].at),
        (Some((1, None)), at(500))
    );
}

#[test]
fn claims_after_step_do_not_reach_earlier_period() {
    let mut clock_state = clock_state();
    let announcement_with_claim = |millis, epoch| {
        let error = Interval::exactly(Span::from_millis(millis));
        announcement(epoch, Some(ClockClaim { source: DelaySource::Chrony, error }))
    };
    let _ = clock_state.handle_cloud_announcement(announcement_with_claim(0, 0), now(5000).raw);
    let _ = clock_state.judge(&network(), &exchange(5000, 0), MESSAGE_DELAYS, now(5004));
    let before = clock_state.latest_sample(&network(), now(5010)).relation_period;
    // The edge's clock is set back by three seconds, and chrony knows the size of the step at once.
    clock_state.handle_edge_announcement(announcement_with_claim(-3000, 1), now(2200).raw);
    assert_eq!(clock_state.latest_sample(&network(), now(2200)).offset, None);
    // The second that the step interrupted is closed early. Its sample has the end of this second.
    let changes = clock_state.advance_second(now(2200));
    let [sample] = &changes.samples[..] else { panic!("{changes:?}") };
    assert_eq!((sample.relation_period, sample.at, &sample.offset), (before, at(6000), &None));
    let sample = clock_state.latest_sample(&network(), now(2300));
    assert_ne!(sample.relation_period, before);
    assert_eq!(sample.offset.map(|offset| offset.estimate), Some(Span::from_seconds(3)));
}

#[test]
fn relation_learns_only_the_step_from_interrupted_probe() {
    let mut clock_state = clock_state();
    for millis in [0, 100, 200] {
        let _ = clock_state.judge(&network(), &exchange(millis, 0), MESSAGE_DELAYS, now(millis + 4));
    }
    assert!(clock_state.latest_sample(&network(), now(300)).offset.is_some());
    let _ = clock_state.handle_probe_result(&ProbeResult::Sent, IS_AUTHENTICATED, now(300));
    let _ = clock_state.handle_probe_result(&ProbeResult::ClockInterrupted(1), IS_AUTHENTICATED, now(304));
    assert_eq!(clock_state.latest_sample(&network(), now(305)).offset, None);
    let changes =
        clock_state.handle_probe_result(&ProbeResult::ClockInterrupted(1), IS_AUTHENTICATED, now(306));
    assert!(changes.restart.is_none(), "{changes:?}");
    // The edge's clock was set forward by 3 s, so the cloud's clock is 3 s behind.
    let after_step = |millis| ExchangeObservation { edge_epoch: 1, ..exchange(millis, -3000) };
    // The relation cannot exclude that this exchange was in flight during the step.
    let _ = clock_state.judge(&network(), &after_step(400), MESSAGE_DELAYS, now(404));
    let (_, changes) = clock_state.judge(&network(), &after_step(500), MESSAGE_DELAYS, now(504));
    assert!(
        changes.restart.is_some_and(|restart| restart.edge_stepped && !restart.cloud_stepped),
        "{changes:?}"
    );
}

#[test]
fn claim_before_step_stays_void() {
    let mut clock_state = clock_state();
    let claim = |epoch| {
        let error = Interval::exactly(Span::ZERO);
        let claim = Some(ClockClaim { source: DelaySource::Chrony, error });
        announcement(epoch, claim)
    };
    clock_state.handle_edge_announcement(claim(0), now(0).raw);
    let _ = clock_state.handle_cloud_announcement(claim(0), now(0).raw);
    for sent in [0, 10, 20] {
        let _ = clock_state.judge(&network(), &exchange(sent, 0), MESSAGE_DELAYS, now(sent + 4));
    }
    // The cloud is set forward by 5 s; an exchange carries the new epoch before the announcement does.
    let stepped = |sent| ExchangeObservation { cloud_epoch: Some(1), ..exchange(sent, 5000) };
    let _ = clock_state.judge(&network(), &stepped(30), MESSAGE_DELAYS, now(34));
    clock_state.handle_edge_announcement(claim(0), now(0).raw);
    let _ = clock_state.handle_cloud_announcement(claim(0), now(0).raw);
    for sent in [40, 50] {
        let ([up, down], _) = clock_state.judge(&network(), &stepped(sent), MESSAGE_DELAYS, now(sent + 4));
        assert!(up.value.is_some() && down.value.is_some(), "{up:?} {down:?}");
        assert_eq!((up.source, down.source), (DelaySource::InBand, DelaySource::InBand));
    }
}

#[test]
fn networks_of_pair_share_relation_but_not_delays() {
    let (mut clock_state, udp_network) = (clock_state(), "zmq-udp".parse::<NetworkName>().expect("a name"));
    clock_state.join(&udp_network);
    for sent in [0, 100, 200] {
        let _ = clock_state.judge(&network(), &exchange(sent, 0), MESSAGE_DELAYS, now(sent + 4));
    }
    let _ = clock_state.judge(&udp_network, &exchange(300, 0), MESSAGE_DELAYS, now(304));
    let _ = clock_state.handle_probe_result(&ProbeResult::Sent, IS_AUTHENTICATED, now(310));
    let upload_count = |network| clock_state.latest_sample(network, now(400)).up.map(|up| up.count);
    assert_eq!((upload_count(&network()), upload_count(&udp_network)), (Some(3), Some(1)));

    let changes = clock_state.advance_second(now(1001));
    let [tcp, udp] = &changes.samples[..] else { panic!("one for each network: {changes:?}") };
    assert_eq!((&tcp.network, &udp.network), (&network(), &udp_network));
    assert_eq!((tcp.up.map(|up| up.count), udp.up.map(|up| up.count)), (Some(3), Some(1)));
    let udp_sample_with_tcp_delays =
        ClockSample { network: network(), up: tcp.up, down: tcp.down, ..udp.clone() };
    assert_eq!(*tcp, udp_sample_with_tcp_delays, "both networks share the relation of the two hosts");
    assert_eq!(
        (
            clock_state.latest_sample(&network(), now(1100)),
            clock_state.latest_sample(&udp_network, now(1100))
        ),
        (tcp.clone(), udp.clone())
    );

    // A network whose session had its last delays in this second gets one more sample.
    let _ = clock_state.judge(&network(), &exchange(1200, 0), MESSAGE_DELAYS, now(1204));
    clock_state.leave(&network());
    let networks = |changes: ClockStateChanges| {
        changes.samples.into_iter().map(|sample| sample.network).collect::<Vec<_>>()
    };
    assert_eq!(networks(clock_state.settle_sessions(now(1300))), [network()]);
    assert_eq!(networks(clock_state.advance_second(now(2001))), std::slice::from_ref(&udp_network));
    let _ = clock_state.handle_probe_result(&ProbeResult::Sent, IS_AUTHENTICATED, now(2100));
    clock_state.leave(&udp_network);
    assert_eq!(networks(clock_state.finish(now(2200))), [udp_network]);
}

#[test]
fn ended_network_is_sampled_for_two_seconds() {
    let (mut clock_state, udp_network) = (clock_state(), "zmq-udp".parse::<NetworkName>().expect("a name"));
    clock_state.join(&udp_network);
    clock_state.leave(&udp_network);
    let mut sample_count = |second: i64| {
        let _ =
            clock_state.handle_probe_result(&ProbeResult::Sent, IS_AUTHENTICATED, now(1_000 * second + 100));
        clock_state.advance_second(now(1_000 * (second + 1) + 1)).samples.len()
    };
    // The first of the two seconds is the second in which the session of the network ended.
    assert_eq!([0, 1, 2, 3].map(&mut sample_count), [2, 2, 1, 1]);
}

#[test]
fn samples_of_ended_network_include_all_its_probes() {
    let (mut clock_state, udp_network) = (clock_state(), "zmq-udp".parse::<NetworkName>().expect("a name"));
    clock_state.join(&udp_network);
    let _ = clock_state.handle_probe_result(&ProbeResult::Sent, IS_AUTHENTICATED, now(900));
    let mut changes = vec![clock_state.advance_second(now(1_001))];
    let _ = clock_state.handle_probe_result(&ProbeResult::Sent, IS_AUTHENTICATED, now(1_100));
    clock_state.leave(&network());
    // The second ends before the link's task counts the unanswered probes.
    changes.push(clock_state.advance_second(now(2_001)));
    let _ = clock_state.handle_probe_result(&ProbeResult::Lost, IS_AUTHENTICATED, now(2_002));
    let _ = clock_state.handle_probe_result(&ProbeResult::Lost, IS_AUTHENTICATED, now(2_003));
    changes.push(clock_state.settle_sessions(now(2_004)));
    changes.push(clock_state.advance_second(now(3_001)));
    let _ = clock_state.handle_probe_result(&ProbeResult::Sent, IS_AUTHENTICATED, now(3_100));
    changes.push(clock_state.advance_second(now(4_001)));

    let probe_counts = |network: &NetworkName| {
        let samples =
            changes.iter().flat_map(|changes| &changes.samples).filter(|sample| sample.network == *network);
        samples.fold((0, 0), |(sent, lost), sample| (sent + sample.probes.sent, lost + sample.probes.lost))
    };
    assert_eq!(probe_counts(&network()), (2, 2));
    assert_eq!(probe_counts(&udp_network), (3, 2));
}

#[test]
fn probe_with_late_answer_counts_as_lost_only() {
    let mut clock_state = clock_state();
    for result in [ProbeResult::Sent, ProbeResult::Lost, ProbeResult::Late] {
        let _ = clock_state.handle_probe_result(&result, IS_AUTHENTICATED, now(100));
    }
    let probes = clock_state.latest_sample(&network(), now(200)).probes;
    assert_eq!((probes.sent, probes.answered, probes.lost, probes.refused), (1, 0, 1, 0));
}

#[test]
fn cloud_wall_step_restarts_only_relation_to_wall_clock() {
    for clocks in [RelatedClocks::Raw, RelatedClocks::RawToWall] {
        let is_wall_related = clocks == RelatedClocks::RawToWall;
        let mut clock_state = clock_state_of(clocks);
        for sent in [0, 100, 200] {
            let _ = clock_state.judge(&network(), &exchange(sent, 0), MESSAGE_DELAYS, now(sent + 4));
        }
        // A cloud of an earlier release announces nothing about its free-running clock.
        let raw = announcement(0, None).raw.filter(|_| !is_wall_related);
        let stepped = PeerClock { epoch: 1, raw, ..PeerClock::default() };
        let changes = clock_state.handle_cloud_announcement(stepped.clone(), now(250).raw);
        assert_eq!(changes.is_cloud_wall_set, !is_wall_related);
        assert_eq!(
            clock_state.latest_sample(&network(), now(260)).offset.is_none(),
            is_wall_related,
            "{clocks}"
        );
        assert!(
            !clock_state.handle_cloud_announcement(stepped, now(270).raw).is_cloud_wall_set,
            "reported once"
        );
    }
}

#[test]
fn raw_delay_is_difference_of_wall_clocks() {
    let mut clock_state = clock_state();
    let hour = Span::from_seconds(3_600);
    let message_delays = [MessageDelay { raw: hour, bits: None }, MessageDelay { raw: -hour, bits: None }];
    let ([up, down], _) = clock_state.judge(&network(), &exchange(0, 0), message_delays, now(4));
    assert_eq!((up.raw, down.raw), (hour, -hour));
    let bounds = up.bounds.expect("the exchange itself bounds the delay");
    assert!(bounds.contains(Span::from_millis(1)) && bounds.hi < Span::from_millis(10), "{bounds:?}");
}

#[test]
fn sample_has_basis_and_end_of_second() {
    let mut clock_state = clock_state();
    let _ = clock_state.judge(&network(), &exchange(300, 0), MESSAGE_DELAYS, now(304));
    // `advance_second` is called 80 ms late. Before the call the wall clock was slewed: it has advanced by 10 ms more
    // than the free-running clock.
    let late = Stamp { raw: now(1_080).raw - Span::from_millis(10), ..now(1_080) };
    let changes = clock_state.advance_second(late);
    let [sample] = &changes.samples[..] else { panic!("one second: {changes:?}") };
    let basis = sample.basis.expect("known");
    assert_eq!((sample.at, basis.clocks), (at(1_000), RelatedClocks::Raw));
    assert_eq!(basis.at_raw, Some(now(990).raw), "80 ms before the call, as by the wall clock");
    assert!(basis.claims_trusted, "the configuration trusts the claims");
}

/// Returns the stamps of an observed input message and of its output message, in these epochs: 30 ms to a cloud that is
/// 5 s ahead, 20 ms there, 5 ms back.
fn stamps_of_messages(sent: i64, edge: u32, cloud: u32) -> (TransitStamps, TransitStamps) {
    let edge_stamp = |millis| HostStamp {
        wall: at(sent + millis),
        raw: RawTime::from_wall(at(sent + millis)),
        epoch: Some(edge),
    };
    let cloud_stamp = |millis| HostStamp {
        wall: at(sent + 5000 + millis),
        raw: RawTime::from_wall(at(sent + 5000 + millis)),
        epoch: Some(cloud),
    };
    let up = TransitStamps { sender: edge_stamp(0), receiver: cloud_stamp(30) };
    (up, TransitStamps { sender: cloud_stamp(50), receiver: edge_stamp(55) })
}

#[test]
fn observed_stamps_are_judged_without_learning() {
    let mut clock_state = clock_state();
    let (up, down) = stamps_of_messages(0, 0, 0);
    let [unrelated, _] = clock_state.judge_stamps(&up, Some(&down));
    assert_eq!(unrelated.map(|delay| delay.verdict), Some(Verdict::Unsynchronised));
    for sent in [0, 100, 200, 300] {
        let _ = clock_state.judge(&network(), &exchange(sent, 5000), MESSAGE_DELAYS, now(sent + 4));
    }
    let before = clock_state.relation.exchange_counts();
    let (up, down) = stamps_of_messages(320, 0, 0);
    let [up_delay, down_delay] = clock_state.judge_stamps(&up, Some(&down));
    for (delay, truth) in [(up_delay, 30), (down_delay, 5)] {
        let (delay, truth) = (delay.expect("it is judged"), Span::from_millis(truth));
        assert!(delay.bounds.is_some_and(|bounds| bounds.contains(truth)), "{delay:?}");
    }
    let sum = up_delay.and_then(|up| up.value).zip(down_delay.and_then(|down| down.value));
    let sum = sum.map(|(up, down)| up + down).expect("both have a value");
    assert!((sum - Span::from_millis(35)).abs() < Span::from_micros(5), "{sum}");
    // `sender` has the stamps of the edge's own subscription, which received the message 40 ms late: 10 ms after the
    // cloud.
    let mut late = up;
    late.sender.raw = late.sender.raw + Span::from_millis(40);
    let [negative, _] = clock_state.judge_stamps(&late, None);
    let bounds = negative.and_then(|difference| difference.bounds).expect("it is judged");
    assert!(bounds.contains(Span::from_millis(-10)) && bounds.hi.is_negative(), "{negative:?}");
    let [one_direction, other_direction] = clock_state.judge_stamps(&up, None);
    assert_eq!(
        (one_direction.and_then(|delay| delay.bounds), other_direction),
        (up_delay.and_then(|delay| delay.bounds), None)
    );
    assert_eq!(clock_state.relation.exchange_counts(), before);
}

#[test]
fn observed_stamps_of_another_epoch_are_stepped() {
    let mut clock_state = clock_state();
    for sent in [0, 100, 200, 300] {
        let _ = clock_state.judge(&network(), &exchange(sent, 5000), MESSAGE_DELAYS, now(sent + 4));
    }
    let verdicts = |clock_state: &LinkClockState, edge, cloud| {
        let (up, down) = stamps_of_messages(320, edge, cloud);
        clock_state.judge_stamps(&up, Some(&down)).map(|delay| delay.map(|delay| delay.verdict))
    };
    let stepped = [Some(Verdict::Stepped); 2];
    assert_ne!(verdicts(&clock_state, 0, 0), stepped);
    assert_eq!(verdicts(&clock_state, 0, 1), stepped, "the relation does not know of the step yet");
    let _ = clock_state.handle_cloud_announcement(announcement(1, None), now(400).raw);
    assert_eq!(verdicts(&clock_state, 0, 0), stepped, "the stamps were made before the step");
    let (mut up, _) = stamps_of_messages(320, 0, 1);
    // A stamp without an epoch may precede the step.
    up.sender.epoch = None;
    assert_eq!(clock_state.judge_stamps(&up, None)[0].map(|delay| delay.verdict), Some(Verdict::Stepped));
}
