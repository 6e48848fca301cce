//! Plot of one run over time; several runs share their axes.

use askama::Template;

use super::pen::{self, At};
use super::{Axis, Part, Percent, Scale};
use crate::look;

/// Share of the largest quantile by which the vertical axis extends beyond it.
const MARGIN: f64 = 0.05;
/// Units of time: longest axis that the unit is used for, seconds; length of the unit, seconds; its name.
const UNITS: [(f64, f64, &str); 4] = [
    (180.0, 1.0, "seconds"),
    (10_800.0, 60.0, "minutes"),
    (259_200.0, 3_600.0, "hours"),
    (f64::INFINITY, 86_400.0, "days"),
];
/// Courses shorter than this share of the axis are reported as short.
const SHORT: f64 = 0.02;
/// Marks on the rail that are closer than this share of it are merged.
const TOUCHING: f64 = 0.005;

/// Returns the position of a stage in a stack, counted from below.
fn place(name: &str) -> usize {
    // Both directions together take the place of the upload.
    let name = if name == look::NETWORK { "upload" } else { name };
    look::STACK.iter().position(|known| *known == name).unwrap_or(look::STACK.len())
}

/// A bucket; seconds since the run's first iteration, and seconds of latency.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CourseBucket {
    pub begin: f64,
    pub median: f64,
    pub p95: Option<f64>,
    /// Means, which add up to that of the total.
    pub parts: Vec<Part>,
}

impl CourseBucket {
    fn mean(&self) -> f64 {
        self.parts.iter().map(|part| part.seconds).sum()
    }
}

/// A run over time; moments are seconds since its first iteration.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CourseData {
    /// Description of the plot in words.
    pub label: String,
    pub length: f64,
    /// Width of a bucket, seconds.
    pub width: f64,
    /// Oldest first.
    pub buckets: Vec<CourseBucket>,
    pub borders: Vec<f64>,
    pub warm_up: Option<f64>,
    pub unanswered: Vec<f64>,
    /// The 95th percentile of the whole run, seconds.
    pub p95: Option<f64>,
}

impl CourseData {
    /// Returns the largest quantile; where no bucket has enough samples for a high one, that of the whole run.
    fn reach(&self) -> f64 {
        let largest =
            |of: fn(&CourseBucket) -> Option<f64>| self.buckets.iter().filter_map(of).reduce(f64::max);
        let high =
            largest(|bucket| bucket.p95).or(self.p95).or_else(|| largest(|bucket| Some(bucket.mean())));
        high.into_iter().chain(largest(|bucket| Some(bucket.median))).fold(0.0, f64::max)
    }

    /// Returns the stretches of buckets that follow upon one another, as indices of the first and the one behind the last.
    fn pieces(&self) -> impl Iterator<Item = &[CourseBucket]> {
        self.buckets.chunk_by(|a, b| b.begin - a.begin < self.width * 1.5)
    }

    /// Returns the line of one value of all buckets: each in the middle of its bucket, and the ends of a piece extended to the ends of
    /// their buckets.
    fn outline(&self, value: impl Fn(&CourseBucket) -> Option<f64>) -> Vec<Option<(f64, f64)>> {
        // A bucket in which the warm-up ends holds nothing from before.
        let begun = self.warm_up.unwrap_or(0.0).clamp(0.0, self.length);
        let inside = |at: f64| at.clamp(begun, self.length);
        let mut points = Vec::with_capacity(self.buckets.len() + 4);
        for piece in self.pieces() {
            // A quantile may be missing in the midst of a piece.
            for known in piece.chunk_by(|a, b| value(a).is_some() == value(b).is_some()) {
                let point = |bucket: &CourseBucket, share: f64| {
                    Some((inside(bucket.begin + self.width * share), value(bucket)?))
                };
                points.extend(known.first().map(|first| point(first, 0.0)));
                points.extend(known.iter().filter(|_| known.len() > 1).map(|bucket| point(bucket, 0.5)));
                points.extend(known.last().map(|last| point(last, 1.0)));
                points.push(None);
            }
        }
        points
    }
}

/// The axes that all courses share: seconds across, and upwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CourseAxes {
    length: f64,
    top: f64,
}

