//! Storing and reading of clock samples, by the second and by the bucket.

use peernet_analysis::clock_points::{ClockBucket, bucket_number};
use peernet_clock::{DelaySource, RawTime, RelatedClocks, Span, Verdict, WallTime};
use peernet_logger::{HostId, RunId};
use peernet_stream::{ClockSample, EstimateBasis, Event, HostDescription, Iteration, NetworkName};

use super::clocks::{link, micros, sample};
use super::{NOW, TestStore, generate};
use crate::stored::ClockPoint;
use crate::types::{ClockSeries, LinkKey};

const ALWAYS: (WallTime, WallTime) =
    (WallTime::from_unix_nanos(i64::MIN), WallTime::from_unix_nanos(i64::MAX));

fn event(sample: ClockSample) -> Event {
    Event::Clock(Box::new(sample))
}

fn key(edge: HostId, cloud: HostId) -> LinkKey {
    LinkKey { edge, cloud, network: NetworkName::default() }
}

fn point(sample: ClockSample) -> ClockPoint {
    let clocks = sample.clocks();
    let ClockSample { at, relation_period, offset, probes, round_trip, up, down, basis, .. } = sample;
    let proven_skew_ppm = basis.and_then(|basis| basis.proven_skew_ppm);
    let oldest_exchange_age = basis.and_then(|basis| basis.oldest_exchange_age);
    ClockPoint {
        at,
        relation_period,
        offset,
        probes,
        round_trip,
        up,
        down,
        clocks,
        proven_skew_ppm,
        oldest_exchange_age,
    }
}

async fn store(test_store: &mut TestStore, samples: impl IntoIterator<Item = ClockSample>) {
    let work = test_store.batch(samples.into_iter().map(event).collect());
    let committed = test_store.commit(&[work]).await;
    assert!(committed.quarantined.is_empty(), "{:?}", committed.quarantined);
}

async fn series(test_store: &TestStore, max_points: u32) -> ClockSeries {
    let (from, to) = ALWAYS;
    test_store
        .store
        .clock_series(&key(test_store.edge, test_store.cloud), from, to, max_points)
        .await
        .expect("answers")
}

#[tokio::test]
async fn clock_sample_is_read_as_sent() {
    let mut test_store = TestStore::new().await;
    let full = sample(test_store.cloud, 1, 40);
    let mut in_band = sample(test_store.cloud, 2, 50);
    let offset = in_band.offset.as_mut().expect("known");
    (offset.source, offset.sources) = (DelaySource::InBand, vec![(DelaySource::InBand, offset.bounds)]);
    in_band.up.as_mut().expect("judged").median = None;
    let mut empty = sample(test_store.cloud, 3, 40);
    (empty.upper, empty.lower, empty.offset, empty.round_trip) = (None, None, None, None);
    (empty.up, empty.down) = (None, None);
    let samples = [full, in_band, empty];
    store(&mut test_store, samples.clone()).await;

    let series = series(&test_store, 1_000).await;
    assert_eq!(series.bucket_s, 1);
    assert_eq!(series.points, samples.map(point));
    let links = test_store.store.links().await.expect("answers");
    let [link] = &links[..] else { panic!("one link: {links:?}") };
    assert_eq!((link.edge, link.cloud), (test_store.edge, test_store.cloud));
    assert_eq!((link.edge_name.as_str(), link.cloud_name.as_str()), ("edge", "cloud"));
    assert_eq!((link.first, link.last), (generate::at(1.0), generate::at(3.0)));
    // The exchanges and their assumptions are stored, too: delays are judged again with them.
    assert_eq!(
        test_store.count(
            "SELECT count(*) FROM clock_sample WHERE max_drift_ppm = 50 AND upper_received_ns - upper_sent_ns = 250040000 \
             AND lower_returned_ns - lower_sent_ns = 82000 AND upper_uncertainty_ns = 2 AND (taken, restarts) = (9, 4)"
        )
        .await,
        1
    );
    assert_eq!(
        test_store.count(
            "SELECT count(*) FROM clock_ms WHERE edge = 'edge' AND cloud = 'cloud' AND refused = 6 AND offset_ms = 250 \
             AND at_utc = '2025-01-01 00:00:01.000' AND source = 'intersection' AND lo_ms = 249.96 AND up_ms = 4"
        )
        .await,
        1
    );
}

