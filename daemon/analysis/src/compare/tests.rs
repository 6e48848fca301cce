//! Comparisons of made-up runs whose latencies are known.

use std::path::PathBuf;

use peernet_stream::ExperimentPosition;

use super::*;
use crate::record::{HostRecord, ModelRecord, Placement, RunRecord};
use crate::rows::{Outcome, Row, RowRef};

mod defects;
mod names;
mod qualities;

/// Returns a run in which every stage takes the given time, in milliseconds, to within a microsecond, and the total
/// takes 1 ms more than the stages together. A stage of which the time is `None` did not take place.
fn run(folder: &str, [sensing, upload, inference, download]: [Option<f64>; 4]) -> Loaded {
    let row = |number: u64| {
        let about = |millis: f64| millis / 1e3 + if number.is_multiple_of(2) { 1e-6 } else { -1e-6 };
        let stages =
            [("sensing", sensing), ("upload", upload), ("inference", inference), ("download", download)];
        let mut values: Vec<_> =
            stages.into_iter().filter_map(|(name, millis)| Some((name.into(), about(millis?)))).collect();
        let sum: f64 = values.iter().map(|(_, value)| value).sum();
        values.extend([("stages-total".into(), sum), ("total".into(), sum + 1e-3)]);
        Row {
            iteration: number,
            at: number as f64,
            episode: 0,
            step: 0,
            warm_up: number <= 5,
            outcome: if number == 10 { Outcome::Lost } else { Outcome::Ok },
            reason: None,
            values,
            upload: None,
            download: None,
        }
    };
    let record = RunRecord { title: folder.to_owned(), name: folder.to_owned(), ..RunRecord::default() };
    Loaded { folder: PathBuf::from("results").join(folder), record, rows: (1..=106).map(row).collect() }
}

fn with_model(model: &str, device: &str, network: Option<&str>, run: Loaded) -> Loaded {
    let record = RunRecord {
        model: Some(ModelRecord { name: model.to_owned(), device: Some(device.to_owned()), sha256: None }),
        placement: Placement {
            kind: if network.is_some() { "remote" } else { "local" }.to_owned(),
            network: network.map(str::to_owned),
            address: None,
        },
        edge: HostRecord { name: "robot".to_owned(), ..HostRecord::default() },
        facts: vec![("Load".to_owned(), "closed".to_owned()), ("Model".to_owned(), model.to_owned())],
        ..run.record
    };
    Loaded { record, ..run }
}

/// Gives a run its position in an experiment: labels of axes, and a repeat.
fn with_position(pairs: &[(&str, &str)], repeat: u32, run: Loaded) -> Loaded {
    let configuration = pairs.iter().map(|(axis, label)| ((*axis).to_owned(), (*label).to_owned())).collect();
    let position = ExperimentPosition {
        name: "teleoperation".to_owned(),
        id: "a1".to_owned(),
        configuration,
        repeat,
        ..ExperimentPosition::default()
    };
    Loaded { record: RunRecord { experiment: Some(position), ..run.record }, ..run }
}

/// Returns runs with the latencies in the first lines of the paper's table.
pub(super) fn paper() -> Vec<Loaded> {
    vec![
        with_model("policy", "orin", None, run("local", [Some(0.71), None, Some(18.55), None])),
        with_model(
            "policy",
            "cuda:0",
            Some("lan"),
            run("lan", [Some(0.76), Some(17.53), Some(3.73), Some(0.37)]),
        ),
        with_model(
            "policy",
            "cuda:0",
            Some("can"),
            run("can", [Some(0.81), Some(98.28), Some(3.73), Some(1.73)]),
        ),
    ]
}

#[test]
fn comparison_gives_table_of_paper() {
    let comparison = Comparison::new(&paper());
    assert_eq!(
        comparison.text(),
        "\
device  network  count  failed        sensing          upload       inference       download   total (stages)  total (measured)
orin    —          100       1  0.710 ± 0.001               —  18.550 ± 0.001              —   19.260 ± 0.002    20.260 ± 0.002 *
cuda:0  lan        100       1  0.760 ± 0.001  17.530 ± 0.001   3.730 ± 0.001  0.370 ± 0.001   22.390 ± 0.004    23.390 ± 0.004
cuda:0  can        100       1  0.810 ± 0.001  98.280 ± 0.001   3.730 ± 0.001  1.730 ± 0.001  104.550 ± 0.004   105.550 ± 0.004

*: smallest mean total.
Latencies: mean ± standard deviation in ms over all successful iterations after the warm-up. Total (stages) is the sum of all stages, including stages without a column; the paper calls it Total.
Failed: iterations after the warm-up without an answer, or with an answer that the actuator failed to act on.
Smallest mean total (measured): orin; every other line differs from it with 95 % confidence.
The runs also differ in where: local (orin), cloud (cuda:0)."
    );
}

