//! Tests that every delay has an interval that contains the truth.

use peernet_clock::{ClockFaults, DelaySource, Span, Verdict};

use super::{
    CLOUD, DELAY_NAMES, MAX_STALE_AT_START, assert_interval_contains, delay, faults_from_now_on, pipeline,
    transit, truth,
};
use crate::harness::{Aggregator, TestAgent, assert_adds_up, clock, config, faulty_clock, value};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_delay_is_bounded_from_first_exchange_on() {
    let aggregator = Aggregator::start().await;
    let cloud = TestAgent::start_with_clock_name("cloud", None, config(CLOUD), "cloud").await;
    let load = "load = { mode = 'rate', hz = 100.0 }\nmax_in_flight = 4\nlimit = { iterations = 250 }";
    let tables = config(&pipeline("line", &cloud, load));
    let edge = TestAgent::start_with_clock_name("edge", Some(&aggregator.address), tables, "edge").await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;

    assert_eq!(received_events.iterations().len(), 250);
    for iteration in received_events.iterations() {
        for name in DELAY_NAMES {
            let delay = delay(iteration, name);
            assert_interval_contains(&delay, delay.raw);
            assert_eq!(delay.source, DelaySource::InBand);
            let is_stale_at_start = iteration.number <= MAX_STALE_AT_START && delay.verdict == Verdict::Stale;
            assert!(
                is_stale_at_start || matches!(delay.verdict, Verdict::Ok | Verdict::Limited),
                "{delay:?}"
            );
        }
        assert_adds_up(iteration);
        let (Some(seconds), Some(rate)) =
            (value(&iteration.tree, "upload"), value(&iteration.tree, "upload-throughput"))
        else {
            panic!("{:?}", iteration.tree)
        };
        // A sample of `pipeline()` has 20,000 bytes.
        let bits = 8.0 * (20000.0 + value(&iteration.tree, "upload-logger-bytes").unwrap_or_default());
        assert!((seconds * rate - bits).abs() < 1.0);
    }
    edge.stop().await.expect("stops well");

    let received_events = aggregator.until(|received_events| !received_events.goodbyes.is_empty()).await;
    let samples = received_events.clock_samples();
    assert!(samples.len() >= 3, "250 iterations at 100 Hz take 2.5 s: {samples:?}");
    let judged: u32 = samples.iter().filter_map(|sample| sample.up).map(|up| up.count).sum();
    assert_eq!(judged, 250);
    assert!(samples.iter().map(|sample| sample.probes.answered).sum::<u32>() > 5, "{samples:?}");
    assert!(
        samples
            .windows(2)
            .all(|pair| pair[0].relation_period == pair[1].relation_period && pair[0].at < pair[1].at)
    );
    for sample in &samples {
        assert_eq!(sample.peer_name.as_str(), "cloud");
        let offset = sample.offset.as_ref().expect("known");
        assert!(offset.bounds.lo <= Span::ZERO && Span::ZERO <= offset.bounds.hi, "{offset:?}");
        assert!(sample.probes.answered == 0 || sample.round_trip.is_some());
        for median in [sample.up, sample.down].into_iter().flatten().filter_map(|delays| delays.median) {
            assert!(median.bounds.lo <= median.value && median.value <= median.bounds.hi);
            assert!(median.bits_per_second > Some(0.0));
        }
    }
    // The live updates contain the same delays: each has a verdict and the bounds of its interval.
    let mut seconds = std::collections::BTreeMap::new();
    for second in received_events
        .live_updates
        .iter()
        .flat_map(|live| &live.pipelines)
        .flat_map(|pipeline| &pipeline.seconds)
    {
        seconds.insert(second.at, second.clone());
    }
    let mut verdicts = 0;
    for second in seconds.values() {
        verdicts += second.verdicts.iter().map(|(_, _, count)| count).sum::<u64>();
        // Each delay has three summaries: half the width of its interval, the lower end, and the upper end.
        let bound_names =
            ["", "-lo", "-hi"].map(|end| ["upload", "download"].map(|delay| format!("{delay}{end}")));
        for name in bound_names.as_flattened() {
            let summary = second.bounds.iter().find(|(other, _)| other == name.as_str());
            assert_eq!(summary.map_or(0, |(_, summary)| summary.count()), second.counts.ok, "{name}");
        }
    }
    assert!(verdicts > 0);
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn wrong_clock_does_not_change_delays() {
    let correct_clock = |name| (None, clock(name));
    let ahead = faults_from_now_on(Span::from_seconds(1), 40.0);
    let behind = faults_from_now_on(Span::from_seconds(-1), -40.0);
    let wrong_clock =
        |name: &'static str, faults: &ClockFaults| (Some(faults.clone()), faulty_clock(name, faults.clone()));
    for ((edge_faults, edge_clock), (cloud_faults, cloud_clock)) in [
        (correct_clock("edge"), wrong_clock("cloud", &ahead)),
        (wrong_clock("edge", &behind), correct_clock("cloud")),
    ] {
        let aggregator = Aggregator::start().await;
        let cloud = TestAgent::start_on(cloud_clock, "cloud", None, config(CLOUD)).await;
        let load = "load = { mode = 'rate', hz = 100.0 }\nmax_in_flight = 4\nlimit = { iterations = 200 }";
        let tables = config(&pipeline("line", &cloud, load));
        let edge = TestAgent::start_on(edge_clock, "edge", Some(&aggregator.address), tables).await;
        let received_events =
            aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;

        assert_eq!(received_events.iterations().len(), 200);
        let true_time = |faults: &Option<ClockFaults>, shown| {
            faults.as_ref().map_or(shown, |faults| truth(faults, shown))
        };
        for iteration in received_events.iterations() {
            let (sent, received, delay) = transit(iteration, "upload");
            assert_interval_contains(
                &delay,
                true_time(&cloud_faults, received) - true_time(&edge_faults, sent),
            );
            assert_eq!(delay.raw, received - sent, "the raw value is the difference of the stamps");
            let (sent, received, delay) = transit(iteration, "download");
            assert_interval_contains(
                &delay,
                true_time(&edge_faults, received) - true_time(&cloud_faults, sent),
            );
            assert_eq!(delay.raw, received - sent, "the raw value is the difference of the stamps");
            assert_adds_up(iteration);
        }
        let facts = &received_events.run_starts()[0].facts;
        let fact = |name: &str| facts.iter().find(|(key, _)| key == name).map(|(_, text)| text.as_str());
        let expected = if edge_faults.is_some() {
            (Some("offset -1000 ms, drift -40 ppm"), None)
        } else {
            (None, Some("offset +1000 ms, drift +40 ppm"))
        };
        assert_eq!((fact("Clock fault"), fact("Clock fault of cloud")), expected);
        edge.stop().await.expect("stops well");
        cloud.stop().await.expect("stops well");
    }
}