#[tokio::test]
async fn two_networks_of_pair_are_two_links() {
    let mut test_store = TestStore::new().await;
    let udp: NetworkName = "zmq-udp".parse().expect("a name");
    let over_udp = |second| ClockSample { network: udp.clone(), ..sample(test_store.cloud, second, 60) };
    let udp_samples = [over_udp(1), over_udp(2)];
    store(&mut test_store, udp_samples.clone()).await;
    let tcp_samples = [1, 2].map(|second| sample(test_store.cloud, second, 40));
    store(&mut test_store, tcp_samples.clone()).await;
    let links = test_store.store.links().await.expect("answers");
    let keys: Vec<LinkKey> = links.iter().map(crate::types::LinkRow::key).collect();
    assert_eq!(
        keys,
        [
            key(test_store.edge, test_store.cloud),
            LinkKey { network: udp, ..key(test_store.edge, test_store.cloud) }
        ]
    );
    for (key, expected) in keys.iter().zip([tcp_samples, udp_samples]) {
        let series = test_store.store.clock_series(key, ALWAYS.0, ALWAYS.1, 10).await.expect("answers");
        assert_eq!(series.points, expected.map(point), "{key:?}");
    }
    assert_eq!(test_store.count("SELECT count(*) FROM clock_ms WHERE network = 'zmq-udp'").await, 2);
}

#[tokio::test]
async fn series_holds_only_requested_link_and_time() {
    let mut test_store = TestStore::new().await;
    let cloud = test_store.cloud;
    store(&mut test_store, (1..=100).map(|second| sample(cloud, second, 40))).await;
    let (from, to) = (generate::at(10.0), generate::at(19.0));
    let in_range =
        test_store.store.clock_series(&key(test_store.edge, cloud), from, to, 10).await.expect("answers");
    assert_eq!((in_range.bucket_s, in_range.points.len()), (1, 10));
    assert_eq!((in_range.points[0].at, in_range.points[9].at), (from, to));
    let reversed =
        test_store.store.clock_series(&key(cloud, test_store.edge), from, to, 10).await.expect("answers");
    assert_eq!(reversed, ClockSeries { bucket_s: 1, points: vec![] });
    let later =
        test_store.store.clock_series(&key(test_store.edge, cloud), generate::at(200.0), ALWAYS.1, 10).await;
    assert!(later.expect("answers").points.is_empty());
}

#[tokio::test]
async fn sample_replaces_sample_of_same_second_and_relation_period() {
    let mut test_store = TestStore::new().await;
    let mut repeated = sample(test_store.cloud, 1, 60);
    repeated.probes.lost = 5;
    let mut stepped = sample(test_store.cloud, 1, 70);
    stepped.relation_period = 7;
    let samples = [sample(test_store.cloud, 1, 40), repeated, stepped];
    store(&mut test_store, samples.clone()).await;
    assert_eq!(test_store.count("SELECT count(*) FROM clock_sample").await, 2);
    // The column `window` has the number of the relation period.
    assert_eq!(test_store.count("SELECT probes_lost FROM clock_sample WHERE window <> 7").await, 5);
    // A batch that arrives again replaces nothing.
    let work = test_store.batch_numbered(1, samples.map(event));
    test_store.commit(&[work]).await;
    assert_eq!(test_store.count("SELECT count(*) FROM clock_sample").await, 2);
    assert_eq!(test_store.count("SELECT events FROM host WHERE name = 'edge'").await, 3);
}

#[tokio::test]
async fn samples_with_repeated_wall_times_are_all_kept() {
    let mut test_store = TestStore::new().await;
    let cloud = test_store.cloud;
    // The free-running clock continues, and the wall clock shows seconds 6 to 10 three times.
    let sample_at = |raw_second: i64, wall_second: i64| {
        let at_raw = Some(RawTime::from_nanos(raw_second * 1_000_000_000));
        let basis = EstimateBasis { clocks: RelatedClocks::Raw, at_raw, ..EstimateBasis::default() };
        ClockSample { relation_period: 1, basis: Some(basis), ..sample(cloud, wall_second, 40) }
    };
    let wall_seconds = (1..=10).chain(6..=10).chain(6..=10);
    let samples: Vec<_> =
        (1..).zip(wall_seconds).map(|(raw_second, wall_second)| sample_at(raw_second, wall_second)).collect();
    store(&mut test_store, samples.clone()).await;
    assert_eq!(test_store.count("SELECT count(DISTINCT at_raw_ns) FROM clock_sample").await, 20);
    // A sample that arrives again replaces no sample with another raw time.
    store(&mut test_store, samples).await;
    assert_eq!(test_store.count("SELECT count(DISTINCT at_raw_ns) FROM clock_sample").await, 20);
    assert_eq!(test_store.count("SELECT count(*) FROM clock_sample").await, 20);
    let read = series(&test_store, 1_000).await.points;
    let sent: Vec<u32> = read.iter().map(|point| point.probes.sent).collect();
    assert_eq!(sent, [[10; 5], [30; 5]].concat(), "each repeated second has the probes of three samples");
}