#[test]
fn stages_without_column_are_listed_below_table() {
    let mut runs = paper();
    runs[1].rows.change(|row| {
        row.values.push(("preprocessing".into(), 0.005));
        // Such a short stage is not listed.
        row.values.push(("queue".into(), 1e-6));
        let total = row.values.iter_mut().find(|(name, _)| name == "stages-total").expect("a sum");
        total.1 += 0.005;
    });
    let text = Comparison::new(&runs).text();
    assert!(
        text.contains(
            "\nStages without a column, means per iteration in ms: cuda:0, lan: preprocessing 5.00.\n"
        ),
        "{text}"
    );
}

#[test]
fn short_mean_is_not_rounded_to_zero() {
    let mut runs = paper();
    let short = run("local", [Some(0.000_2), None, Some(18.55), None]);
    runs[0] = with_model("policy", "orin", None, short);
    let comparison = Comparison::new(&runs);
    assert!(comparison.text().contains(" <0.001 ± 0.001  "), "{}", comparison.text());
    assert!(comparison.markdown().contains("| \\<0.001 ± 0.001 |"), "{}", comparison.markdown());
    assert!(comparison.latex().contains("& $<$0.001 $\\pm$ 0.001 &"), "{}", comparison.latex());
    let differences = Differences::between_lines(&comparison, &runs, 0, 1, 5).captioned().table;
    assert_eq!((&*differences.rows[0][0], &*differences.rows[0][1]), ("sensing", "<0.001"));
}

#[test]
fn every_format_has_every_line() {
    let comparison = Comparison::new(&paper());
    let markdown = comparison.markdown();
    assert!(markdown.starts_with("| device | network | count | failed | sensing |"), "{markdown}");
    assert!(markdown.contains("| orin | — | 100 |"), "{markdown}");
    assert!(markdown.contains(" | 19.260 ± 0.002 | **20.260 ± 0.002** |\n"), "{markdown}");
    assert!(markdown.contains("\nBold: smallest mean total.\n"), "{markdown}");
    let latex = comparison.latex();
    assert!(latex.contains("cuda:0 & can & 100 & 1 & 0.810 $\\pm$ 0.001 & 98.280 $\\pm$ 0.001 &"), "{latex}");
    assert!(latex.contains("\\begin{tabular}{llrrrrrrrr}") && latex.contains("95 \\% confidence"), "{latex}");
    assert_eq!(latex.matches("\\textbf").count(), 1, "{latex}");
    assert!(latex.contains("& \\textbf{20.260 $\\pm$ 0.002} \\\\"), "{latex}");
    let csv = comparison.csv();
    assert_eq!(csv.lines().count(), 4);
    assert!(
        csv.starts_with("device,network,runs,count,unanswered,best,tie,sensing-mean,sensing-std,"),
        "{csv}"
    );
    assert!(csv.lines().nth(1).is_some_and(|line| line.starts_with("orin,,1,100,1,1,0,0.0007")), "{csv}");
}

#[test]
fn only_repeats_are_pooled() {
    let lan = |folder: &str, inference: f64| run(folder, [Some(1.0), Some(5.0), Some(inference), Some(0.5)]);
    let runs = [
        with_position(&[("resize", "no"), ("network", "LAN")], 0, lan("a", 10.0)),
        with_position(&[("resize", "yes"), ("network", "LAN")], 0, lan("b", 4.0)),
        with_position(&[("resize", "no"), ("network", "LAN")], 1, lan("c", 12.0)),
    ];
    let comparison = Comparison::new(&runs);
    assert_eq!(
        comparison.axes,
        ["resize", "network"],
        "all declared axes, although all runs have the same network"
    );
    assert_eq!(
        comparison.lines.iter().map(|line| line.runs.clone()).collect::<Vec<_>>(),
        [vec![0, 2], vec![1]]
    );
    let inference = comparison.lines[0].latency("inference").expect("measured");
    assert!((inference.mean - 0.011).abs() < 1e-9 && inference.count == 200, "{inference:?}");
    assert_eq!((comparison.best, comparison.ties.as_slice()), (Some(1), [].as_slice()));
    let text = comparison.text();
    assert!(text.contains("Repeats are pooled; their mean totals: no resize: 17.5 – 19.5 ms."), "{text}");
    let separate = Comparison::with_repeats(&runs, Repeats::Separate);
    assert_eq!(separate.axes, ["resize", "network", "repeat"]);
    assert_eq!(separate.lines.len(), 3);
}

