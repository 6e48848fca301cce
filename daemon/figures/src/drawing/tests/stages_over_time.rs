//! Tests of plots of stacked stages over time.

use peernet_analysis::slowness::BOTH_DIRECTIONS;

use super::super::{OverTimeAxes, StageBucket, StagePart, StagesOverTime};
use crate::plot::{Item, Path, Plot, Step};

/// Returns a bucket that begins `begin` seconds after the start of the run and has a median total of `seconds`.
fn bucket(begin: f64, seconds: f64) -> StageBucket {
    let part =
        |name: &str, share: f64| StagePart { name: name.to_owned(), seconds: seconds * share, bound: None };
    let parts = vec![part("sensing", 0.25), part("inference", 0.75)];
    StageBucket { begin, median: seconds, p95: None, parts }
}

/// Returns a run of 10 s with buckets of 1 s.
fn run(buckets: Vec<StageBucket>) -> StagesOverTime {
    StagesOverTime { length: 10.0, width: 1.0, buckets, ..StagesOverTime::default() }
}

fn axes(run: &StagesOverTime) -> OverTimeAxes {
    OverTimeAxes::of(std::slice::from_ref(run)).expect("buckets")
}

fn plot_of(run: &StagesOverTime) -> Plot {
    run.plot(&axes(run))
}

/// Returns the paths among these items, each with its class.
fn paths(items: &[Item]) -> Vec<(&str, &Path)> {
    let mut paths = Vec::new();
    for item in items {
        if let Item::Path { path, style } = item {
            paths.push((&*style.class, path));
        }
    }
    paths
}

fn path<'a>(items: &'a [Item], class: &str) -> Option<&'a Path> {
    paths(items).into_iter().find(|(other, _)| *other == class).map(|(_, path)| path)
}

/// Returns the number of pieces of a path.
fn pieces(path: &Path) -> usize {
    path.steps.iter().filter(|step| matches!(step, Step::Move(..))).count()
}

#[test]
fn missing_buckets_interrupt_lines_and_areas() {
    let plot = plot_of(&run(vec![bucket(0.0, 0.01), bucket(1.0, 0.01), bucket(5.0, 0.01)]));
    assert_eq!(path(&plot.items, "median").map(pieces), Some(2), "{plot:?}");
    let stages: Vec<(&str, usize)> = paths(&plot.items)
        .into_iter()
        .filter(|(class, _)| class.starts_with("f-"))
        .map(|(class, path)| (class, pieces(path)))
        .collect();
    assert_eq!(
        stages,
        [("f-inference", 2), ("f-sensing", 2)],
        "the lower stage must be drawn over the upper stage"
    );
    assert_eq!(path(&plot.items, "p95"), None, "no bucket has enough samples");
}

#[test]
fn upload_and_sum_of_both_directions_have_separate_areas() {
    let mut stages = run(vec![bucket(0.0, 0.01), bucket(1.0, 0.01)]);
    for (bucket, name) in stages.buckets.iter_mut().zip(["upload", BOTH_DIRECTIONS]) {
        name.clone_into(&mut bucket.parts[1].name);
    }
    let plot = plot_of(&stages);
    let start = |class: &str| path(&plot.items, class).expect("an area").steps[0];
    assert_eq!(start("f-network"), start("f-sensing"), "the first bucket has no sum of both directions");
    assert_ne!(start("f-upload"), start("f-sensing"));
}

#[test]
fn line_of_single_bucket_covers_bucket_within_run() {
    // Returns the ends of the median's line, percent of the run.
    let ends = |run: &StagesOverTime| {
        let plot = plot_of(run);
        let median = path(&plot.items, "median").expect("a line").clone();
        median
            .steps
            .iter()
            .filter_map(|step| match step {
                Step::Move(x, _) | Step::Line(x, _) => Some((x * 100.0).round()),
                Step::Close => None,
            })
            .collect::<Vec<_>>()
    };
    assert_eq!(ends(&run(vec![bucket(4.0, 0.01)])), [40.0, 50.0]);
    // The bucket lasts from -0.4 s to 0.6 s, and the run from 0 s to 1 s.
    assert_eq!(ends(&StagesOverTime { length: 1.0, ..run(vec![bucket(-0.4, 0.01)]) }), [0.0, 60.0]);
}

#[test]
fn axis_ends_above_largest_percentile() {
    let mut stages = run(vec![bucket(0.0, 0.010), bucket(1.0, 0.012), bucket(2.0, 0.500)]);
    stages.buckets.iter_mut().for_each(|bucket| (bucket.median, bucket.p95) = (0.01, Some(0.02)));
    assert_eq!((axes(&stages).beyond(&stages), axes(&stages).unit()), (1, "seconds"));
    let top = |run: &StagesOverTime| plot_of(run).y.scale.ends().1;
    assert!((top(&stages) - 21.0).abs() < 1e-9);
    let plot = plot_of(&stages);
    let area = path(&plot.items, "f-inference").expect("an area");
    let leaves_plot = area.steps.iter().any(|step| matches!(step, Step::Line(_, y) if *y < 0.0));
    assert!(leaves_plot, "the area of the bucket with a large mean must leave the plot: {area:?}");
    // If no bucket has a 95th percentile, the axis shows the 95th percentile of the run.
    stages.buckets.iter_mut().for_each(|bucket| bucket.p95 = None);
    stages.p95 = Some(0.03);
    assert!((top(&stages) - 31.5).abs() < 1e-9);
}

#[test]
fn long_and_zero_latency_runs_have_axes() {
    let week = StagesOverTime { length: 604_800.0, width: 7_200.0, ..run(vec![bucket(0.0, 0.01)]) };
    let short = run(vec![bucket(0.0, 0.01)]);
    let both = OverTimeAxes::of(&[week, short.clone()]).expect("buckets");
    assert!(both.unit() == "days" && both.is_short(&short) && !axes(&short).is_short(&short));
    assert!(path(&short.plot(&both).items, "median").is_some());
    assert_eq!(OverTimeAxes::of(&[run(Vec::new())]), None);
    assert!(OverTimeAxes::of(&[run(vec![bucket(0.0, 0.0)])]).is_some());
}

#[test]
fn marks_of_close_failures_are_merged() {
    let mut stages = run(vec![bucket(0.0, 0.01)]);
    (stages.failed, stages.borders) = (vec![5.0, 1.0, 1.01, 1.02], vec![2.5, 5.0]);
    let plot = plot_of(&stages);
    let strip = plot.top_strip.as_ref().expect("a strip");
    assert_eq!(path(&strip.items, "lost").map(pieces), Some(2));
    let borders = path(&plot.items, "border").expect("borders");
    assert_eq!(
        (pieces(borders), borders.steps[..2].to_vec()),
        (2, vec![Step::Move(0.25, 0.0), Step::Line(0.25, 1.0)])
    );
}