#[tokio::test]
async fn later_relation_period_is_used_for_repeated_seconds() {
    // Agents draw the numbers of relation periods at random. The relation period that arrived later counts, even if its
    // number is smaller.
    for (first_period, second_period) in [(1, u64::MAX), (u64::MAX, 1), (3, 2)] {
        let mut test_store = TestStore::new().await;
        let cloud = test_store.cloud;
        let sample_with =
            |relation_period, second, width| ClockSample { relation_period, ..sample(cloud, second, width) };
        store(&mut test_store, (1..=10).map(|second| sample_with(first_period, second, 90))).await;
        // The clock was set back by five seconds.
        let set_back: Vec<_> = (6..=12).map(|second| sample_with(second_period, second, 40)).collect();
        store(&mut test_store, set_back.clone()).await;
        let read = series(&test_store, 1_000).await.points;
        let expected = (1..=5).map(|second| sample_with(first_period, second, 90)).chain(set_back);
        assert_eq!(read, expected.map(point).collect::<Vec<_>>());
        // A bucket that contains the step shows the offset after the step.
        for point in series(&test_store, 2).await.points {
            let width = point.offset.as_ref().map(|offset| offset.bounds.width());
            let expected_width = if point.relation_period == first_period { 90 } else { 40 };
            assert_eq!(
                width,
                sample_with(1, 1, expected_width).offset.map(|offset| offset.bounds.width()),
                "{point:?}"
            );
        }
    }
}

#[tokio::test]
async fn samples_of_clock_far_behind_hide_no_others() {
    let mut test_store = TestStore::new().await;
    let cloud = test_store.cloud;
    let sample_with = |relation_period, second| ClockSample { relation_period, ..sample(cloud, second, 40) };
    // After a restart, the clock of a host without a battery is far behind until the host finds a time server.
    for (relation_period, seconds) in [(1, 1_000..1_010), (2, 10..20), (3, 1_020..1_030)] {
        store(&mut test_store, seconds.map(|second| sample_with(relation_period, second))).await;
    }
    let relation_periods: Vec<u64> =
        series(&test_store, 10_000).await.points.iter().map(|point| point.relation_period).collect();
    assert_eq!(relation_periods, [2, 1, 3].map(|relation_period| [relation_period; 10]).concat());
}

