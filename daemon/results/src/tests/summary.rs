//! Tests of the text forms of summaries.

use peernet_analysis::accuracy::Accuracy;
use peernet_analysis::rows::Units;
use peernet_logger::{Measure, Unit};
use peernet_statistics::number::counted;
use peernet_stream::Outcome as StreamOutcome;

use super::*;
use crate::iterations::{add, iteration, offloaded, timer};
use crate::summary::{csv, latex, markdown, text};

#[test]
fn labels_outside_model_classes_are_reported() {
    let mut rows = rows(20);
    rows.iter_mut().for_each(|row| row.values.push(("unknown-label".into(), 1.0)));
    let facts = vec![("Classes".to_owned(), "4: good, dented".to_owned())];
    let summary = Summary::from_run(&RunRecord { facts, ..RunRecord::default() }, &to_rows(&rows));
    let (text, ok) = (text(&summary), summary.counts.ok);
    let sentence = format!(
        "Not scored: {ok} of {}, because the label is not a class of the model (classes: good, dented).",
        counted(ok, "iteration")
    );
    assert!(text.contains(&sentence) && !text.contains("unknown-label"), "{text}");
}

#[test]
fn sentences_have_skipped_starts_and_accuracy() {
    let mut rows = rows(20);
    for row in &mut rows {
        // A valid score is 0 or 1. Iteration 10 has no valid score and counts as not scored.
        let score = if row.iteration == 10 { 0.5 } else { f64::from(u8::from(row.iteration % 4 != 0)) };
        row.values.extend([("top-1".into(), score), ("skipped-starts".into(), 2.0)]);
    }
    let rows = to_rows(&rows);
    let summary = Summary::from_rows(&rows);
    let text = text(&summary);
    let starts = summary.starts;
    assert!(starts.started > summary.counts.ok && starts.skipped == 2 * starts.started, "{starts:?}");
    let sentence = format!("Skipped: {} of {} starts (67\u{202f}%).", starts.skipped, starts.total());
    assert!(text.contains(&sentence) && !text.contains("skipped-starts"), "{text}");
    let line = text.lines().find(|line| line.starts_with("Top-1: ")).expect("a sentence");
    let accuracy = Accuracy::from_rows(&rows, "top-1").expect("has scores");
    assert_eq!(line, format!("Top-1: {accuracy}."), "as in run.json");
    assert!(accuracy.unscored == 1 && !text.contains("top-1"), "{text}");
    assert!(csv(&summary).contains("\nskipped-starts,"), "summary.csv has all columns");
}

#[test]
fn missed_deadlines_are_share_of_all_iterations() {
    let mut rows = rows(20);
    for row in &mut rows {
        let is_late = row.outcome != Outcome::Ok || row.iteration % 4 == 0;
        row.values.push(("deadline-missed".into(), f64::from(u8::from(is_late))));
    }
    let measured: Vec<_> = rows.iter().filter(|row| !row.warm_up).collect();
    let missed = measured.iter().filter(|row| row.outcome != Outcome::Ok || row.iteration % 4 == 0).count();
    let record = RunRecord { deadline_s: Some(0.1), ..RunRecord::default() };
    let summary = Summary::from_run(&record, &to_rows(&rows));
    let text = text(&summary);
    let sentence =
        format!("Deadline of 100\u{202f}ms: missed by {missed} of {} iterations (", measured.len());
    assert!(text.contains(&sentence) && !text.contains("deadline-missed"), "{text}");
    let csv = csv(&summary);
    let line =
        csv.lines().find(|line| line.starts_with("deadline-missed,")).expect("summary.csv has all columns");
    let mean: f64 = line.split(',').nth(2).and_then(|cell| cell.parse().ok()).expect("a number");
    assert!(
        (mean - missed as f64 / measured.len() as f64).abs() < 1e-12,
        "the mean is the miss rate: {line}"
    );
}

#[test]
fn failed_iterations_are_counted_by_outcome() {
    let mut rows = rows(10);
    (rows[8].outcome, rows[9].outcome) = (Outcome::Failed, Outcome::Timeout);
    rows[0].outcome = Outcome::Failed;
    let text = text(&Summary::from_rows(&to_rows(&rows)));
    let sentence = "Iterations: 5 succeeded; 1 with an error of sensor, model or actuator; 1 lost; 1 timed out; \
                    2 warm-up, left out (1 of them failed).";
    assert!(text.contains(sentence), "{text}");
}