#[test]
fn equal_configurations_are_distinguished_by_folder() {
    let run_in = |folder: &str, inference: f64| {
        with_model("s", "cpu", None, run(folder, [Some(1.0), None, Some(inference), None]))
    };
    let comparison = Comparison::new(&[run_in("before/run-2", 7.0), run_in("after/run-2", 7.0)]);
    assert_eq!(comparison.axes, ["run"]);
    assert_eq!(
        comparison.lines.iter().map(|line| line.name.as_str()).collect::<Vec<_>>(),
        ["before/run-2", "after/run-2"]
    );
    assert_eq!(
        (comparison.best, comparison.ties.as_slice()),
        (Some(0), [1].as_slice()),
        "two equal runs are a tie"
    );
    assert!(comparison.text().contains("cannot be distinguished from after/run-2"), "{}", comparison.text());
    let alone = Comparison::new(&[run_in("x", 7.0)]);
    assert_eq!((alone.axes.as_slice(), alone.best), (["run".to_owned()].as_slice(), None));
}

#[test]
fn executions_of_one_experiment_are_distinguished() {
    let mut runs =
        [0, 1].map(|_| with_position(&[("model", "s")], 0, run("a", [Some(1.0), None, Some(2.0), None])));
    runs[1].record.experiment.as_mut().expect("a position").id = "b2".to_owned();
    let comparison = Comparison::new(&runs);
    assert_eq!(comparison.axes, ["model", "execution"]);
    assert_eq!(comparison.lines.iter().map(|line| line.name.as_str()).collect::<Vec<_>>(), ["a1", "b2"]);
}

#[test]
fn sum_of_stages_ranks_runs_without_total() {
    let mut runs = paper();
    for run in &mut runs {
        run.rows.change(|row| row.values.retain(|(name, _)| name != "total"));
    }
    let comparison = Comparison::new(&runs);
    assert_eq!((comparison.total_column.name(), comparison.best), ("stages-total", Some(0)));
    assert!(comparison.lines[0].latency("total").is_none());
    assert!(comparison.text().contains("Smallest mean total (stages): orin;"));
}

#[test]
fn failed_run_is_never_the_best() {
    let mut runs = paper();
    runs[0].rows.change(|row| row.outcome = Outcome::Lost);
    let comparison = Comparison::new(&runs);
    assert_eq!((comparison.best, comparison.lines[0].count, comparison.lines[0].failed), (Some(1), 0, 101));
}

#[test]
fn differences_are_computed_per_stage() {
    let runs = paper();
    let comparison = Comparison::new(&runs);
    let seed = 5;
    let between = |baseline, other| Differences::between_lines(&comparison, &runs, baseline, other, seed);
    let differences = between(1, 2);
    let stages: Vec<&str> = differences.stages.iter().map(|stage| stage.stage.as_str()).collect();
    assert_eq!(stages, ["sensing", "upload", "inference", "download", "stages-total", "total"]);
    let upload = &differences.stages[1];
    assert!((upload.mean_difference.value - 0.08075).abs() < 1e-9, "{upload:?}");
    let is_distinct = (upload.mean_difference.is_distinct(), upload.median_difference.is_distinct());
    assert_eq!(is_distinct, (Some(true), Some(true)));
    assert_eq!(
        differences.stages[2].mean_difference.is_distinct(),
        Some(false),
        "inference takes the same time in both runs"
    );
    let text = differences.captioned().text();
    assert!(text.starts_with("A: cuda:0, lan. B: cuda:0, can.\n\nstage"), "{text}");
    assert!(text.contains("+80.750"), "{text}");
    assert_eq!(differences, between(1, 2), "the same seed gives the same intervals");
    let csv = Differences::csv(&[differences]);
    let upload = "\"cuda:0, lan\",\"cuda:0, can\",upload,0.0175";
    assert!(csv.lines().nth(2).is_some_and(|line| line.starts_with(upload)), "{csv}");
    let local = between(1, 0);
    assert_eq!((local.baseline.as_str(), local.other.as_str()), ("cuda:0, lan", "orin"));
    assert!(local.stages.iter().all(|stage| stage.stage != "upload"), "a run on board has no upload");
}

