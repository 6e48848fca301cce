//! Tests of the notes on data that are in no figure.

use super::*;
use peernet_analysis::record::HostRecord;

/// Returns a run with uploads of two sizes.
fn with_two_upload_sizes(count: u64) -> Loaded {
    run(count, |number| {
        let bytes = [1e3, 1e5][number as usize % 2];
        vec![
            ("upload-bytes", bytes),
            ("upload", 0.2 + bytes / 1e5),
            ("download-bytes", 9.0 + number as f64 / 1e3),
        ]
    })
}

#[test]
fn omitted_direction_is_noted_with_sizes() {
    let folder = tempfile::tempdir().expect("a folder");
    let similar_uploads = run(60, |number| {
        let answer = [100.0, 9e4][number as usize % 2];
        vec![
            ("upload-bytes", 98e3 + number as f64 * 1e3),
            ("upload", 1.0),
            ("download-bytes", answer),
            ("download", 0.1 + answer / 1e6),
        ]
    });
    let drawn =
        draw(Kind::Payload, &[similar_uploads], &Columns::default(), folder.path()).expect("downloads vary");
    // The sizes of the uploads are merged, so the smallest size in the note is above 104 kB, the
    // smallest upload after the warm-up.
    let expected_note = "payload-latency: not drawn: upload of 106 kB to 158 kB, because the largest size must be at least twice the smallest";
    assert_eq!(drawn.left_out, [expected_note], "the note stands once for both figures");
    let caption =
        std::fs::read_to_string(folder.path().join("payload-throughput-caption.txt")).expect("read");
    assert!(caption.contains("not drawn: upload"), "{caption}");
}

#[test]
fn unknown_and_non_positive_delays_are_noted() {
    let mut run = run(100, |number| {
        let bytes = [1e3, 1e4, 1e5, 1e6][number as usize % 4];
        vec![("upload-bytes", bytes), ("upload", if bytes < 2e3 { -0.1 } else { bytes / 1e5 })]
    });
    run.rows.change(|row| {
        if row.iteration > 95 {
            row.values.retain(|(name, _)| name != "upload");
        }
    });
    let drawings = payload::drawings(&[run]).expect("sizes differ");
    for drawing in &drawings {
        let AnyFigure::Scaling(figure) = &drawing.figure else { panic!("points") };
        for expected_note in [
            "left out: 5 messages of upload without a known delay",
            "not drawn: 1 size of upload whose median delay is not above zero",
        ] {
            assert!(figure.notes.iter().any(|note| note == expected_note), "{:?}", figure.notes);
        }
    }
}

#[test]
fn link_without_figure_is_noted_in_first_figure() {
    let mut other = remote(60);
    other.rows.change(|row| row.values.push(("upload-bytes".into(), 500.0)));
    other.record.edge = HostRecord { name: "arm".to_owned(), ..HostRecord::default() };
    let drawings =
        payload::drawings(&[with_two_upload_sizes(60), other]).expect("uploads of one link have two sizes");
    assert_eq!(drawings.len(), 2);
    let expected_note =
        "not drawn: upload of 500 B, because the largest size must be at least twice the smallest · arm";
    // The downloads of the first run have sizes, but no delays.
    let no_download = "not drawn: 54 messages of download, because no delay is known";
    assert_eq!(drawings[0].left_out, [no_download, expected_note]);
}

#[test]
fn run_without_inference_is_noted_in_paired_figure() {
    let mut without_inference = placed("s", "remote", 1.0);
    without_inference.rows.change(|row| row.values.retain(|(name, _)| name != "inference"));
    let runs = [
        placed("s", "remote", 4.0),
        placed("s", "local", 20.0),
        placed("m", "local", 9.0),
        without_inference,
    ];
    let drawings = paired::drawings(&runs, None).expect("a pair");
    let expected_notes = ["left out, at one placement only: m", "left out: 1 run without inference"];
    assert_eq!(drawings[0].left_out, expected_notes);
    let AnyFigure::Paired(figure) = &drawings[0].figure else { panic!("pairs") };
    assert_eq!(figure.notes[1..], expected_notes);
}

#[test]
fn stages_that_are_not_drawn_are_noted() {
    let run = run(60, |_| {
        let long_stages = [("sensing", 5.0), ("upload", 4.0), ("inference", 3.0), ("download", 2.0)];
        let other_columns = [("queue", 1.0), ("encode", 0.5), ("preprocessing", 0.0), ("total", 16.0)];
        [long_stages, other_columns].concat()
    });
    let drawings = series::drawings(&run.record, &run.rows).expect("there is a total");
    let AnyFigure::TimeSeries(time_series) = &drawings[0].figure else { panic!("a time series") };
    assert_eq!(time_series.notes[1..], ["shorter stages, not drawn: encode, queue"]);
}