#[test]
fn episodes_are_reported_below_table() {
    let mut rows = rows(20);
    for row in &mut rows {
        // Some of these iterations are lost or warm-up, but their episodes count.
        if row.iteration % 2 == 0 {
            row.values.push(("episode-success".into(), 1.0));
            row.values.push(("episode-return".into(), row.iteration as f64));
        }
        row.values.push(("reward".into(), 0.5));
        row.values.push(("success".into(), 1.0));
    }
    rows[10].values.push(("superseded".into(), 1.0));
    let episodes = rows.iter().filter(|row| row.iteration % 2 == 0).count();
    let summary = Summary::from_rows(&to_rows(&rows));
    let text = text(&summary);
    assert!(text.contains(&format!("Success: 100.0 % of {episodes} episodes (95 % confidence: ")), "{text}");
    assert!(
        text.contains(&format!("over {episodes} episodes.")) && text.contains("Superseded: 1 of "),
        "{text}"
    );
    let has_row = |name: &str| text.lines().any(|line| line.split(' ').next() == Some(name));
    assert!(has_row("reward") && has_row("episode-return"), "{text}");
    assert!(!has_row("success") && !has_row("episode-success") && !has_row("superseded"), "{text}");
    let csv = csv(&summary);
    assert!(csv.contains(&format!("\nepisode-success,{episodes},1,")), "summary.csv has all columns: {csv}");
}

const TEXT: &str = "\
metric                 unit  count             mean ± std     median     clock bounds  p95  p99        max
Sensing Time           ms        7          0.700 ± 0.000      0.700                     —    —      0.700
Upload Size            B         7            150,000 ± 0    150,000                     —    —    150,000
Upload Latency         ms        7         17.007 ± 0.003     17.007  16.997 – 17.017    —    —     17.010
Upload Throughput      MB/s      7          100.00 ± 0.00     100.00        50.00 – ∞    —    —     100.00
Inference Latency      ms        7          3.700 ± 0.000      3.700                     —    —      3.700
Download Size          B         7                 40 ± 0         40                     —    —         40
Download Latency       ms        7          0.400 ± 0.000      0.400    0.390 – 0.410    —    —      0.400
Download Throughput    MB/s      7            0.50 ± 0.00       0.50         0.25 – ∞    —    —       0.50
Total (sum of stages)  ms        7         21.807 ± 0.003     21.807                     —    —     21.810
Total (measured)       ms        7         21.832 ± 0.003     21.832                     —    —     21.835
download-logger-bytes  B         7                130 ± 0        130                     —    —        130
upload-logger-bytes    B         7                120 ± 0        120                     —    —        120
capture                ms        7          0.500 ± 0.000      0.500                     —    —      0.500
transform              ms        7          0.150 ± 0.000      0.150                     —    —      0.150
unattributed           ms        7          0.025 ± 0.000      0.025                     —    —      0.025
inference_pre                    7  0.0000300 ± 0.0000000  0.0000300                     —    —  0.0000300

Iterations: 7 succeeded; 1 lost; 2 warm-up, left out.
Clock verdicts: upload 7 ok (in-band, ±0.010 ms); download 7 ok (in-band, ±0.010 ms).
Clock bounds contain the median of the true values.";

#[test]
fn summary_has_metrics_of_the_paper() {
    let record = RunRecord { title: "robot_1".to_owned(), ..RunRecord::default() };
    let summary = Summary::from_run(&record, &to_rows(&rows(10)));
    assert_eq!(text(&summary), TEXT);
    let markdown = markdown(&summary);
    assert!(markdown.starts_with("# robot_1\n\n| metric | unit | count | mean ± std |"), "{markdown}");
    assert!(markdown.contains(
        "| Upload Latency | ms | 7 | 17.007 ± 0.003 | 17.007 | 16.997 – 17.017 | — | — | 17.010 |"
    ));
    let latex = latex(&summary);
    assert!(
        latex.contains("Upload Latency & ms & 7 & 17.007 $\\pm$ 0.003 & 17.007 & 16.997 -- 17.017 &"),
        "{latex}"
    );
    assert!(latex.contains("\\caption{robot\\_1. Iterations: 7 succeeded;"), "{latex}");
    let csv = csv(&summary);
    let mut lines = csv.lines();
    assert_eq!(lines.next(), Some("column,count,mean,std,median,median-lo,median-hi,p95,p99,max"));
    let sensing: Vec<&str> = lines.next().expect("sensing").split(',').collect();
    assert_eq!((sensing[0], sensing[1], sensing[4], sensing[7]), ("sensing", "7", "0.0007", ""));
}

#[test]
fn short_mean_is_not_rounded_to_zero() {
    let mut rows = rows(10);
    for row in &mut rows {
        row.values.push(("queue".into(), 2e-7));
        row.values.push(("restart".into(), 0.0));
    }
    let text = text(&Summary::from_rows(&to_rows(&rows)));
    // Returns the mean and the median.
    let cells = |metric: &str| {
        let line =
            text.lines().find(|line| line.starts_with(metric)).unwrap_or_else(|| panic!("{metric}: {text}"));
        let cells: Vec<&str> = line[metric.len()..].split_whitespace().collect();
        [cells[2], cells[5]].map(str::to_owned)
    };
    assert_eq!(cells("queue"), ["<0.001", "<0.001"]);
    assert_eq!(cells("Restart of the model's process"), ["0", "0"]);
}