#[test]
fn difference_columns_have_equal_decimals() {
    let difference =
        |value: f64, half: f64| Difference { value, interval: Some((value - half, value + half)) };
    let stage = |stage: &str, value: f64, half: f64| StageDifference {
        stage: stage.to_owned(),
        means: (value, 2.0 * value),
        mean_difference: difference(value, half),
        medians: (value, 2.0 * value),
        median_difference: difference(value, 0.0),
        clock_error: Some(half),
    };
    let stages = vec![stage("upload", 0.012_3, 0.002), stage("download", 0.000_34, 0.000_004)];
    let differences = Differences { baseline: "a".to_owned(), other: "b".to_owned(), stages };
    let table = differences.captioned().table;
    let decimals =
        |cell: &String| cell.split('.').nth(1).map_or(0, |end| end.split(' ').next().unwrap_or("").len());
    for column in 1..table.header.len() {
        let [up, down] = [0, 1].map(|row| &table.rows[row][column]);
        assert_eq!(decimals(up), decimals(down), "{up} and {down}");
    }
    assert_eq!(table.rows[0][8], "+12.300", "an interval without width is one number");
}

#[test]
fn chosen_repeat_has_separate_line() {
    let repeat_run = |load: &str, repeat| {
        with_position(&[("load", load)], repeat, run("r", [Some(1.0), None, Some(2.0), None]))
    };
    let runs =
        [repeat_run("a", 0), repeat_run("a", 1), repeat_run("a", 2), repeat_run("b", 0), repeat_run("b", 1)];
    // The number is the index of the run whose repeat is chosen.
    let comparison = Comparison::with_repeats(&runs, Repeats::PooledExcept(&[1]));
    let lines: Vec<_> = comparison.lines.iter().map(|line| (line.name.clone(), line.runs.clone())).collect();
    let expected = [("a, the other repeats", vec![0, 2]), ("a, repeat 2", vec![1]), ("b", vec![3, 4])];
    assert_eq!(lines, expected.map(|(name, runs)| (name.to_owned(), runs)));
    let edges = [edge("user-1", 0, "1/user-1"), edge("user-2", 0, "1/user-2"), edge("user-1", 1, "2/user-1")];
    let comparison = Comparison::with_repeats(&edges, Repeats::PooledExcept(&[0]));
    assert_eq!(comparison.lines[0].runs, [0, 1], "edges that measured at the same time stay in one line");
}

/// Returns a run as a published `data.csv` describes it: only the name of the file is known.
fn published(file: &str, run: Loaded) -> Loaded {
    let record = RunRecord { name: file.to_owned(), title: file.to_owned(), ..RunRecord::default() };
    Loaded { folder: PathBuf::from("results"), record, ..run }
}

#[test]
fn runs_without_record_are_named_after_files() {
    let stages = [Some(1.0), None, Some(2.0), None];
    let faster = [Some(1.0), None, Some(1.0), None];
    let runs = [with_model("s", "cpu", None, run("mine", stages)), published("theirs", run("x", faster))];
    let comparison = Comparison::new(&runs);
    assert_eq!(comparison.axes[0], "run");
    assert!(comparison.lines.iter().all(|line| line.labels[0] != "—"), "{}", comparison.text());
    assert_eq!(comparison.lines[1].name, "theirs");
    assert!(comparison.text().contains(": theirs; the other line differs"), "{}", comparison.text());
    let alone = Comparison::new(&[published("theirs", run("x", stages))]);
    assert_eq!((alone.axes[0].as_str(), alone.lines[0].name.as_str()), ("run", "theirs"));
}

#[test]
fn untested_line_is_reported() {
    let mut runs = paper();
    runs[1].rows = runs[1].rows.iter().take(30).map(RowRef::to_row).collect();
    let comparison = Comparison::new(&runs);
    assert_eq!((comparison.ties.as_slice(), comparison.untested.as_slice()), ([].as_slice(), [1].as_slice()));
    let text = comparison.text();
    assert!(
        text.contains(": orin; too few iterations to tell whether it differs from cuda:0, lan (30 of each run are needed)."),
        "{text}"
    );
    assert!(!text.contains("cannot be distinguished") && !text.contains("other line differs"), "{text}");
    let mut several = comparison.clone();
    several.lines[1].edges = 2;
    assert!(several.text().contains("(30 of each edge in each run are needed)"), "{}", several.text());
    assert!(comparison.csv().lines().nth(2).is_some_and(|line| line.starts_with("cuda:0,lan,1,24,1,0,,")));
}

