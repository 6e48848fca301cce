//! Tests of the figures that results have, and of the values that these figures show.

mod calibration;
mod extremes;
mod left_out;
mod length;
mod missing_values;
mod replayed;
mod scores;

use peernet_stream::ExperimentPosition;

use super::*;
use crate::render::file;
use peernet_analysis::figure_files::{HISTOGRAMS, figure_files};
use peernet_analysis::quality::{Quality, QualityEstimate};
use peernet_analysis::record::{ModelRecord, Placement};
use peernet_analysis::rows::{Outcome, Row};
use peernet_analysis::slowness::REST_OF_UNATTRIBUTED;
use written_figures::AnyFigure;

/// Rows that a test can change.
trait ChangeRows {
    /// Applies `change` to each row.
    fn change(&mut self, change: impl FnMut(&mut Row));
}

impl ChangeRows for Rows {
    fn change(&mut self, mut change: impl FnMut(&mut Row)) {
        let changed = self.iter().map(|row| {
            let mut row = row.to_row();
            change(&mut row);
            row
        });
        *self = changed.collect();
    }
}

/// Returns a run with rows 1 to `count`. The first five rows are warm-up, and the seventh iteration is lost.
/// `values_of` returns the values of a row. Values of columns whose names contain `-` are taken as they are; other
/// values are in milliseconds.
fn run(count: u64, values_of: impl Fn(u64) -> Vec<(&'static str, f64)>) -> Loaded {
    let row = |number: u64| Row {
        iteration: number,
        at: 1e9 + number as f64 / 10.0,
        episode: (number / 20) as u32,
        step: 0,
        warm_up: number <= 5,
        outcome: if number == 7 { Outcome::Lost } else { Outcome::Ok },
        reason: None,
        values: if number == 7 {
            Vec::new()
        } else {
            let in_si = |name: &str, value: f64| if name.contains('-') { value } else { value / 1e3 };
            values_of(number).into_iter().map(|(name, value)| (name.into(), in_si(name, value))).collect()
        },
        upload: None,
        download: None,
    };
    let record =
        RunRecord { title: "robot → cloud".to_owned(), name: "p".to_owned(), ..RunRecord::default() };
    Loaded { folder: "results".into(), record, rows: (1..=count).map(row).collect() }
}

/// Returns a run that computes in the cloud and has no totals.
fn remote(count: u64) -> Loaded {
    run(count, |number| {
        vec![("sensing", 1.0), ("upload", 10.0 + number as f64 % 3.0), ("inference", 5.0), ("download", 1.0)]
    })
}

/// Returns a run of an experiment that compares models and placements. `inference` is the shortest latency of the model
/// in ms.
fn placed(model: &str, kind: &str, inference: f64) -> Loaded {
    let mut run = run(50, |number| vec![("sensing", 1.0), ("inference", inference + number as f64 % 3.0)]);
    run.record.model = Some(ModelRecord { name: model.to_owned(), device: None, sha256: None });
    run.record.placement = Placement { kind: kind.to_owned(), network: None, address: None };
    let configuration = vec![("model".to_owned(), model.to_owned()), ("where".to_owned(), kind.to_owned())];
    let position = ExperimentPosition {
        name: "e".to_owned(),
        id: "1".to_owned(),
        configuration,
        repeat: 0,
        ..ExperimentPosition::default()
    };
    run.record.experiment = Some(position);
    run
}

fn file_names(files: &[PathBuf]) -> Vec<String> {
    files.iter().map(|file| file.file_name().expect("a name").to_string_lossy().into_owned()).collect()
}

/// Returns the names of the files of a figure.
fn written_as(stem: &str) -> Vec<String> {
    [".png", ".svg", ".pdf", "-caption.txt"].map(|ending| format!("{stem}{ending}")).to_vec()
}

#[test]
fn run_has_six_histograms_of_original_program() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = remote(60);
    let files = of_run(&run.record, &run.rows, folder.path()).expect("written");
    let six_histograms = HISTOGRAMS.map(|(stem, ..)| written_as(stem)).concat();
    assert_eq!(
        file_names(&files),
        six_histograms,
        "a run without throughputs and totals has six histograms and no other figure"
    );
    assert!(files.iter().all(|file| file.is_file()));
    let svg = std::fs::read_to_string(folder.path().join("upload-time.svg")).expect("read");
    for text in ["Upload time · robot → cloud · n = 54", "median 11.0 ms"] {
        assert!(svg.contains(text), "{text}: {svg}");
    }
    let caption = std::fs::read_to_string(folder.path().join("upload-time-caption.txt")).expect("read");
    assert!(caption.contains("n = 54 · left out: 5 warm-up, 1 failed"), "{caption}");
    // This file is the SVG of the last histogram, which shows the throughput of downloads.
    assert!(std::fs::read_to_string(&files[21]).expect("read").contains("no values"));
    let with_total = run_with_total(20.0);
    let files = of_run(&with_total.record, &with_total.rows, folder.path()).expect("written");
    // The six histograms have 24 files.
    assert_eq!(file_names(&files)[24..], [written_as("cumulative"), written_as("series")].concat());
    assert_all_are_recognised(&files, folder.path());
}

