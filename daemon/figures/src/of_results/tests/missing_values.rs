//! Tests of figures of runs in which values are missing.

use peernet_clock::{OneWayDelay, Span};

use super::*;

#[test]
fn accuracy_figure_notes_unknown_labels() {
    // Returns a run in which the model does not know the labels of all iterations after `last_known`.
    let run_with_labels = |last_known: u64| {
        let mut run = Loaded { record: placed("s", "local", 1.0).record, ..run_with_total(20.0) };
        run.rows.change(|row| {
            if row.iteration > last_known && row.outcome == Outcome::Ok {
                row.values.retain(|(name, _)| name != "top-1");
                row.values.push(("unknown-label".into(), 1.0));
            }
        });
        let facts = [("Labels", "9 of 9: cat, dog"), ("Classes", "4: good, dented")];
        run.record.facts = facts.map(|(name, value)| (name.to_owned(), value.to_owned())).into();
        run
    };
    let reason = "because the label is not a class of the model (labels: cat, dog; classes: good, dented)";
    let drawings = accuracy::drawings(&[run_with_labels(90)]).expect("some are scored");
    let AnyFigure::QualityAgainstLatency(figure) = &drawings[0].figure else { panic!("points") };
    assert_eq!(figure.notes[2..], [format!("not scored: 10 iterations, {reason}")]);
    let missing = accuracy::drawings(&[run_with_labels(0)]).expect_err("nothing is scored");
    assert!(
        missing
            .to_string()
            .ends_with(&format!("has a top-1, map-50 or mean-iou; 94 iterations cannot have one, {reason}")),
        "{missing}"
    );
}

#[test]
fn scored_configuration_without_latency_is_noted_as_such() {
    let scored = |model: &str, total: &'static [(&'static str, f64)]| {
        let run = run(100, |_| [total, &[("top-1", 1.0)]].concat());
        Loaded { record: placed(model, "local", 1.0).record, ..run }
    };
    let without_latency = scored("m", &[]);
    let runs = [scored("s", &[("total", 20.0)]), without_latency.clone()];
    let drawings = accuracy::drawings(&runs).expect("one configuration has both");
    assert_eq!(drawings[0].left_out, ["left out: 1 configuration without a latency that can be drawn"]);
    assert_eq!(accuracy::drawings(&[without_latency]), Err(MissingData::Total));
}

#[test]
fn unknown_delays_count_as_mean_of_known_ones() {
    let unknown = OneWayDelay::unsynchronised(Span::from_millis(3));
    let mut run = run(105, |_| vec![("sensing", 1.0), ("upload", 10.0), ("total", 11.0)]);
    run.rows.change(|row| {
        if row.iteration > 55 {
            row.values.retain(|(name, _)| name != "upload");
            row.upload = Some(unknown);
        }
    });
    let drawings = stacked::drawings(&[run, failed()]).expect("there are bars");
    let AnyFigure::Stacked(figure) = &drawings[0].figure else { panic!("bars") };
    assert_eq!(figure.stages, ["sensing", "upload"]);
    let shown: Vec<f64> = figure.bars[0].means.iter().map(|mean| (mean * 1e6).round()).collect();
    assert_eq!((figure.bars.len(), shown), (1, vec![1_000.0, 10_000.0]));
    assert!((figure.bars[0].total - 11e-3).abs() < 1e-9, "{figure:?}");
    assert_eq!(
        drawings[0].left_out,
        ["left out: 1 configuration without a successful iteration after the warm-up"]
    );
    let expected_notes = [
        "n = 99 · left out: 10 warm-up, 16 failed",
        "unknown delays count as the mean of the known ones: 50 of upload",
        "left out: 1 configuration without a successful iteration after the warm-up",
    ];
    assert_eq!(figure.notes[1..], expected_notes);
}

#[test]
fn negative_delays_are_noted() {
    let run = run(105, |number| vec![("sensing", -1.0), ("upload", if number > 100 { -1.0 } else { 1.0 })]);
    let notes = |column: &str| {
        let drawings = histograms::drawings(&run, Some(column)).expect("there are values");
        let AnyFigure::Histogram(figure) = &drawings[0].figure else { panic!("bars") };
        figure.notes[1..].to_vec()
    };
    assert_eq!(notes("upload"), ["below zero because of the clocks' error: 5"]);
    assert_eq!(notes("sensing"), [""; 0], "a time that one clock measured gets no note on clocks");
}

/// Returns a run in which every iteration failed.
fn failed() -> Loaded {
    let mut failed = run(20, |_| vec![("sensing", 1.0)]);
    failed.rows.change(|row| row.outcome = Outcome::Failed);
    failed.record.name = "q".to_owned();
    failed.folder = "others".into();
    failed
}