#[test]
fn columns_of_standard_nodes_are_durations() {
    let values =
        [("ipc", 0.001), ("capture_capture-ipc", 0.002), ("mine_capture-ipc_2", 0.003), ("mine", 4.0)];
    // One iteration that is neither warm-up nor lost.
    let mut rows = rows(9).split_off(8);
    rows[0].values = values.map(|(name, value)| (name.into(), value)).to_vec();
    let text = text(&Summary::from_rows(&to_rows(&rows)));
    // Returns the cells after the name of the metric: the unit if it is known, and the numbers.
    let cells = |metric: &str| {
        let line =
            text.lines().find(|line| line.starts_with(metric)).unwrap_or_else(|| panic!("{metric}: {text}"));
        line[metric.len()..].split_whitespace().map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(cells("IPC with the model's process")[..3], ["ms", "1", "1.00"]);
    assert_eq!(cells("IPC with the sensor's process")[..3], ["ms", "1", "2.00"]);
    assert_eq!(
        cells("mine_capture-ipc_2")[..2],
        ["1", "0.00300"],
        "the unit of a custom node below a custom node is unknown"
    );
    assert_eq!(cells("mine ")[..2], ["1", "4.00"], "the unit of a custom node is unknown");
}

#[test]
fn custom_nodes_keep_their_unit() {
    let logged = |number: u64, mixed: Unit| {
        let mut tree = offloaded(17_000, 3_700);
        let value = |value: f64, unit: Unit| Measure::Value(value, unit);
        add(&mut tree, &[], "grip", timer(250_000));
        add(&mut tree, &["grip"], "close", timer(100_000));
        add(&mut tree, &[], "cloud-points", value(1_200.0, Unit::BYTES));
        add(&mut tree, &[], "camera", value(8e8, Unit::BITS_PER_SECOND));
        add(&mut tree, &[], "force", value(9.81, Unit::new("N")));
        add(&mut tree, &[], "tries", value(3.0, Unit::NONE));
        add(&mut tree, &[], "mixed", value(5.0, mixed));
        iteration(number, StreamOutcome::Ok, tree)
    };
    let mut units = Units::default();
    let iterations = [logged(3, Unit::WATTS), logged(4, Unit::JOULES)];
    let rows: Vec<Row> = iterations.iter().map(|iteration| units.row(iteration)).collect();
    assert_eq!(rows, iterations.each_ref().map(Row::from_iteration), "the units do not change the rows");
    let record = RunRecord { units, ..RunRecord::default() };
    let json = serde_json::to_value(&record).expect("JSON");
    assert_eq!((&json["units"]["grip_val"], &json["units"]["force"]), (&"s".into(), &"N".into()));
    let text = text(&Summary::from_run(&record, &to_rows(&rows)));
    // Returns the first cells of a metric's line: name, unit if it is known, and numbers.
    let cells = |metric: &str| {
        let line =
            text.lines().find(|line| line.starts_with(metric)).unwrap_or_else(|| panic!("{metric}: {text}"));
        line.split_whitespace().take(4).map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(cells("grip_val"), ["grip_val", "ms", "2", "250.000"]);
    assert_eq!(cells("grip_close"), ["grip_close", "ms", "2", "100.000"]);
    assert_eq!(cells("inference_pre"), ["inference_pre", "ms", "2", "0.030"]);
    assert_eq!(cells("cloud-points"), ["cloud-points", "B", "2", "1,200"]);
    assert_eq!(cells("camera"), ["camera", "MB/s", "2", "100.00"]);
    assert_eq!(cells("force"), ["force", "N", "2", "9.81"]);
    assert_eq!(cells("tries"), ["tries", "2", "3.00", "±"]);
    assert_eq!(cells("mixed"), ["mixed", "2", "5.00", "±"], "watts and joules have no common unit");
}

#[test]
fn replayed_latencies_are_named_below_every_table() {
    let rows = to_rows(&rows(20));
    let facts = vec![("Replayed".to_owned(), "inference is drawn from x".to_owned())];
    let record = RunRecord { facts, ..RunRecord::default() };
    let note = "Replayed latencies, not measured: inference is drawn from x.";
    let replayed = Summary::from_run(&record, &rows);
    let measured = Summary::from_run(&RunRecord::default(), &rows);
    for form in [text, markdown, latex] {
        assert!(form(&replayed).contains(note), "{}", form(&replayed));
        assert!(!form(&measured).contains("eplayed"), "{}", form(&measured));
    }
}