impl CourseAxes {
    /// Returns axes from zero to the end of the longest run, and to a little above the largest quantile; `None` without a bucket.
    pub(crate) fn of(all: &[CourseData]) -> Option<Self> {
        let most = |of: fn(&CourseData) -> f64| all.iter().map(of).fold(0.0, f64::max);
        let top = most(CourseData::reach) * (1.0 + MARGIN);
        let known = all.iter().any(|one| !one.buckets.is_empty());
        known.then(|| Self { length: most(|one| one.length), top: if top > 0.0 { top } else { 1e-3 } })
    }

    /// Returns the unit of the horizontal axis.
    pub(crate) fn unit(&self) -> &'static str {
        self.times().1
    }

    fn times(&self) -> (f64, &'static str) {
        let fits = |(most, ..): &&(f64, f64, &str)| self.length <= *most;
        UNITS.iter().find(fits).map_or((1.0, "seconds"), |(_, seconds, name)| (*seconds, *name))
    }

    /// Returns the number of buckets of a course whose mean is beyond the upper end.
    pub(crate) fn beyond(&self, course: &CourseData) -> usize {
        course.buckets.iter().filter(|bucket| bucket.mean() > self.top).count()
    }

    /// Returns whether a course is so short beside the longest that it can hardly be seen.
    pub(crate) fn is_short(&self, course: &CourseData) -> bool {
        course.length < self.length * SHORT
    }

    fn x(&self, seconds: f64) -> f64 {
        (seconds / self.length).clamp(0.0, 1.0)
    }

    fn at(&self, (seconds, value): (f64, f64)) -> At {
        // Beyond the upper end a little outside of it: the sheet cuts it off.
        (self.x(seconds), (1.0 - value / self.top).clamp(-0.05, 1.0))
    }
}