#[tokio::test]
async fn buckets_hold_widest_bounds_all_probes_and_median_delay() {
    let mut test_store = TestStore::new().await;
    let cloud = test_store.cloud;
    let samples = (1..=1_000).map(|second| {
        let mut sample = sample(cloud, second, 40 + second % 10);
        let up = sample.up.as_mut().expect("judged");
        up.median.as_mut().expect("has one").value = Span::from_micros(3_990 + second % 10);
        up.verdict = if second % 10 == 0 { Verdict::Stale } else { Verdict::Ok };
        sample
    });
    store(&mut test_store, samples).await;
    for (max_points, width) in
        [(1_000, 1), (999, 2), (500, 2), (200, 5), (199, 10), (34, 30), (1, 3_600), (0, 3_600)]
    {
        let series = series(&test_store, max_points).await;
        assert_eq!(series.bucket_s, width);
        assert!(series.points.len() <= max_points.max(1) as usize);
        let sent: u32 = series.points.iter().map(|point| point.probes.sent).sum();
        assert_eq!(sent, 10_000);
    }
    let series = series(&test_store, 100).await;
    assert_eq!(series.points.len(), 100);
    // A bucket ends at a multiple of its width: the buckets hold the seconds 1 to 10, 11 to 20 …
    let second_bucket = &series.points[1];
    assert_eq!((second_bucket.at, second_bucket.probes.lost), (generate::at(20.0), 10));
    let offset = second_bucket.offset.as_ref().expect("known");
    assert_eq!((offset.bounds, offset.at), (micros(249_951, 250_049), generate::at(19.0)));
    let trip = second_bucket.round_trip.expect("measured");
    assert_eq!((trip.min, trip.median), (Span::from_micros(80), Span::from_micros(3 * 44)));
    let (up, down) = (second_bucket.up.expect("judged"), second_bucket.down.expect("judged"));
    assert_eq!((up.count, down.count), (50, 40));
    let median = up.median.expect("has one");
    assert_eq!(median.value, Span::from_micros(3_994));
    let rate =
        |point: &ClockPoint| point.up.and_then(|up| up.median).and_then(|sample| sample.bits_per_second);
    let (read, sent) = (median.bits_per_second, rate(&point(sample(cloud, 14, 44))));
    assert_eq!(read, sent.map(f64::trunc), "rates are stored in whole bits per second");
    // A verdict applies to a bucket if a twentieth of the delays has it. Here a tenth of the uploads is stale.
    assert_eq!((up.verdict, down.verdict), (Verdict::Stale, Verdict::Limited));
    let wide_series = test_store
        .store
        .clock_series(&key(test_store.edge, cloud), generate::at(1.0), ALWAYS.1, 20)
        .await
        .expect("answers");
    assert_eq!(wide_series.points[1].up.expect("judged").verdict, Verdict::Stale);
}

#[tokio::test]
async fn store_and_page_merge_clock_points_equally() {
    let mut test_store = TestStore::new().await;
    let cloud = test_store.cloud;
    let samples = (1..=60).map(|second| {
        let sample = sample(cloud, second, 40 + second % 7);
        ClockSample { relation_period: u64::from(second > 25), ..sample }
    });
    store(&mut test_store, samples).await;
    let seconds = series(&test_store, 1_000).await;
    let buckets = series(&test_store, 6).await;
    assert_eq!((seconds.bucket_s, buckets.bucket_s, buckets.points.len()), (1, 10, 6));
    let points_by_bucket = seconds.points.chunk_by(|a, b| bucket_number(a.at, 10) == bucket_number(b.at, 10));
    for (bucket_of_store, points) in buckets.points.iter().zip(points_by_bucket) {
        let mut bucket_of_page = ClockBucket::default();
        points.iter().for_each(|point| bucket_of_page.add(point));
        let bucket_of_page = bucket_of_page.into_point().expect("points");
        assert_eq!(*bucket_of_store, ClockPoint { at: bucket_of_store.at, ..bucket_of_page });
    }
}