/// Asserts that the files in a folder that are figures are exactly `files`, so that all are removed with the results.
fn assert_all_are_recognised(files: &[PathBuf], folder: &Path) {
    let recognised: BTreeSet<String> = figure_files(folder).into_iter().collect();
    assert_eq!(recognised, file_names(files).into_iter().collect());
}

/// Returns a run with totals that are a little longer than `total`, in ms, and with scores of answers.
fn run_with_total(total: f64) -> Loaded {
    run(100, |number| {
        // Three of four answers are right.
        let right = f64::from(u8::from(number % 4 != 0));
        vec![("total", total + number as f64 / 100.0), ("sensing", 1.0), ("upload", 1.0), ("top-1", right)]
    })
}

#[test]
fn local_run_has_no_network_figures() {
    let local = placed("s", "local", 5.0);
    let drawings = histograms::original_histograms(&local.record, &local.rows);
    let stems: Vec<&str> = drawings.iter().map(|drawing| drawing.stem.as_str()).collect();
    assert_eq!(stems, ["sensing-time", "inference-time"]);
}

#[test]
fn histogram_can_show_any_column() {
    let run = run(60, |number| vec![("gripper-force", number as f64)]);
    let drawings = histograms::drawings(&run, Some("gripper-force")).expect("there are numbers");
    let AnyFigure::Histogram(histogram) = &drawings[0].figure else { panic!("a histogram") };
    let stem = &drawings[0].stem;
    assert_eq!(
        (stem.as_str(), histogram.unit.title.as_str()),
        ("gripper-force-histogram", "Gripper force, as logged")
    );
    assert_eq!((histogram.values.len(), histogram.stage.as_str()), (54, "gripper-force"));
    assert!(
        histograms::drawings(&run, Some("nonsense"))
            .is_err_and(|missing| missing.to_string().contains("nonsense"))
    );
}

#[test]
fn bars_have_stages_that_add_up_to_total() {
    let with_total = |mut run: Loaded| {
        run.rows.change(|row| {
            if !row.values.is_empty() {
                let sum: f64 = row.values.iter().map(|(_, value)| value).sum();
                row.values.extend([("total".into(), sum + 2e-3), ("unattributed".into(), 2e-3)]);
            }
        });
        run
    };
    let runs = [with_total(placed("s", "local", 20.0)), with_total(placed("s", "remote", 4.0))];
    let drawings = stacked::drawings(&runs).expect("there are bars");
    let AnyFigure::Stacked(figure) = &drawings[0].figure else { panic!("bars") };
    assert_eq!(figure.stages, ["sensing", "inference", "unattributed"]);
    assert_eq!(figure.bars.iter().map(|bar| bar.label.as_str()).collect::<Vec<_>>(), ["local", "remote"]);
    let sum: f64 = figure.bars[0].means.iter().sum();
    assert!((sum - 24e-3).abs() < 5e-4 && figure.bars[0].std.is_some_and(|std| std > 0.0), "{figure:?}");
    assert!(figure.notes[0].contains("model, where") && figure.notes[0].contains("measured total"));
    assert_eq!(figure.notes[1..], ["n = 88 (44 each) · left out: 10 warm-up, 2 failed"]);
    let all_warm_up = [run(5, |_| vec![("sensing", 1.0)])];
    assert!(stacked::drawings(&all_warm_up).is_err_and(|missing| missing.to_string().contains("warm-up")));
}