/// Returns the results of one edge of a repeat.
fn edge(name: &str, repeat: u32, folder: &str) -> Loaded {
    let run = with_position(&[], repeat, run(folder, [Some(1.0), Some(2.0), Some(3.0), Some(1.0)]));
    let edge = HostRecord { name: name.to_owned(), ..HostRecord::default() };
    // Format 0 would be that of results without a run.json.
    Loaded { record: RunRecord { edge, format: 1, ..run.record }, ..run }
}

#[test]
fn edges_of_one_run_are_not_repeats() {
    let mut runs = vec![edge("user-1", 0, "e/runs/1/user-1"), edge("user-2", 0, "e/runs/1/user-2")];
    let pooled = Comparison::new(&runs);
    assert_eq!((pooled.lines.len(), pooled.lines[0].repeats, pooled.lines[0].edges), (1, 1, 2));
    let text = pooled.text();
    assert!(text.contains("edges") && !text.contains("Repeats are"), "{text}");
    assert!(text.contains("2 edges."), "{text}");

    // The edges also share one line if other runs are compared with the edges.
    runs.extend([edge("user-1", 1, "e/runs/2/user-1"), edge("user-2", 1, "e/runs/2/user-2")]);
    runs.push(with_model("s", "cpu", None, run("alone", [Some(1.0), None, Some(2.0), None])));
    let mixed = Comparison::new(&runs);
    assert_eq!(
        mixed.lines.iter().map(|line| line.runs.clone()).collect::<Vec<_>>(),
        [vec![0, 1, 2, 3], vec![4]]
    );
    assert_eq!((mixed.lines[0].repeats, mixed.lines[0].edges), (2, 2));
    assert!(mixed.lines.iter().all(|line| !line.name.is_empty()), "{}", mixed.text());
}

#[test]
fn dissimilar_runs_have_fewest_distinguishing_columns() {
    let hash = |digit: &str| ("Model SHA-256".to_owned(), digit.repeat(64));
    let with = |model: &str, device: &str, network: Option<&str>, facts: [(String, String); 2]| {
        let run = with_model(model, device, network, run(model, [Some(1.0), None, Some(2.0), None]));
        Loaded { record: RunRecord { facts: facts.to_vec(), ..run.record }, ..run }
    };
    let library = |folder: &str| ("ONNX Runtime".to_owned(), format!("/opt/{folder}/libonnxruntime.so"));
    let runs = [
        with("s", "cpu", None, [hash("a"), library("a")]),
        with("m", "cuda:0", Some("lan"), [hash("b"), library("b")]),
        with("l", "cuda:0", Some("lan"), [hash("c"), library("c")]),
    ];
    let comparison = Comparison::new(&runs);
    assert_eq!(comparison.axes, ["model"]);
    assert_eq!(
        comparison.other_differences,
        [
            "The runs also differ in device: cpu (s), cuda:0 (m; l); where: local (s), cloud (m; l); network: lan (m; l).",
            "Further differences, recorded in the run.json of each run: Model SHA-256, ONNX Runtime.",
        ]
    );
    for text in [comparison.text(), comparison.markdown(), comparison.latex(), comparison.csv()] {
        assert!(!text.contains("aaaa") && !text.contains("/opt"), "{text}");
    }
    // Only a hash and a long list distinguish these runs, so the names of the folders are used.
    let similar_runs = ["a", "b"].map(|at| {
        let list = ("Model libraries".to_owned(), format!("{}six 1.{at}", "numpy 1.24.2, ".repeat(9)));
        let run = with("s", "cpu", None, [hash(at), list]);
        let record = RunRecord { format: 1, ..run.record };
        Loaded { folder: PathBuf::from("results").join(at), record, ..run }
    });
    let comparison = Comparison::new(&similar_runs);
    assert_eq!(
        (comparison.axes.as_slice(), comparison.lines[1].name.as_str()),
        (["run".to_owned()].as_slice(), "b")
    );
}
