//! Misses, scores, success and returns beside the latencies of a comparison.

use super::*;

#[test]
fn miss_rate_is_shown_beside_failed() {
    let mut runs = paper();
    runs[1].rows.change(|row| {
        let is_late = row.outcome != Outcome::Ok || row.iteration % 10 == 0;
        row.values.push(("deadline-missed".into(), f64::from(u8::from(is_late))));
    });
    let comparison = Comparison::new(&runs);
    let misses = comparison.lines[1].misses.expect("a deadline");
    // Iterations 6 to 106 are not warm-up. Iteration 10 was lost.
    assert_eq!((misses.missed, misses.iterations, comparison.lines[0].misses), (10, 101, None));
    let text = comparison.text();
    assert!(
        text.contains("missed (%)") && text.contains(" 9.9 ") && text.contains("Missed: the share"),
        "{text}"
    );
    let csv = comparison.csv();
    let rates = column(&csv, "miss-rate");
    assert_eq!(rates[0], "");
    assert!(rates[1].starts_with("0.0990"), "{csv}");
    assert!(!Comparison::new(&paper()).text().contains("missed"), "no run has a deadline");
}

/// Returns the cells of a column, without its header.
fn column(csv: &str, name: &str) -> Vec<String> {
    let cells = |line: &str| line.split(',').map(str::to_owned).collect::<Vec<_>>();
    let header = cells(csv.lines().next().expect("a header"));
    let at = header.iter().position(|other| other == name).expect("such a column");
    csv.lines().skip(1).map(|line| cells(line)[at].clone()).collect()
}

#[test]
fn scores_of_detections_are_shown_beside_latency() {
    let mut runs = paper();
    runs[1].rows.change(|row| {
        let score = f64::from(u8::from(row.iteration % 2 == 0));
        row.values.extend([("map-50".into(), score), ("mean-iou".into(), 0.7)]);
    });
    let comparison = Comparison::new(&runs);
    let text = comparison.text();
    // In runs with `map-50`, `mean-iou` is the mean overlap of the found objects, which is not shown as a score.
    assert!(text.contains("mAP@0.5 (%)") && !text.contains("mean IoU (%)"), "{text}");
    assert!(
        text.contains("50.0 (")
            && text.contains("mAP@0.5 and mean IoU: mean of the values of single pictures"),
        "{text}"
    );
    let csv = comparison.csv();
    assert_eq!(column(&csv, "map-50"), ["", "0.5", ""]);
    assert_eq!(column(&csv, "map-50-count")[1], comparison.lines[1].count.to_string());
    assert_eq!(column(&csv, "mean-iou"), ["", "", ""]);
}

#[test]
fn success_and_return_are_shown_beside_latency() {
    let mut runs = paper();
    runs[1].rows.change(|row| {
        // Episodes of five iterations. Every second episode succeeds, and the last iteration of one episode is lost.
        if row.iteration % 5 == 0 {
            row.values.push(("episode-success".into(), f64::from(u8::from(row.iteration % 10 == 0))));
            row.values.push(("episode-return".into(), 2.5));
        } else if row.iteration % 5 == 1 {
            row.values.push(("superseded".into(), 1.0));
        }
    });
    let comparison = Comparison::new(&runs);
    let success = comparison.lines[1].actuator.success.expect("is reported");
    // An episode counts even if its last iteration is warm-up or lost.
    let [episodes, successes] = [5, 10].map(|each| {
        runs[1]
            .rows
            .iter()
            .filter(|row| row.value("iteration").is_some_and(|number| number % f64::from(each) == 0.0))
            .count()
    });
    assert_eq!(success.episodes, episodes as u64);
    assert_eq!(success.rate, successes as f64 / episodes as f64);
    assert_eq!(comparison.lines[0].actuator, ActuatorResults::default());
    let text = comparison.text();
    for part in [
        "superseded",
        "episodes",
        "success (%)",
        "return",
        "Success: episodes",
        "2.50 ± 0.00",
        "Superseded: answers",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    // The mark stands at the smallest mean total, not at a success or a return.
    let marked = text.lines().find(|line| line.contains(" *")).expect("a marked line");
    assert!(marked.contains("20.260 ± 0.002 *") && marked.ends_with('—'), "{marked}");
    assert!(text.contains(&format!("  {episodes}  ")), "{text}");
    assert!(
        !text.contains("Episodes: the number"),
        "success and return are known for the same number of episodes: {text}"
    );
    let csv = comparison.csv();
    assert_eq!(column(&csv, "return-mean"), ["", "2.5", ""]);
    assert_eq!(column(&csv, "success-episodes")[1], episodes.to_string());
    assert_eq!(column(&csv, "superseded")[0], "0");
    let without = Comparison::new(&paper()).text();
    assert!(!without.contains("success (%)") && !without.contains("superseded"), "{without}");
    for name in ["superseded", "episode-success", "episode-return"] {
        assert!(needs_column(name), "a comparison must read {name}");
    }
}

#[test]
fn accuracy_is_shown_beside_latency() {
    let mut runs = paper();
    runs[1].rows.change(|row| {
        row.values.push(("top-1".into(), if row.iteration % 4 == 0 { 0.0 } else { 1.0 }));
        row.values.push(("top-5".into(), 1.0));
    });
    let comparison = Comparison::new(&runs);
    let accuracy = comparison.lines[1].accuracy("top-1").expect("known");
    assert_eq!((accuracy.share, accuracy.count), (0.75, 100));
    assert_eq!(comparison.lines[0].accuracy("top-1"), None);
    let text = comparison.text();
    assert!(text.contains("Top-1 (%)") && text.contains("75.0 (65.7 – 82.5)"), "{text}");
    assert!(text.contains("100.0 (96.3 – 100.0)") && text.contains("\nTop-1 and Top-5: right"), "{text}");
    let mut few_classes = runs.clone();
    few_classes[1].rows.change(|row| row.values.retain(|(name, _)| name != "top-5"));
    let without = Comparison::new(&few_classes).text();
    assert!(without.contains("\nTop-1: right") && !without.contains("Top-5"), "{without}");
    let csv = comparison.csv();
    assert!(
        csv.lines().next().is_some_and(|line| line.contains(
            ",edges,top-1,top-1-lo,top-1-hi,top-1-unscored,top-5,top-5-lo,top-5-hi,top-5-unscored,\
             beyond-best,beyond-best-lo,beyond-best-hi,miss-rate,"
        )),
        "{csv}"
    );
    assert!(csv.lines().nth(2).is_some_and(|line| line.contains(",1,0.75,0.65")), "{csv}");
    assert!(!text.contains("valid score"), "{text}");
    assert!(!Comparison::new(&paper()).text().contains("Top-1"), "no sample has a label");
    let broken = |row: &mut Row| match row.iteration {
        20 => row.values.retain(|(name, _)| name != "top-1"),
        21 | 22 => row.values.iter_mut().filter(|(name, _)| name == "top-1").for_each(|(_, v)| *v = f64::NAN),
        _ => {}
    };
    runs[1].rows.change(broken);
    let comparison = Comparison::new(&runs);
    let sentence = format!("excluded from the accuracy: top-1 of {}: 3 of 100.", comparison.lines[1].name);
    assert!(comparison.text().contains(&sentence), "{sentence} in {}", comparison.text());
    assert_eq!(comparison.lines[1].accuracy("top-1").map(|top| (top.count, top.unscored)), Some((97, 3)));
}