#[test]
fn lateness_is_separate_part_of_bar() {
    let mut run = placed("s", "local", 20.0);
    run.rows.change(|row| {
        if !row.values.is_empty() {
            let sum: f64 = row.values.iter().map(|(_, value)| value).sum();
            row.values.extend([("total".into(), sum + 9e-3), ("unattributed".into(), 9e-3)]);
            row.values.push(("lateness".into(), 7e-3));
        }
    });
    let drawings = stacked::drawings(&[run]).expect("there are bars");
    let AnyFigure::Stacked(figure) = &drawings[0].figure else { panic!("bars") };
    assert_eq!(figure.stages[2..], ["lateness", REST_OF_UNATTRIBUTED]);
    let bar = &figure.bars[0];
    assert!((bar.means[2] - 7e-3).abs() < 1e-9 && (bar.means[3] - 2e-3).abs() < 1e-9, "{bar:?}");
    assert!((bar.means.iter().sum::<f64>() - bar.total).abs() < 1e-9, "{bar:?}");
    assert!(figure.notes.iter().any(|note| note.starts_with("late start: ")), "{:?}", figure.notes);
}

/// Returns the estimate of a quality for `right` right answers or successes out of `count`.
fn estimate_of_counts(quality: Quality, right: u64, count: u64) -> Option<QualityEstimate> {
    let mean = right as f64 / count as f64;
    quality.from_statistics(|name| (name == quality.name()).then_some((count, mean, None)))
}

#[test]
fn accuracy_is_drawn_against_latency() {
    let labelled = |model: &str, total: f64| {
        let record = placed(model, "local", 1.0).record;
        Loaded { record, ..run_with_total(total) }
    };
    let drawings = accuracy::drawings(&[labelled("s", 20.0), labelled("m", 80.0), placed("l", "local", 9.0)]);
    let drawings = drawings.expect("there are labels");
    let AnyFigure::QualityAgainstLatency(figure) = &drawings[0].figure else { panic!("points") };
    assert_eq!(
        figure.points.iter().map(|point| (point.label.as_str(), Some(point.estimate))).collect::<Vec<_>>(),
        ["s", "m"].map(|label| (label, estimate_of_counts(Quality::Top1, 70, 94)))
    );
    assert!(
        (figure.points[1].median - 80.53e-3).abs() < 1e-4 && figure.points[1].p95.is_some(),
        "{figure:?}"
    );
    let expected_notes =
        ["left out: 15 warm-up, 3 failed", "left out: 1 configuration without scored samples"];
    assert_eq!(figure.notes[1..], expected_notes);
    let mut with_invalid_scores = labelled("s", 20.0);
    with_invalid_scores.rows.change(|row| {
        let scores = row.values.iter_mut().filter(|(name, _)| name == "top-1" && row.iteration > 90);
        scores.for_each(|(_, score)| *score = f64::NAN);
    });
    let drawings =
        accuracy::drawings(&[with_invalid_scores, placed("l", "local", 9.0)]).expect("there are labels");
    let AnyFigure::QualityAgainstLatency(figure) = &drawings[0].figure else { panic!("points") };
    assert_eq!(figure.notes[3], "not scored: 10 iterations without a valid score");
    assert!(
        accuracy::drawings(&[placed("l", "local", 9.0)])
            .is_err_and(|missing| missing.to_string().contains("top-1"))
    );
}

#[test]
fn bar_of_single_configuration_is_drawn_only_on_request() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut repeats = [placed("s", "local", 20.0), placed("s", "local", 21.0)];
    repeats[1].record.experiment.as_mut().expect("an experiment").repeat = 1;
    assert_eq!(of_experiment(&repeats, folder.path()).expect("nothing to write"), Vec::<PathBuf>::new());
    let requested =
        draw(Kind::Stacked, &repeats, &Columns::default(), folder.path()).expect("drawn on request");
    assert_eq!(file_names(&requested.files), written_as("stacked"));
}

