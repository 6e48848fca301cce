//! Tests of the marks of replayed latencies.

use super::*;

/// Returns the same run with the fact that its latencies are replayed.
fn replayed(run: Loaded) -> Loaded {
    let facts = vec![("Replayed".to_owned(), "inference is drawn from x".to_owned())];
    Loaded { record: RunRecord { facts, ..run.record }, ..run }
}

fn with_total(model: &str, kind: &str, total: f64) -> Loaded {
    Loaded { record: placed(model, kind, 1.0).record, ..run_with_total(total) }
}

/// Draws the figures of a kind and returns the SVG and the caption of the figure with this stem.
fn drawn(kind: Kind, runs: &[Loaded], stem: &str) -> [String; 2] {
    let folder = tempfile::tempdir().expect("a folder");
    draw(kind, runs, &Columns::default(), folder.path()).expect("drawn");
    [".svg", "-caption.txt"]
        .map(|end| std::fs::read_to_string(folder.path().join(format!("{stem}{end}"))).expect("written"))
}

#[test]
fn replayed_configuration_is_marked_in_all_figures() {
    let runs = [with_total("s", "local", 20.0), replayed(with_total("s", "remote", 4.0))];
    for (kind, stem) in [(Kind::Stacked, "stacked"), (Kind::Totals, "totals"), (Kind::Accuracy, "accuracy")] {
        let [svg, caption] = drawn(kind, &runs, stem);
        assert!(svg.contains("remote (replayed)<") && svg.contains("local<"), "{stem}: {svg}");
        let note = "Replayed latencies, not measured: remote: inference is drawn from x.";
        assert!(caption.contains(note), "{stem}: {caption}");
        let [svg, caption] =
            drawn(kind, &[with_total("s", "local", 20.0), with_total("s", "remote", 4.0)], stem);
        // Without its first letter, the word is found with and without a capital.
        assert!(!svg.contains("eplayed") && !caption.contains("eplayed"), "{stem}: {caption}");
    }
}

#[test]
fn replayed_placement_or_model_is_marked_in_pairs() {
    let [svg, caption] =
        drawn(Kind::Paired, &[placed("s", "local", 20.0), replayed(placed("s", "remote", 4.0))], "paired");
    assert!(svg.contains(">cloud (replayed)<") && !svg.contains("remote"), "{svg}");
    assert!(caption.contains("not measured: remote: inference is drawn from x."), "{caption}");
    let partly_replayed = [
        placed("s", "local", 20.0),
        replayed(placed("s", "remote", 4.0)),
        placed("m", "local", 30.0),
        placed("m", "remote", 6.0),
    ];
    let drawings = paired::drawings(&partly_replayed, None).expect("pairs");
    let AnyFigure::Paired(figure) = &drawings[0].figure else { panic!("pairs") };
    let names: Vec<&str> = figure.groups.iter().map(|group| group.name.as_str()).collect();
    assert_eq!(
        (figure.placements.as_slice(), names.as_slice()),
        (["local", "cloud"].map(str::to_owned).as_slice(), ["s (replayed)", "m"].as_slice(),)
    );
}

#[test]
fn replayed_run_is_marked_where_model_latency_is_shown() {
    let run =
        replayed(run(60, |_| vec![("sensing", 1.0), ("upload", 2.0), ("inference", 5.0), ("total", 9.0)]));
    let folder = tempfile::tempdir().expect("a folder");
    of_run(&run.record, &run.rows, folder.path()).expect("written");
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).expect("written");
    let note = "Replayed latencies, not measured: inference is drawn from x.";
    for stem in ["inference-time", "cumulative", "series"] {
        assert!(read(&format!("{stem}.svg")).contains("robot → cloud (replayed)"), "{stem}");
        assert!(read(&format!("{stem}-caption.txt")).contains(note), "{stem}");
    }
    for stem in ["sensing-time", "upload-time"] {
        assert!(!read(&format!("{stem}.svg")).contains("replayed"), "{stem} shows measured times");
        assert!(!read(&format!("{stem}-caption.txt")).contains(note), "{stem}");
    }
}
