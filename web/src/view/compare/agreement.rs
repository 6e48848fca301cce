//! Tests that a page shows the same values for stored runs as tables and figures show for the files of these runs.

use peernet_analysis::loaded::Loaded;
use peernet_analysis::message_sizes::line_through_medians;
use peernet_analysis::payload_study::{DirectionMessages, Link, PayloadStudy};
use peernet_analysis::quality::Quality;
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::{Outcome, Row, RowRef};
use peernet_analysis::transfer::DirectionNodes;
use peernet_clock::Span;
use peernet_logger::{Name, stage};
use peernet_statistics::Sketch;
use peernet_store::{MeanBucket, RunStatistics, StageMeans};
use peernet_stream::{OutcomeCounts, PlacementKind};

use super::*;
use crate::tests::samples;

/// Number of rows of each run.
const ROWS: u64 = 200;
/// Number of rows of a run from which the store makes one bucket of means.
const BUCKET_ROWS: usize = 10;

/// Returns a run as it is loaded from a result folder. `values` returns the values of the row of an iteration.
fn loaded(folder: &str, values: impl Fn(u64) -> Vec<(&'static str, f64)>) -> Loaded {
    let row = |iteration: u64| Row {
        iteration,
        at: iteration as f64 * 0.1,
        episode: 0,
        step: 0,
        warm_up: false,
        outcome: Outcome::Ok,
        reason: None,
        values: values(iteration).into_iter().map(|(name, value)| (name.into(), value)).collect(),
        upload: None,
        download: None,
    };
    let record = RunRecord { format: 1, ..RunRecord::default() };
    Loaded { folder: folder.into(), record, rows: (1..=ROWS).map(row).collect() }
}

fn in_statistics(run: &Loaded) -> Vec<RowRef<'_>> {
    run.rows.iter().filter(RowRef::is_in_statistics).collect()
}

/// Returns a configuration that has only this run, with its statistics as the store returns them.
fn stored((index, run): (usize, &Loaded)) -> Configuration {
    let mut mergeable = MergeableStatistics::default();
    for (column, value) in in_statistics(run).iter().flat_map(RowRef::values) {
        let mut summary = Summary::default();
        summary.record(value);
        mergeable.add(Name::from(&**column), "s", &summary);
    }
    let RunStatistics { stages, bounds, mergeable } = RunStatistics::from(mergeable);
    let mut summary = tests::run(index as i64 + 1, PlacementKind::Local);
    summary.counts = OutcomeCounts { ok: in_statistics(run).len() as u64, ..OutcomeCounts::default() };
    let name = char::from(b'A' + index as u8).to_string();
    let values = vec![name.clone(), String::new()];
    Configuration { name, values, runs: vec![summary], stages, bounds, mergeable, model_computes: true }
}

