use std::sync::Arc;

use peernet_clock::{ClockIdentity, Interval, ManualClock, OneWayDelay, RawTime, WallTime};
use peernet_logger::{HostId, RawStamps, Recorder, stage};

use super::*;
use crate::tests::samples;

/// Returns an iteration with 2 ms of sensing, 20 ms of upload, 4 ms of inference on the cloud, and 1 ms of download.
/// The cloud's wall clock is ahead of the edge's wall clock by `ahead`. `estimate_delay` computes the delay of a
/// transit from the difference of the transit's wall-clock stamps, and from the true delay.
fn offloaded(ahead: Span, estimate_delay: impl Fn(Span, Span) -> OneWayDelay) -> IterationDetail {
    let edge = Arc::new(ManualClock::new(
        WallTime::from_unix_nanos(1_000_000_000),
        ClockIdentity::new("a", "system"),
    ));
    let cloud = Arc::new(ManualClock::new(
        WallTime::from_unix_nanos(1_000_000_000) + ahead,
        ClockIdentity::new("b", "system"),
    ));
    let advance = |milliseconds| {
        edge.advance(Span::from_millis(milliseconds));
        cloud.advance(Span::from_millis(milliseconds));
    };
    let mut log = Recorder::new(edge.clone(), HostId::random());
    {
        let _sensing = log.time(stage::SENSING);
        advance(2);
    }
    let up = log.start_transit(stage::UPLOAD, stamp(&edge));
    let sent = log.finish();
    advance(20);
    let mut cloud_log = Recorder::resume(cloud.clone(), HostId::random(), sent.clone(), up, stamp(&cloud))
        .expect("the upload is open");
    {
        let _inference = cloud_log.time(stage::INFERENCE);
        advance(4);
    }
    let down = cloud_log.start_transit(stage::DOWNLOAD, stamp(&cloud));
    let delta = cloud_log.into_tree_delta().expect("the tree was resumed");
    advance(1);
    let mut tree = sent;
    tree.apply_delta(delta).expect("the delta belongs to the tree");
    let answer_arrival = peernet_clock::Clock::wall(&*edge);
    for (id, truth) in [(up, Span::from_millis(20)), (down, Span::from_millis(1))] {
        if let Some(Measure::Transit(transit)) = tree.measure_mut(id) {
            // `resume` has set the arrival of the upload. The arrival of the download is still missing.
            let received = *transit.received.get_or_insert(answer_arrival);
            transit.delay = Some(estimate_delay(received - transit.sent, truth));
        }
    }
    IterationDetail { tree, ..samples::iteration() }
}

fn stamp(clock: &ManualClock) -> peernet_clock::Stamp {
    peernet_clock::Clock::stamp(clock)
}

fn is_close(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-9
}

#[test]
fn hosts_with_one_clock_give_every_node_a_position() {
    let timeline = Timeline::of(&offloaded(Span::ZERO, |raw, _| OneWayDelay::same_clock(raw)));
    let visit = timeline.visit().expect("one other host");
    assert!(is_close(visit.sent_at, 0.002) && is_close(visit.arrival, 0.022), "{visit:?}");
    assert_eq!(visit.shift, (0.0, 0.0));
    assert!(is_close(visit.network.expect("the answer arrived"), 0.021));
    let inference = timeline.nodes.iter().find(|node| node.name == "inference").expect("was recorded");
    assert!(is_close(inference.start.expect("placed"), 0.022));
    assert_eq!(inference.location, NodeLocation::Host(1));
}

#[test]
fn visit_has_the_uncertainty_of_the_upload() {
    let ahead = Span::from_seconds(1_204);
    let detail = offloaded(ahead, |raw, truth| OneWayDelay {
        raw,
        value: Some(truth),
        bounds: Some(Interval { lo: truth - Span::from_micros(650), hi: truth + Span::from_micros(630) }),
        source: DelaySource::InBand,
        verdict: Verdict::Ok,
    });
    let timeline = Timeline::of(&detail);
    let visit = timeline.visit().expect("one other host");
    assert!(is_close(visit.arrival, 0.022));
    assert!(is_close(visit.shift.0, -0.000_65) && is_close(visit.shift.1, 0.000_63));
    assert!(is_close(visit.network.expect("the sum is independent of the clock offset"), 0.021));
}