#[tokio::test]
async fn impossible_clock_values_are_stored_as_unknown() {
    let mut test_store = TestStore::new().await;
    let cloud = test_store.cloud;
    let sample_with = |second, change: fn(&mut ClockSample)| {
        let mut sample = sample(cloud, second, 40);
        change(&mut sample);
        sample
    };
    let earliest = WallTime::from_unix_nanos(i64::MIN);
    let mut extreme = sample(cloud, 9, 40);
    extreme.at = WallTime::from_unix_nanos(i64::MAX);
    for exchange in [&mut extreme.upper, &mut extreme.lower].into_iter().flatten() {
        (exchange.sent, exchange.replied, exchange.uncertainty) =
            (RawTime::from_wall(earliest), RawTime::from_wall(earliest), Span::from_nanos(i64::MIN));
    }
    extreme.exchanges.accepted = u64::MAX;
    let samples = [
        sample_with(1, |sample| {
            sample.max_drift_ppm = f64::NAN;
            sample.offset.as_mut().expect("known").skew_ppm = Some(f64::INFINITY);
        }),
        sample_with(2, |sample| sample.offset.as_mut().expect("known").bounds = micros(9, -9)),
        sample_with(3, |sample| sample.offset.as_mut().expect("known").estimate = Span::from_nanos(i64::MAX)),
        sample_with(4, |sample| {
            let sources = &mut sample.offset.as_mut().expect("known").sources;
            let first_source = sources[0];
            sources.extend((0..100_000).map(|_| first_source));
            sources.push((DelaySource::Kernel, micros(9, -9)));
        }),
        sample_with(5, |sample| {
            for delay in [&mut sample.up, &mut sample.down].into_iter().flatten() {
                let median = delay.median.as_mut().expect("has one");
                (median.value, median.bounds) = (Span::from_millis(-4), micros(-4_001, -3_999));
            }
        }),
        sample_with(6, |sample| {
            sample.up.as_mut().expect("judged").median.as_mut().expect("has one").bits_per_second =
                Some(f64::NAN);
        }),
        ClockSample { at: earliest, ..sample(cloud, 7, 40) },
        extreme,
    ];
    store(&mut test_store, samples).await;
    assert_eq!(test_store.count("SELECT count(*) FROM clock_sample").await, 8);
    assert_eq!(test_store.count("SELECT count(*) FROM clock_sample WHERE max_drift_ppm IS NULL").await, 1);
    assert!(test_store.count("SELECT max(length(offset_sources)) FROM clock_sample").await < 100);
    let (from, to) = (generate::at(0.0), generate::at(100.0));
    let points = test_store
        .store
        .clock_series(&key(test_store.edge, cloud), from, to, 100)
        .await
        .expect("answers")
        .points;
    // The first point is the sample of second 1. The samples with extreme times are outside of the
    // series.
    let offset_at = |index: usize| points[index].offset.as_ref();
    assert_eq!(offset_at(0).expect("known").skew_ppm, None);
    assert_eq!((offset_at(1), offset_at(2)), (None, None));
    assert_eq!(offset_at(3).expect("known").sources.len(), 2);
    assert_eq!((points[4].up.expect("judged").median, points[4].down.expect("judged").median), (None, None));
    assert_eq!(points[5].up.expect("judged").median.expect("has one").bits_per_second, None);
    // The point limit also holds for a series over all times.
    assert!(series(&test_store, 1_000).await.points.len() <= 1_000);
    assert_eq!(test_store.store.links().await.expect("answers").len(), 1);
}

#[tokio::test]
async fn cloud_without_hello_has_latest_name_from_edge() {
    let mut test_store = TestStore::new().await;
    test_store.cloud = HostId::random();
    let sample_of_cloud = |name: &str, second| ClockSample {
        peer_name: name.parse().expect("a name"),
        ..sample(test_store.cloud, second, 40)
    };
    let samples = [sample_of_cloud("far", 1), sample_of_cloud("farther", 2)];
    store(&mut test_store, samples).await;
    let name = async |test_store: &TestStore| {
        let links = test_store.store.links().await.expect("answers");
        assert_eq!(links.len(), 1);
        links[0].cloud_name.to_string()
    };
    assert_eq!(name(&test_store).await, "farther");
    let host: HostDescription = generate::host(test_store.cloud, "base");
    test_store.commit(&[super::hello(host, 1)]).await;
    assert_eq!(name(&test_store).await, "base");
    assert_eq!(series(&test_store, 10).await.points.len(), 2);
}

#[tokio::test]
async fn quarantined_batch_leaves_gap_and_no_clock_samples() {
    let mut test_store = TestStore::new().await;
    let mut numbers = generate::Numbers::new(1);
    let foreign: Iteration =
        generate::iteration(RunId::random(), 9, (HostId::random(), test_store.cloud), &mut numbers);
    // The sample is taken from a link, because the shared module `clocks` may have no unused
    // function in this crate.
    let live = link(sample(test_store.cloud, 3, 40));
    let bad = test_store.batch(vec![event(sample(test_store.cloud, 2, 40)), Event::Iteration(foreign)]);
    let good = test_store.batch(vec![event(live.latest_sample)]);
    let committed = test_store.commit(&[bad, good]).await;
    assert_eq!(committed.quarantined.len(), 1);
    assert_eq!(test_store.count("SELECT count(*) FROM clock_sample").await, 1);
    assert_eq!(
        test_store.count("SELECT count(*) FROM clock_sample JOIN link ON link.id = clock_sample.link").await,
        1
    );
    // The gap stands for both events of the quarantined batch. It begins with iteration 9, which
    // started 1.8 s after `generate::at(0.0)`.
    let gap = "SELECT count(*) FROM gap WHERE run IS NULL AND count = 2 AND from_ns = 1735689601800000000";
    assert_eq!(test_store.count(gap).await, 1);
    let (_, newest_event_time) = &committed.hosts[&test_store.edge];
    assert!(*newest_event_time < Some(NOW), "event times are by the host's clock");
}