/// Returns the comparison of the stored runs, and their means over time.
fn page(runs: &[Loaded]) -> (Comparison, RunMeans) {
    let mean_bucket = |name: &Name, (bucket, rows): (usize, &[RowRef<'_>])| {
        let values: Vec<f64> = rows.iter().filter_map(|row| row.value(name)).collect();
        let at = samples::NOW + Span::from_seconds(bucket as i64);
        let (count, sum) = (values.len() as u64, values.iter().sum::<f64>());
        (count > 0).then(|| MeanBucket { at, count, mean: sum / count as f64 })
    };
    let means = |run: &Loaded| {
        let rows = in_statistics(run);
        let stage = |name: Name| StageMeans {
            buckets: rows
                .chunks(BUCKET_ROWS)
                .enumerate()
                .filter_map(|bucket| mean_bucket(&name, bucket))
                .collect(),
            stage: name,
        };
        [stage::TOTAL, stage::STAGES_TOTAL, stage::SENSING].map(stage).to_vec()
    };
    let means = runs.iter().enumerate().map(|(index, run)| (index as i64 + 1, means(run)));
    (tests::comparison(runs.iter().enumerate().map(stored).collect()), means.collect())
}

#[test]
fn page_and_table_have_equal_ranking() {
    let wave = |iteration: u64| 1.0 + 0.1 * (iteration as f64).sin();
    let fast = loaded("fast", |iteration| {
        vec![("total", 0.010 * wave(iteration)), ("stages-total", 0.009 * wave(iteration))]
    });
    // By its totals this run is slower than `fast`, but some of its iterations have no total. All runs are therefore
    // compared by the sums of their stages, by which this run is faster.
    let partial = loaded("partial", |iteration| {
        let total = (iteration % 3 > 0).then_some(("total", 0.012 * wave(iteration)));
        total.into_iter().chain([("stages-total", 0.005 * wave(iteration))]).collect()
    });
    let same = loaded("same", |iteration| {
        vec![("total", 0.010 * wave(iteration + 7)), ("stages-total", 0.005 * wave(iteration + 7))]
    });
    let nothing = loaded("nothing", |_| Vec::new());
    for runs in [vec![fast.clone(), partial.clone()], vec![fast, partial, same.clone()], vec![same, nothing]]
    {
        let table = peernet_analysis::compare::Comparison::new(&runs);
        let (comparison, means) = page(&runs);
        assert_eq!(comparison.total_column, table.total_column);
        let baseline = 0;
        let differences = Differences::of(&comparison, &means, baseline);
        let ranking = differences.ranking.expect("several runs are measured");
        assert_eq!(
            (Some(ranking.best), ranking.ties(), ranking.untested(), differences.unranked),
            (table.best, table.ties, table.untested, table.unranked)
        );
        for (line, configuration) in table.lines.iter().zip(&comparison.configurations) {
            let means = (line.latency(table.total_column.name()), comparison.total(configuration));
            let means = (means.0.map(|latency| latency.mean), means.1.map(|latency| latency.mean));
            assert_eq!(means.0.is_some(), means.1.is_some());
            let difference = means.0.unwrap_or_default() - means.1.unwrap_or_default();
            assert!(difference.abs() < 1e-12 && line.count == configuration.iterations(), "{means:?}");
        }
    }
}

#[test]
fn page_and_figure_have_equal_qualities() {
    let scored = loaded("scored", |iteration| {
        let mut values = vec![("total", 0.010), ("top-1", f64::from(iteration % 3 == 0)), ("mean-iou", 0.5)];
        if iteration % 20 == 0 {
            values.extend([
                ("episode-success", f64::from(iteration % 40 == 0)),
                ("episode-return", -(iteration as f64)),
            ]);
        }
        values
    });
    // In a detection, `mean-iou` is a value of the boxes and not a quality.
    let detector = loaded("detector", |iteration| {
        vec![("total", 0.012), ("map-50", iteration as f64 / ROWS as f64), ("mean-iou", 0.7)]
    });
    let runs = [scored, detector];
    let (comparison, _) = page(&runs);
    let close = |a: f64, b: f64| (a - b).abs() < 1e-9;
    for (run, configuration) in runs.iter().zip(&comparison.configurations) {
        for quality in Quality::ALL {
            let (file, page) =
                (quality.from_rows(|| run.rows.iter()), qualities::estimate(configuration, quality));
            let Some((file, page)) = file.zip(page) else {
                assert_eq!((file, page), (None, None), "{quality:?}");
                continue;
            };
            assert!(file.count == page.count && close(file.value, page.value), "{file:?} {page:?}");
            let ends = [(file.interval.0, page.interval.0), (file.interval.1, page.interval.1)];
            assert!(ends.into_iter().all(|(file, page)| close(file, page)), "{file:?} {page:?}");
        }
    }
    let known = |configuration: &Configuration| {
        let is_known = |quality: &Quality| qualities::estimate(configuration, *quality).is_some();
        Quality::ALL.into_iter().filter(is_known).collect::<Vec<_>>()
    };
    let scored = vec![Quality::Top1, Quality::MeanIou, Quality::Success, Quality::Return];
    assert_eq!(
        comparison.configurations.iter().map(known).collect::<Vec<_>>(),
        [scored, vec![Quality::Map50]]
    );
}

/// Returns the payload studies of the files of these runs. All runs use the same link.
fn studies_of_files(runs: &[Loaded]) -> Vec<PayloadStudy> {
    let rows: Vec<RowRef<'_>> = runs.iter().flat_map(in_statistics).collect();
    let directions = DirectionNodes::both().map(|nodes| DirectionMessages::from_rows(nodes, &rows));
    PayloadStudy::select_drawable([PayloadStudy::new(&Link::from(&runs[0].record), directions, None)])
}

#[test]
fn page_and_figure_have_equal_latencies_against_payload() {
    // A latency of 0.8 ms and 11.2 MB/s. The median wait is 0.1 ms, and one upload in twenty waits 50 ms.
    let run = |payload: f64| {
        loaded("sized", move |iteration| {
            let late = if iteration % 20 == 0 { 50e-3 } else { (iteration * 37 % 200) as f64 * 1e-6 };
            let delay = 0.8e-3 + (payload + 120.0) / 11.2e6 + late;
            vec![("upload", delay), ("upload-bytes", payload), ("upload-logger-bytes", 120.0)]
        })
    };
    let runs = [1e3, 1e4, 1e4, 1e5, 1e6].map(run);
    let (file, page) = (studies_of_files(&runs), payload::studies(&page(&runs).0));
    let (file, page) = (&file[0].directions, &page[0].directions);
    assert_eq!((file.len(), page.len()), (1, 1), "no message was sent from cloud to edge");
    let relative = |a: f64, b: f64| (a / b - 1.0).abs();
    for (file, page) in file[0].sizes.iter().zip(&page[0].sizes) {
        assert_eq!((file.payload_bytes, file.count), (page.payload_bytes, page.count));
        assert_eq!(file.wire_bytes, page.wire_bytes);
        let tolerance = page.relative_error;
        assert!((tolerance, file.relative_error) == (Sketch::RELATIVE_ERROR, 0.0));
        assert!(relative(page.median, file.median) <= tolerance, "{file:?} {page:?}");
        let [file, page] = [file, page].map(|size| size.tails.expect("enough messages"));
        assert!(relative(page.0, file.0) <= tolerance && relative(page.1, file.1) <= tolerance);
    }
    let line = |study: &[DirectionMessages]| line_through_medians(&study[0].sizes).expect("four sizes");
    let (file, page) = (line(file), line(page));
    // The two lines differ by no more than the medians do. A line through the means would have an intercept of 3.3 ms.
    assert!(relative(page.at(1_120.0), file.at(1_120.0)) < 0.01, "{file:?} {page:?}");
    assert!(relative(page.slope.value, file.slope.value) < 0.015, "{file:?} {page:?}");
    assert!((page.intercept.value - 0.9e-3).abs() < 0.05e-3, "{page:?}");
}

#[test]
fn page_and_figure_draw_equal_selections_of_payloads() {
    let run = |payload: f64| {
        loaded("sized", move |iteration| {
            // Answers have two sizes only in the case with a payload above 1 MB, so downloads are drawn only there.
            let download = if payload > 1e6 { 9e3 } else { 1e3 };
            vec![
                ("upload", 1e-3 + payload * 1e-7 * (iteration % 7) as f64),
                ("upload-bytes", payload),
                ("download", 1e-3),
                ("download-bytes", download),
            ]
        })
    };
    for (sizes, directions) in [
        // Similar sizes, as those of one camera.
        (vec![1e3, 1.5e3, 1.9e3], vec![]),
        (vec![1e6, 4e6], vec!["upload", "download"]),
        (vec![1e3, 1e3, 5e5], vec!["upload"]),
        ((1..=30).map(|size| f64::from(size) * 1e3).collect(), vec!["upload"]),
    ] {
        let runs: Vec<Loaded> = sizes.into_iter().map(run).collect();
        let sizes_by_direction = |studies: &[PayloadStudy]| {
            let all = studies.iter().flat_map(|study| &study.directions);
            let sizes = |direction: &DirectionMessages| {
                direction.sizes.iter().map(|size| (size.payload_bytes, size.count)).collect()
            };
            all.map(|direction| (direction.name, sizes(direction))).collect::<Vec<(&str, Vec<(u64, u64)>)>>()
        };
        let (file, page) = (
            sizes_by_direction(&studies_of_files(&runs)),
            sizes_by_direction(&payload::studies(&page(&runs).0)),
        );
        assert_eq!(file.iter().map(|(name, _)| *name).collect::<Vec<_>>(), directions);
        assert_eq!(file, page);
    }
}
