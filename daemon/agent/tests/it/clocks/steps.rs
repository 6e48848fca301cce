//! Tests of a wall clock that is set during a run.

use std::collections::BTreeSet;
use std::sync::Arc;

use peernet_clock::{ClockFaultStep, ClockFaults, SharedClock, Span, Verdict, WallTime};
use peernet_stream::{IncidentKind, LiveUpdate};

use super::{CLOUD, assert_interval_contains, faults_from_now_on, pipeline, transit};
use crate::harness::{
    Aggregator, ReceivedEvents, SwitchableClock, TestAgent, assert_adds_up, clock, config, value,
};

const LOAD: &str = "load = { mode = 'rate', hz = 100.0 }\nmax_in_flight = 8";

/// Returns the faults of a clock that is stepped by `by` 300 ms from now.
fn step_soon(by: Span) -> ClockFaults {
    let step = ClockFaultStep::wall_step(Span::from_millis(300), by);
    ClockFaults { steps: vec![step], ..faults_from_now_on(Span::ZERO, 0.0) }
}

/// Returns the true time at which a stepped clock showed `shown`. `near` is a true time shortly before or after: it is
/// needed because a clock that is set back shows the same time twice.
fn true_time(faults: Option<&ClockFaults>, shown: WallTime, near: WallTime) -> WallTime {
    let Some(faults) = faults else { return shown };
    // Near the step, one candidate has the error before the step, the other the error after the step.
    let moment = Span::from_millis(400);
    let candidates = [near - moment, near + moment].map(|at| shown - faults.wall_error_at(at));
    candidates.into_iter().min_by_key(|at| (*at - near).abs()).expect("there are two candidates")
}

/// Returns the number of delays after the step whose verdict is good. Asserts that the intervals of all delays contain
/// the truth.
fn count_good_delays(
    received_events: &ReceivedEvents,
    edge: Option<&ClockFaults>,
    cloud: Option<&ClockFaults>,
) -> usize {
    let mut good = 0;
    for iteration in received_events.iterations() {
        // The stamps differ by more than a second only after the step, which is 3 s.
        let min_raw_difference = Span::from_seconds(1);
        let (sent, received, up) = transit(iteration, "upload");
        let (departed, returned, down) = transit(iteration, "download");
        // One of the two clocks has no fault, so its stamp is the true time.
        let true_delay = |from: WallTime,
                          from_faults: Option<&ClockFaults>,
                          to: WallTime,
                          to_faults: Option<&ClockFaults>| {
            let near = if from_faults.is_some() { to } else { from };
            true_time(to_faults, to, near) - true_time(from_faults, from, near)
        };
        for (delay, truth) in [
            (up, true_delay(sent, edge, received, cloud)),
            (down, true_delay(departed, cloud, returned, edge)),
        ] {
            // No delay depends on a wall clock.
            assert_interval_contains(&delay, truth);
            good += usize::from(
                matches!(delay.verdict, Verdict::Ok | Verdict::Limited)
                    && delay.raw.abs() > min_raw_difference,
            );
        }
        assert_adds_up(iteration);
        assert!(value(&iteration.tree, "upload-throughput").is_some());
    }
    good
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn wall_clock_set_during_run_changes_no_delay() {
    for (on_edge, by) in [(false, Span::from_seconds(3)), (true, Span::from_seconds(-3))] {
        let aggregator = Aggregator::start().await;
        let switchable_clock = Arc::new(SwitchableClock::new(clock(if on_edge { "edge" } else { "cloud" })));
        let clock_of = |name: &str, is_switchable: bool| {
            if is_switchable {
                Arc::<SwitchableClock>::clone(&switchable_clock) as SharedClock
            } else {
                clock(name)
            }
        };
        let cloud = TestAgent::start_on(clock_of("cloud", !on_edge), "cloud", None, config(CLOUD)).await;
        let tables = config(&pipeline("line", &cloud, LOAD));
        let edge =
            TestAgent::start_on(clock_of("edge", on_edge), "edge", Some(&aggregator.address), tables).await;
        aggregator
            .until(|received_events| {
                received_events.iterations().len() >= 50 && !received_events.clock_samples().is_empty()
            })
            .await;
        let faults = step_soon(by);
        switchable_clock.inject(faults.clone());
        let (edge_faults, cloud_faults) = if on_edge { (Some(&faults), None) } else { (None, Some(&faults)) };
        let received_events = aggregator
            .until(|received_events| count_good_delays(received_events, edge_faults, cloud_faults) >= 200)
            .await;

        // Incidents about the edge's own clock have no peer.
        let link_steps = |received_events: &ReceivedEvents| {
            let steps = received_events.incidents(IncidentKind::ClockStep).into_iter().cloned();
            steps.filter(|incident| incident.peer.is_some()).collect::<Vec<_>>()
        };
        let set_back_count = |received_events: &ReceivedEvents| {
            let all = received_events.incidents(IncidentKind::ClockStep).into_iter();
            all.filter(|incident| incident.text.contains("wall clock was set back by 3.000 s")).count()
        };
        if on_edge {
            assert_eq!((link_steps(&received_events).len(), set_back_count(&received_events)), (0, 1));
        } else {
            let [reported] = &link_steps(&received_events)[..] else {
                panic!("{:?}", link_steps(&received_events))
            };
            assert!(
                reported.text.starts_with("the wall clock of cloud was stepped or slewed"),
                "{}",
                reported.text
            );
        }

        edge.stop().await.expect("stops well");
        let received_events = aggregator.until(|received_events| !received_events.goodbyes.is_empty()).await;
        let periods: BTreeSet<_> =
            received_events.clock_samples().iter().map(|sample| sample.relation_period).collect();
        assert_eq!(periods.len(), 1, "the step begins no new relation period");
        assert_eq!(link_steps(&received_events).len(), usize::from(!on_edge), "the step is reported once");
        cloud.stop().await.expect("stops well");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn step_is_announced_to_idle_peers() {
    let switchable_clock = Arc::new(SwitchableClock::new(clock("cloud")));
    let cloud =
        TestAgent::start_on(Arc::<SwitchableClock>::clone(&switchable_clock), "cloud", None, config(CLOUD))
            .await;
    // One sample now and the next in an hour, and no probes.
    let load = "load = { mode = 'rate', hz = 0.0003 }\n[probes]\nsend = false";
    let edge =
        TestAgent::start_with_clock_name("edge", None, config(&pipeline("line", &cloud, load)), "edge").await;
    let epoch = |live: &LiveUpdate| live.links.first().and_then(|link| Some(link.cloud.as_ref()?.epoch));
    let live = edge.until(|live| live.links.iter().any(|link| link.latest_sample.offset.is_some())).await;
    assert_eq!(epoch(&live), Some(0));
    switchable_clock.inject(step_soon(Span::from_seconds(3)));
    let live = edge.until(|live| epoch(live) == Some(1)).await;
    assert!(
        live.links[0].latest_sample.offset.is_some(),
        "the estimate of the free-running clocks is still valid"
    );
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}