#[test]
fn figure_of_totals_has_at_most_four_curves() {
    let with_total = |model: &str, total: f64| {
        let record = placed(model, "local", 1.0).record;
        Loaded { record, ..run_with_total(total) }
    };
    let runs = ["s", "m", "l", "xl", "xxl"].map(|model| with_total(model, 20.0));
    let drawings = totals::drawings(&runs).expect("there are totals");
    assert_eq!(
        drawings.iter().map(|drawing| drawing.stem.as_str()).collect::<Vec<_>>(),
        ["totals", "totals-2"]
    );
    let AnyFigure::Cumulative(figure) = &drawings[0].figure else { panic!("curves") };
    assert_eq!(figure.curves.iter().map(|curve| curve.values.len()).collect::<Vec<_>>(), [94; 4]);
    assert_eq!(figure.notes[..2], ["n = 94 each", "configurations: model, where · measured total"]);
    assert!(totals::drawings(&[remote(4)]).is_err(), "all rows are warm-up");
}

#[test]
fn run_has_curves_of_total_and_longest_stages() {
    let run = run_with_total(20.0);
    let drawings = cumulative::drawings(&run.record, &run.rows, None).expect("there is a total");
    let AnyFigure::Cumulative(figure) = &drawings[0].figure else { panic!("curves") };
    let names: Vec<&str> = figure.curves.iter().map(|curve| curve.name.as_str()).collect();
    assert_eq!(names, ["total", "sensing", "upload"]);
    let of_upload = cumulative::drawings(&run.record, &run.rows, Some("upload")).expect("there are values");
    assert_eq!((of_upload.len(), of_upload[0].stem.as_str()), (1, "upload-cumulative"));
    assert!(cumulative::drawings(&run.record, &run.rows, Some("nonsense")).is_err());
}

#[test]
fn models_are_paired_by_placement() {
    let runs = [
        placed("s", "remote", 4.0),
        placed("s", "local", 20.0),
        placed("m", "local", 30.0),
        placed("m", "remote", 6.0),
    ];
    let drawings = paired::drawings(&runs, None).expect("there are pairs");
    let AnyFigure::Paired(figure) = &drawings[0].figure else { panic!("pairs") };
    assert_eq!(figure.placements, ["local", "cloud"]);
    assert_eq!(figure.groups.iter().map(|group| group.name.as_str()).collect::<Vec<_>>(), ["s", "m"]);
    assert_eq!(
        figure.groups[1].values.iter().map(peernet_analysis::order::SortedValues::len).collect::<Vec<_>>(),
        [44, 44]
    );
    assert!(figure.groups[0].values[0].median() > figure.groups[0].values[1].median());
    // Two models at one placement, and two models at different placements.
    for unpaired in [[runs[1].clone(), runs[2].clone()], [runs[0].clone(), runs[2].clone()]] {
        let missing = paired::drawings(&unpaired, None).expect_err("no model ran at two placements");
        assert!(missing.to_string().contains("one model at two placements"), "{missing}");
    }
    assert!(paired::drawings(&runs, Some("ipc")).is_err());
}

#[test]
fn payloads_of_several_sizes_are_fitted() {
    let sized = run(300, |number| {
        let bytes = [1e3, 1e4, 1e5, 1e6][number as usize % 4];
        // 0.2 ms plus the size at 100 MB/s, with a small variation.
        let delay = 0.2 + bytes / 1e5 * (1.0 + (number as f64 % 5.0) * 1e-4);
        vec![("upload-bytes", bytes), ("upload", delay), ("download-bytes", 8.0), ("download", 0.1)]
    });
    let drawings = payload::drawings(std::slice::from_ref(&sized)).expect("sizes differ");
    assert_eq!(
        drawings.iter().map(|drawing| drawing.stem.as_str()).collect::<Vec<_>>(),
        ["payload-latency", "payload-throughput"]
    );
    let AnyFigure::Scaling(latency) = &drawings[0].figure else { panic!("a fit") };
    assert_eq!(latency.series.len(), 1, "all answers have one size, so downloads have no series");
    assert_eq!(
        latency.series[0].values.iter().map(|value| value.bytes).collect::<Vec<_>>(),
        [1e3, 1e4, 1e5, 1e6]
    );
    let (intercept, slope) = latency.series[0].line.expect("a line");
    assert!((intercept - 0.2e-3).abs() < 2e-5 && (slope * 1e8 - 1.0).abs() < 0.01, "{intercept} {slope}");
    assert!(latency.series[0].name.contains(" ± ") && latency.series[0].name.contains("MB/s"), "{latency:?}");
    assert!(latency.series[0].name.contains("size ÷ (99.98"), "{latency:?}");
    let AnyFigure::Scaling(throughput) = &drawings[1].figure else { panic!("a fit") };
    assert!(
        throughput.series[0].name.starts_with("upload: 99.98") && throughput.series[0].name.contains(" ± ")
    );
    assert!(latency.title.starts_with("One-way delay against payload"));
    let download_note =
        "not drawn: download of 8 B, because the largest size must be at least twice the smallest";
    let expected_notes = [download_note, "left out: 5 warm-up, 1 failed", "messages of each size: 73 to 74"];
    assert_eq!(latency.notes, expected_notes);
    assert_eq!(throughput.notes, latency.notes);
    assert_eq!(
        (drawings[0].left_out.as_slice(), drawings[1].left_out.len()),
        (&[download_note.to_owned()][..], 0)
    );
    assert!(payload::drawings(&[remote(60)]).is_err());
    let with_model = |model: &str| {
        let record = placed(model, "remote", 1.0).record;
        Loaded { record, folder: "results".into(), rows: sized.rows.clone() }
    };
    let drawings = payload::drawings(&[with_model("s"), with_model("m")]).expect("sizes differ");
    let AnyFigure::Scaling(throughput) = &drawings[1].figure else { panic!("a fit") };
    let expected_notes = [
        download_note,
        "messages of 2 runs, pooled, that differ in model",
        "left out: 10 warm-up, 2 failed",
        "messages of each size: 146 to 148",
    ];
    assert_eq!(throughput.notes, expected_notes);
}