#[test]
fn unrelated_clocks_leave_sum_exact_and_position_uncertain() {
    let timeline =
        Timeline::of(&offloaded(Span::from_seconds(-77), |raw, _| OneWayDelay::unsynchronised(raw)));
    let visit = timeline.visit().expect("one other host");
    assert!(is_close(visit.network.expect("the sum is exact"), 0.021));
    // Without an estimate, the arrival is shown after half of the 21 ms of both directions.
    assert!(is_close(visit.arrival, 0.002 + 0.0105));
    assert!(is_close(visit.shift.1, 0.0105));
    let upload = timeline.nodes.iter().find(|node| node.name == "upload").expect("was recorded");
    assert_eq!(
        (upload.length, upload.delay.map(|delay| delay.verdict)),
        (None, Some(Verdict::Unsynchronised))
    );
}

#[test]
fn measured_sum_places_answer_despite_wall_clock_step() {
    let mut detail = offloaded(Span::ZERO, |raw, _| OneWayDelay::stepped(raw, DelaySource::None));
    // The edge's clock was set back by five seconds while the sample was on the cloud. Only the answer, which arrives
    // 27 ms after the start, is stamped after that.
    for node in 0..detail.tree.nodes().len() {
        let id = NodeId(node as u32);
        if let Some(Measure::Transit(transit)) = detail.tree.measure_mut(id)
            && transit.received.is_some_and(|received| received.unix_nanos() >= 1_027_000_000)
        {
            transit.received = transit.received.map(|received| received - Span::from_seconds(5));
        }
    }
    detail.row.both_ways = Some(0.021);
    let timeline = Timeline::of(&detail);
    let visit = timeline.visit().expect("one other host");
    assert!(is_close(visit.network.expect("the sum is exact"), 0.021));
    let (answer_sent, answer_received) = visit.answer_times.expect("the answer arrived");
    assert!(
        is_close(visit.arrival, 0.002 + 0.0105)
            && is_close(answer_sent, 0.0165)
            && is_close(answer_received, 0.027),
        "{visit:?}"
    );
}

#[test]
fn lost_message_gives_timeline_without_visit() {
    let clock = Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("a", "system")));
    let mut log = Recorder::new(clock.clone(), HostId::random());
    log.start_transit(stage::UPLOAD, stamp(&clock));
    let timeline = Timeline::of(&IterationDetail { tree: log.finish(), ..samples::iteration() });
    assert_eq!(timeline.nodes.len(), 1);
    assert_eq!((timeline.nodes[0].length, timeline.visit()), (None, None));
}

#[test]
fn raw_stamps_place_answer_despite_wall_clock_step() {
    let true_delay = |_, truth: Span| OneWayDelay {
        // An arbitrary difference of stamps. No node is placed by it.
        raw: truth + Span::from_seconds(5_000),
        value: Some(truth),
        bounds: Some(Interval::exactly(truth)),
        source: DelaySource::InBand,
        verdict: Verdict::Ok,
    };
    let mut detail = offloaded(Span::from_seconds(77), true_delay);
    let raw = |millis: i64| RawTime::from_nanos(millis * 1_000_000);
    // The request is sent at 2 ms and arrives at 22 ms, the answer is sent at 26 ms and arrives at 27 ms. At the start,
    // the edge's free-running clock reads 1 s, and that of the cloud 6,001 s. Before the answer arrives, the edge's
    // wall clock is set back by an hour.
    let (up, down) = ((raw(1_002), raw(6_001_022)), (raw(6_001_026), raw(1_027)));
    let ids: Vec<NodeId> = (0..detail.tree.nodes().len() as u32).map(NodeId).collect();
    let mut stamps = [up, down].into_iter();
    for id in ids {
        if let Some(Measure::Transit(transit)) = detail.tree.measure_mut(id)
            && let Some((sent, received)) = stamps.next()
        {
            transit.raw_stamps = Some(RawStamps { sent, received });
            if sent == down.0 {
                transit.received = transit.received.map(|at| at - Span::from_seconds(3_600));
            }
        }
    }
    let timeline = Timeline::of(&detail);
    let visit = timeline.visit().expect("one other host");
    assert!(is_close(visit.arrival, 0.022), "{visit:?}");
    let (answer_sent, answer_received) = visit.answer_times.expect("the answer arrived");
    assert!(is_close(answer_sent, 0.026) && is_close(answer_received, 0.027), "{visit:?}");
    assert!(is_close(visit.network.expect("both delays are known"), 0.021), "{visit:?}");
    assert!(timeline.end < 0.1, "{}", timeline.end);
}
