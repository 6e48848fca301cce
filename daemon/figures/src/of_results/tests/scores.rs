//! Tests of figures of the scores of pictures and episodes.

use super::*;

#[test]
fn scores_of_pictures_are_drawn_against_latency() {
    let with_scores = |model: &str, names: &'static [&'static str]| {
        let record = placed(model, "local", 1.0).record;
        let run = run(100, |number| {
            let score = (number % 2) as f64;
            [("total", 20.0)].into_iter().chain(names.iter().map(|name| (*name, score))).collect()
        });
        Loaded { record, ..run }
    };
    let detector = with_scores("d", &["map-50", "mean-iou"]);
    let segmenter = with_scores("s", &["mean-iou"]);
    let drawings = accuracy::drawings(&[detector, segmenter]).expect("there are scores");
    let stems_and_labels: Vec<(&str, &str)> = drawings
        .iter()
        .map(|drawing| {
            let AnyFigure::QualityAgainstLatency(figure) = &drawing.figure else { panic!("points") };
            let [point] = &figure.points[..] else {
                panic!("not exactly one model has the score: {figure:?}")
            };
            let QualityEstimate { value: mean, interval: (low, high), .. } = point.estimate;
            assert!(low < mean && mean < high && (0.4..0.6).contains(&mean), "{point:?}");
            (drawing.stem.as_ref(), point.label.as_str())
        })
        .collect();
    assert_eq!(stems_and_labels, [("map-50", "d"), ("mean-iou", "s")]);
    let AnyFigure::QualityAgainstLatency(figure) = &drawings[1].figure else { panic!("points") };
    let svg = file::svg(&figure.figure());
    assert!(
        svg.contains("Mean IoU of a picture, %") && figure.figure().caption_text().contains("(Student)"),
        "{svg}"
    );
}

#[test]
fn success_of_episodes_is_drawn_against_latency() {
    let with_episodes = |model: &str, total: f64, successes: u64| {
        let record = placed(model, "local", 1.0).record;
        let run = run(100, |number| {
            let mut values = vec![("total", total)];
            if number % 20 == 0 {
                values.push(("episode-success", f64::from(number / 20 <= successes)));
                values.push(("episode-return", -(number as f64)));
            }
            values
        });
        Loaded { record, ..run }
    };
    let runs = [with_episodes("s", 20.0, 5), with_episodes("m", 600.0, 2), placed("l", "local", 9.0)];
    let drawings = accuracy::drawings(&runs).expect("there are episodes");
    let [drawing, returns] = &drawings[..] else {
        panic!("without labels, there are the figures of success and return only")
    };
    assert_eq!((drawing.stem.as_str(), returns.stem.as_str()), ("success", "return"));
    for drawing in &drawings {
        assert_eq!(drawing.left_out, ["left out: 1 configuration without scored episodes"]);
    }
    let AnyFigure::QualityAgainstLatency(figure) = &drawing.figure else { panic!("points") };
    let estimates: Vec<_> =
        figure.points.iter().map(|point| (point.label.as_str(), point.estimate)).collect();
    let estimate = |right| estimate_of_counts(Quality::Success, right, 5).expect("there are episodes");
    assert_eq!(estimates, [("s", estimate(5)), ("m", estimate(2))]);
    assert!((figure.points[1].median - 0.6).abs() < 1e-9 && figure.notes[0].ends_with("episodes: 5 each"));
    let svg = file::svg(&figure.figure());
    assert!(svg.contains("Successful episodes, %") && svg.contains("success, %"), "{svg}");
    let AnyFigure::QualityAgainstLatency(figure) = &returns.figure else { panic!("points") };
    let QualityEstimate { value, interval: (low, high), count, .. } = figure.points[0].estimate;
    assert!((value, count) == (-60.0, 5) && low < -60.0 && high > -60.0, "{figure:?}");
    let svg = file::svg(&figure.figure());
    assert!(svg.contains("Return of an episode") && svg.contains("\u{2212}60"), "{svg}");
}

#[test]
fn figures_of_all_qualities_are_recognised() {
    let configurations = [
        ("s", "local", vec!["top-1", "episode-success", "episode-return"]),
        ("s", "remote", vec!["map-50"]),
        ("m", "local", vec!["mean-iou"]),
    ];
    let runs = configurations.map(|(model, placement, qualities)| {
        let mut run = placed(model, placement, 5.0);
        run.rows.change(|row| {
            let value = f64::from(u8::from(row.iteration % 4 != 0));
            row.values.push(("total".into(), 20e-3 + row.iteration as f64 / 1e5));
            row.values.extend(qualities.iter().map(|name| ((*name).into(), value)));
        });
        run
    });
    let folder = tempfile::tempdir().expect("a folder");
    let files = of_experiment(&runs, folder.path()).expect("written");
    let names = file_names(&files);
    for stem in Quality::ALL.map(Quality::figure_stem).into_iter().chain(["stacked", "totals", "paired"]) {
        assert!(written_as(stem).iter().all(|name| names.contains(name)), "{stem}: {names:?}");
    }
    assert_all_are_recognised(&files, folder.path());
}