/// Returns the run of one of `edges` edges that use the cloud at the same time. `edge` is its index.
fn run_of_edge(model: &str, edges: usize, edge: usize, total: f64) -> Loaded {
    let mut run = run_with_total(total);
    run.record.edge.name = format!("robot-{edge}");
    let configuration = vec![("model".to_owned(), model.to_owned()), ("edges".to_owned(), edges.to_string())];
    let position = ExperimentPosition {
        name: "e".to_owned(),
        id: "1".to_owned(),
        configuration,
        repeat: 0,
        ..ExperimentPosition::default()
    };
    run.record.experiment = Some(position);
    run
}

#[test]
fn concurrent_edges_have_curve_per_model() {
    let at_once = |model: &'static str, edges: usize, total: f64| {
        (0..edges).map(move |edge| run_of_edge(model, edges, edge, total + edge as f64)).collect::<Vec<_>>()
    };
    let runs = [at_once("s", 2, 40.0), at_once("s", 1, 20.0), at_once("m", 1, 30.0), at_once("m", 3, 90.0)];
    let drawings = users::drawings(&runs.concat()).expect("there are several edges");
    assert_eq!(drawings.iter().map(|drawing| drawing.stem.as_str()).collect::<Vec<_>>(), ["users"]);
    let AnyFigure::Sharing(figure) = &drawings[0].figure else { panic!("curves") };
    assert_eq!(figure.curves.iter().map(|curve| curve.name.as_str()).collect::<Vec<_>>(), ["s", "m"]);
    let edges =
        |curve: usize| figure.curves[curve].points.iter().map(|point| point.edges).collect::<Vec<_>>();
    assert_eq!((edges(0), edges(1)), (vec![1, 2], vec![1, 3]));
    let two_edges = &figure.curves[0].points[1];
    // Both edges have the same rate, and the totals of the second edge are a millisecond longer.
    assert_eq!((two_edges.fairness, two_edges.edge_medians.len()), (Some(1.0), 2));
    assert!(
        (two_edges.edge_medians[1] - two_edges.edge_medians[0] - 1e-3).abs() < 1e-9
            && two_edges.p95.is_some(),
        "{two_edges:?}"
    );
    assert!(
        two_edges.edge_medians[0] < two_edges.median && two_edges.median < two_edges.edge_medians[1],
        "{two_edges:?}"
    );
    let folder = tempfile::tempdir().expect("a folder");
    let files = of_experiment(&runs.concat(), folder.path()).expect("written");
    assert!(file_names(&files).ends_with(&written_as("users")), "{files:?}");
    let files = of_experiment(&runs[0], folder.path()).expect("written");
    assert!(
        !file_names(&files).contains(&"users.png".to_owned()),
        "one number of edges is no curve: {files:?}"
    );
    assert!(users::drawings(&runs[1]).is_err_and(|missing| missing.to_string().contains("experiment.users")));
}