#[test]
fn different_counts_of_bars_are_noted_as_range() {
    let mut few = placed("s", "local", 20.0);
    few.rows.change(|row| row.warm_up = row.iteration > 10);
    let drawings = stacked::drawings(&[few, placed("s", "remote", 4.0)]).expect("bars");
    let AnyFigure::Stacked(figure) = &drawings[0].figure else { panic!("bars") };
    assert!(figure.notes[1].starts_with("n = 53 (9 to 44 each) · "), "{:?}", figure.notes);
}

#[test]
fn configurations_beyond_maximum_are_noted_not_counted() {
    let models: Vec<String> = (0..101).map(|number| format!("m{number}")).collect();
    let runs: Vec<Loaded> = models.iter().map(|model| placed(model, "local", 20.0)).collect();
    let drawings = stacked::drawings(&runs).expect("bars");
    let AnyFigure::Stacked(figure) = &drawings[0].figure else { panic!("bars") };
    assert_eq!(figure.bars.len(), 100);
    assert!(figure.notes[1].starts_with("n = 4,400 (44 each) · left out: "), "{:?}", figure.notes);
    assert_eq!(drawings[0].left_out, ["shown: the first 100 of 101 configurations"]);
}

#[test]
fn notes_on_accuracy_ignore_configurations_beyond_maximum() {
    let labelled = |model: &str| {
        let record = placed(model, "local", 1.0).record;
        Loaded { record, ..run_with_total(20.0) }
    };
    let mut runs: Vec<Loaded> = (0..25).map(|number| labelled(&format!("m{number}"))).collect();
    // The last configuration has numbers that are too large and labels that the model does not know.
    runs[24].rows.change(|row| {
        if row.iteration > 90 {
            row.values.retain(|(name, _)| name != "total" && name != "top-1");
            row.values.extend([("total".into(), 1e20), ("unknown-label".into(), 1.0)]);
        }
    });
    let drawings = accuracy::drawings(&runs).expect("there are labels");
    let AnyFigure::QualityAgainstLatency(figure) = &drawings[0].figure else { panic!("points") };
    assert_eq!(figure.points.len(), 24);
    let shown = "shown: the first 24 of 25 configurations";
    assert_eq!(figure.notes[1..], ["left out: 120 warm-up, 24 failed", shown]);
    assert_eq!(drawings[0].left_out, [shown]);
}

#[test]
fn throughput_of_noisy_delays_is_noted_not_drawn() {
    let noisy = run(300, |number| {
        let size_index = number as usize % 4;
        // The delays grow less with the size than they vary.
        let (bytes, delay) = ([1e3, 2e3, 3e3, 4e3][size_index], [0.100, 0.104, 0.099, 0.104][size_index]);
        vec![("upload-bytes", bytes), ("upload", delay)]
    });
    let drawings = payload::drawings(&[noisy]).expect("sizes differ");
    let [AnyFigure::Scaling(latency), AnyFigure::Scaling(throughput)] =
        [&drawings[0].figure, &drawings[1].figure]
    else {
        panic!("fits")
    };
    assert!(latency.series[0].name.starts_with("upload: intercept 0."), "{latency:?}");
    assert_eq!((throughput.series[0].name.as_str(), throughput.series[0].line), ("upload", None));
    for figure in [latency, throughput] {
        assert_eq!(figure.notes[2..], ["throughput of upload: too high to be determined from these sizes"]);
    }
}

#[test]
fn edges_that_measured_at_different_times_are_not_drawn() {
    let mut apart = [run_of_edge("s", 2, 0, 20.0), run_of_edge("s", 2, 1, 20.0)];
    apart[1].rows.change(|row| row.at += 1e6);
    assert!(
        users::drawings(&apart)
            .is_err_and(|missing| missing.to_string().contains("measured at different times"))
    );
    let together = [run_of_edge("m", 2, 0, 20.0), run_of_edge("m", 2, 1, 20.0)];
    let drawings =
        users::drawings(&[apart, together].concat()).expect("the edges of one run measured together");
    let AnyFigure::Sharing(figure) = &drawings[0].figure else { panic!("curves") };
    let expected_note = "left out, because the edges measured at different times: s with 2 edges";
    assert_eq!(
        (figure.notes[2].as_str(), drawings[0].left_out.as_slice()),
        (expected_note, &[expected_note.to_owned()][..])
    );
}
