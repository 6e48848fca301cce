//! Runs over time, stacked.

use super::super::{OverTimeAxes, StageBucket, StagePart, StagesOverTime};
use crate::plot::{Item, Path, Plot, Step};

fn bucket(begin: f64, seconds: f64) -> StageBucket {
    let part =
        |name: &str, share: f64| StagePart { name: name.to_owned(), seconds: seconds * share, bound: None };
    let parts = vec![part("sensing", 0.25), part("inference", 0.75)];
    StageBucket { begin, median: seconds, p95: None, parts }
}

fn run(buckets: Vec<StageBucket>) -> StagesOverTime {
    StagesOverTime { length: 10.0, width: 1.0, buckets, ..StagesOverTime::default() }
}

fn axes(run: &StagesOverTime) -> OverTimeAxes {
    OverTimeAxes::of(std::slice::from_ref(run)).expect("buckets")
}

fn drawn(run: &StagesOverTime) -> Plot {
    run.plot(&axes(run))
}

fn paths(items: &[Item]) -> Vec<(&str, &Path)> {
    let mut found = Vec::new();
    for item in items {
        if let Item::Path { path, style } = item {
            found.push((&*style.class, path));
        }
    }
    found
}

fn path<'a>(items: &'a [Item], class: &str) -> Option<&'a Path> {
    paths(items).into_iter().find(|(stages, _)| *stages == class).map(|(_, path)| path)
}

fn pieces(path: &Path) -> usize {
    path.steps.iter().filter(|step| matches!(step, Step::Move(..))).count()
}

#[test]
fn a_line_stops_where_nothing_was_measured() {
    let gap = drawn(&run(vec![bucket(0.0, 0.01), bucket(1.0, 0.01), bucket(5.0, 0.01)]));
    assert_eq!(path(&gap.items, "median").map(pieces), Some(2), "{gap:?}");
    let stages: Vec<(&str, usize)> = paths(&gap.items)
        .into_iter()
        .filter(|(class, _)| class.starts_with("f-"))
        .map(|(class, path)| (class, pieces(path)))
        .collect();
    assert_eq!(stages, [("f-inference", 2), ("f-sensing", 2)], "the lower stage is drawn over the upper one");
    assert_eq!(path(&gap.items, "p95"), None, "no bucket has enough samples");
}

#[test]
fn single_bucket_is_as_wide_as_its_duration() {
    let ends = |run: &StagesOverTime| {
        let plot = drawn(run);
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
    assert_eq!(ends(&StagesOverTime { length: 1.0, ..run(vec![bucket(-0.4, 0.01)]) }), [0.0, 60.0]);
}

#[test]
fn axis_ends_above_largest_quantile_and_counts_rest() {
    let mut stages = run(vec![bucket(0.0, 0.010), bucket(1.0, 0.012), bucket(2.0, 0.500)]);
    stages.buckets.iter_mut().for_each(|bucket| (bucket.median, bucket.p95) = (0.01, Some(0.02)));
    assert_eq!((axes(&stages).beyond(&stages), axes(&stages).unit()), (1, "seconds"));
    let top = |run: &StagesOverTime| drawn(run).y.scale.ends().1;
    assert!((top(&stages) - 21.0).abs() < 1e-9);
    let plot = drawn(&stages);
    let area = path(&plot.items, "f-inference").expect("an area");
    let leaves = area.steps.iter().any(|step| matches!(step, Step::Line(_, y) if *y < 0.0));
    assert!(leaves, "cut off by the renderer: {area:?}");
    // Without a quantile of any bucket, that of the run.
    stages.buckets.iter_mut().for_each(|bucket| bucket.p95 = None);
    stages.p95 = Some(0.03);
    assert!((top(&stages) - 31.5).abs() < 1e-9);
}

#[test]
fn weeks_and_nothing_have_axes_too() {
    let week = StagesOverTime { length: 604_800.0, width: 7_200.0, ..run(vec![bucket(0.0, 0.01)]) };
    let short = run(vec![bucket(0.0, 0.01)]);
    let both = OverTimeAxes::of(&[week, short.clone()]).expect("buckets");
    assert!(both.unit() == "days" && both.is_short(&short) && !axes(&short).is_short(&short));
    assert!(path(&short.plot(&both).items, "median").is_some());
    assert_eq!(OverTimeAxes::of(&[run(Vec::new())]), None);
    assert!(OverTimeAxes::of(&[run(vec![bucket(0.0, 0.0)])]).is_some());
}

#[test]
fn overlapping_marks_are_merged() {
    let mut stages = run(vec![bucket(0.0, 0.01)]);
    (stages.failed, stages.borders) = (vec![5.0, 1.0, 1.01, 1.02], vec![2.5, 5.0]);
    let plot = drawn(&stages);
    let rail = plot.top_strip.as_ref().expect("a rail");
    assert_eq!(path(&rail.items, "lost").map(pieces), Some(2));
    let borders = path(&plot.items, "border").expect("borders");
    assert_eq!(
        (pieces(borders), borders.steps[..2].to_vec()),
        (2, vec![Step::Move(0.25, 0.0), Step::Line(0.25, 1.0)])
    );
}