#[test]
fn more_than_four_curves_need_a_second_figure() {
    let runs = ["a", "b", "c", "d", "e"]
        .map(|model| vec![run_of_edge(model, 2, 0, 20.0), run_of_edge(model, 2, 1, 20.0)]);
    let drawings = users::drawings(&runs.concat()).expect("there are several edges");
    assert_eq!(
        drawings.iter().map(|drawing| drawing.stem.as_str()).collect::<Vec<_>>(),
        ["users", "users-2"]
    );
}

#[test]
fn series_has_totals_stages_warm_up_and_failed_iterations() {
    let mut run = remote(60);
    run.rows.change(|row| {
        let total = (!row.values.is_empty()).then(|| ("total".into(), 20e-3));
        row.values.extend(total);
    });
    let drawings = series::drawings(&run.record, &run.rows).expect("there is a total");
    let AnyFigure::TimeSeries(time_series) = &drawings[0].figure else { panic!("a time series") };
    assert_eq!(time_series.total.values.len(), 59);
    assert_eq!(
        time_series.stages.iter().map(|line| line.name.as_str()).collect::<Vec<_>>(),
        ["sensing", "upload", "inference", "download"]
    );
    let is_near = |value: f64, expected: f64| (value - expected).abs() < 1e-6;
    // Times are relative to the first row. Rows have a distance of 0.1 s, and row 7 failed.
    assert!(
        is_near(time_series.failure_times[0], 0.6) && time_series.failure_times.len() == 1,
        "{time_series:?}"
    );
    assert!(is_near(time_series.warm_up[0].0, 0.0) && is_near(time_series.warm_up[0].1, 0.5));
    assert!(is_near(time_series.episode_starts[0], 1.9) && time_series.episode_starts.len() == 3);
    assert!(time_series.notes[0].starts_with("n = 54 and 5 warm-up"), "{:?}", time_series.notes);
    run.rows.change(|row| row.at = 0.0);
    let AnyFigure::TimeSeries(time_series) =
        &series::drawings(&run.record, &run.rows).expect("there is a total")[0].figure
    else {
        panic!("a time series")
    };
    assert_eq!(
        (time_series.x_title.as_str(), time_series.x_is_iteration, time_series.failure_times[0]),
        ("Iteration", true, 7.0)
    );
    run.rows.change(|row| row.outcome = Outcome::Lost);
    assert!(series::drawings(&run.record, &run.rows).is_err());
}

#[test]
fn series_counts_failures_of_warm_up_separately() {
    let mut run = remote(60);
    run.rows.change(|row| {
        row.values.push(("total".into(), 20e-3));
        // The iterations 1 to 5 are warm-up, and the iteration 7 is lost.
        if row.iteration <= 2 {
            row.outcome = Outcome::Failed;
        }
    });
    let drawings = series::drawings(&run.record, &run.rows).expect("there is a total");
    let AnyFigure::TimeSeries(time_series) = &drawings[0].figure else { panic!("a time series") };
    let svg = file::svg(&time_series.figure());
    assert!(svg.contains("failed (1, and 2 in the warm-up)"), "{svg}");
}

#[test]
fn experiment_has_figures_for_which_it_has_data() {
    let folder = tempfile::tempdir().expect("a folder");
    let runs = [placed("s", "local", 20.0), placed("s", "remote", 4.0)];
    let files = of_experiment(&runs, folder.path()).expect("written");
    assert_eq!(file_names(&files), [written_as("stacked"), written_as("paired")].concat());
    assert_eq!(of_experiment(&[], folder.path()).expect("nothing to write"), Vec::<PathBuf>::new());
    let new_folder = folder.path().join("new");
    let error = draw(Kind::Payload, &runs, &Columns::default(), &new_folder).expect_err("nothing was sent");
    assert!(error.to_string().starts_with("cannot draw payload: it needs"), "{error}");
    assert!(!new_folder.exists(), "the folder would be empty");
    draw(Kind::Stacked, &runs, &Columns::default(), &new_folder.join("a")).expect("the folder is created");
    let file = new_folder.join("a/stacked.png");
    let error = draw(Kind::Stacked, &runs, &Columns::default(), &file).expect_err("a file is no folder");
    assert!(matches!(error, PlotError::Write(_)), "{error}");
}