/// The picture.
#[derive(Clone, Debug, PartialEq, Template)]
#[template(path = "svg/course.html")]
pub(crate) struct CoursePlot {
    label: String,
    values: Vec<(Percent, String)>,
    times: Axis,
    warm_up: Option<(Percent, Percent)>,
    /// Colour and path, the uppermost of the stack first: each covers what is below it too.
    areas: Vec<(&'static str, String)>,
    lines: [(&'static str, String); 2],
    borders: String,
    unanswered: String,
}

impl askama::filters::HtmlSafe for CoursePlot {}

impl CoursePlot {
    /// Returns a course on axes that hold it.
    pub(crate) fn new(course: &CourseData, axes: &CourseAxes) -> Self {
        let path =
            |points: Vec<Option<(f64, f64)>>| points.into_iter().map(|point| point.map(|it| axes.at(it)));
        let line = |value: fn(&CourseBucket) -> Option<f64>| pen::line(path(course.outline(value)));
        let mut names: Vec<&str> = Vec::new();
        for name in course.buckets.iter().flat_map(|bucket| &bucket.parts).map(|part| part.name.as_str()) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names.sort_by_key(|name| std::cmp::Reverse(place(name)));
        let below = |bucket: &CourseBucket, name: &str| {
            let parts = bucket.parts.iter().filter(|part| place(&part.name) <= place(name));
            Some(parts.map(|part| part.seconds).sum())
        };
        let area =
            |name: &&str| (look::class(name), pen::area(path(course.outline(|bucket| below(bucket, name)))));
        let across = |at: &f64| axes.x(*at);
        let mut lost: Vec<f64> = course.unanswered.iter().map(across).collect();
        lost.sort_by(f64::total_cmp);
        lost.dedup_by(|b, a| *b - *a < TOUCHING);
        let (seconds, _) = axes.times();
        let values = Scale::ticks_until(axes.top * 1e3, 5);
        Self {
            label: course.label.clone(),
            values: values.into_iter().map(|(at, text)| (Percent(100.0 - at.0), text)).collect(),
            times: Axis::below(Scale::ticks_until(axes.length / seconds, 4)),
            warm_up: course.warm_up.map(|until| (Percent(0.0), Percent(axes.x(until) * 100.0))),
            areas: names.iter().map(area).collect(),
            lines: [("p95", line(|bucket| bucket.p95)), ("median", line(|bucket| Some(bucket.median)))],
            borders: pen::ticks(course.borders.iter().map(|at| (across(at), 0.0, 1.0))),
            unanswered: pen::ticks(lost.into_iter().map(|x| (x, 0.0, 1.0))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bucket(begin: f64, seconds: f64) -> CourseBucket {
        let part =
            |name: &str, share: f64| Part { name: name.to_owned(), seconds: seconds * share, bound: None };
        let parts = vec![part("sensing", 0.25), part("inference", 0.75)];
        CourseBucket { begin, median: seconds, p95: None, parts }
    }

    fn course(buckets: Vec<CourseBucket>) -> CourseData {
        CourseData {
            label: "a run".to_owned(),
            length: 10.0,
            width: 1.0,
            buckets,
            borders: Vec::new(),
            warm_up: None,
            unanswered: Vec::new(),
            p95: None,
        }
    }

    fn drawn(course: &CourseData) -> CoursePlot {
        CoursePlot::new(course, &CourseAxes::of(std::slice::from_ref(course)).expect("buckets"))
    }

    #[test]
    fn a_line_stops_where_nothing_was_measured() {
        let gap = drawn(&course(vec![bucket(0.0, 0.01), bucket(1.0, 0.01), bucket(5.0, 0.01)]));
        assert_eq!(gap.lines[1].1.matches('M').count(), 2, "{gap:?}");
        let [(last, whole), (first, below)] = &gap.areas[..] else { panic!("{gap:?}") };
        assert_eq!((*last, *first), ("inference", "sensing"), "what covers the other comes first");
        assert_eq!((whole.matches('Z').count(), below.matches('Z').count()), (2, 2));
        assert!(gap.lines[0].1.is_empty(), "no bucket has enough samples");
    }

    #[test]
    fn a_single_bucket_is_as_wide_as_it_lasted() {
        let one = drawn(&course(vec![bucket(4.0, 0.01)]));
        assert!(one.lines[1].1.starts_with("M400.0 ") && one.lines[1].1.contains("L500.0 "), "{one:?}");
        let short = drawn(&CourseData { length: 1.0, ..course(vec![bucket(-0.4, 0.01)]) });
        assert!(short.lines[1].1.starts_with("M0.0 ") && short.lines[1].1.contains("L600.0 "), "{short:?}");
    }

    #[test]
    fn the_axis_ends_above_the_largest_quantile_and_counts_what_is_beyond() {
        let mut known = course(vec![bucket(0.0, 0.010), bucket(1.0, 0.012), bucket(2.0, 0.500)]);
        known.buckets.iter_mut().for_each(|bucket| (bucket.median, bucket.p95) = (0.01, Some(0.02)));
        let axes = CourseAxes::of(std::slice::from_ref(&known)).expect("buckets");
        assert_eq!((axes.beyond(&known), axes.unit()), (1, "seconds"));
        assert!((axes.top - 0.021).abs() < 1e-12);
        let plot = CoursePlot::new(&known, &axes);
        assert!(plot.areas[0].1.contains(" -50.0"), "cut off by the sheet: {plot:?}");
        // Without a quantile of any bucket, that of the run.
        known.buckets.iter_mut().for_each(|bucket| bucket.p95 = None);
        known.p95 = Some(0.03);
        assert!((CourseAxes::of(&[known]).expect("buckets").top - 0.0315).abs() < 1e-12);
    }

    #[test]
    fn weeks_and_nothing_have_axes_too() {
        let week = CourseData { length: 604_800.0, width: 7_200.0, ..course(vec![bucket(0.0, 0.01)]) };
        let short = course(vec![bucket(0.0, 0.01)]);
        let axes = CourseAxes::of(&[week, short.clone()]).expect("buckets");
        assert_eq!(axes.unit(), "days");
        assert!(
            axes.is_short(&short)
                && !CourseAxes::of(std::slice::from_ref(&short)).expect("buckets").is_short(&short)
        );
        assert!(!CoursePlot::new(&short, &axes).lines[1].1.is_empty());
        assert_eq!(CourseAxes::of(&[course(Vec::new())]), None);
        assert!(CourseAxes::of(&[course(vec![bucket(0.0, 0.0)])]).is_some());
    }

    #[test]
    fn marks_that_would_lie_on_one_another_are_one() {
        let mut known = course(vec![bucket(0.0, 0.01)]);
        (known.unanswered, known.borders) = (vec![5.0, 1.0, 1.01, 1.02], vec![2.5, 5.0]);
        let plot = drawn(&known);
        assert_eq!((plot.unanswered.matches('M').count(), plot.borders.matches('M').count()), (2, 2));
        assert!(plot.borders.starts_with("M250.0 0.0L250.0 1000.0"), "{plot:?}");
    }
}
