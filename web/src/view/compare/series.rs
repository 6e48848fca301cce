//! Runs of a comparison over time, from stored buckets and single rows, at any length of a run.

use std::collections::HashMap;

use peernet_clock::WallTime;
use peernet_figures::drawing::{OverTimeAxes, StageBucket, StagePart, StagesOverTime};
use peernet_logger::{Name, stage};
use peernet_statistics::number::{duration, length};
use peernet_store::{Episodes, MeanBucket, RunSummary, Series, SeriesPoint, StageMeans, Store};

use super::choice::{Chosen, chosen, without_answer};
use super::{Comparison, Configuration};
use crate::error::WebError;
use crate::picture::Picture;
use crate::view::{counted, episodes, stack};

/// Largest and smallest number of points of a run, and samples that each should have: enough for a 95th percentile.
const POINTS: usize = 100;
const FEWEST: u64 = 20;
const SAMPLES: u64 = 60;
/// A run of fewer points than this is not drawn, since its length in time is too inexact.
const FEWEST_POINTS: usize = 3;
/// Number of points below which the drawn length of a run is inexact, by part of a point at each end.
const FEW: f64 = 5.0;

/// Stored data of a run over time.
#[derive(Clone, Debug)]
pub(crate) struct RunCourse {
    /// Time series of the total, or of the sensor in a run without a model.
    pub series: Series,
    /// Means of the stages and the total, in the buckets of `series`.
    pub means: Vec<StageMeans>,
    pub episodes: Episodes,
}

/// Data of runs over time, by the number of the run.
pub(crate) type RunCourses = HashMap<i64, RunCourse>;

/// Runs over time, side by side.
pub(crate) struct OverTime {
    pub runs: Vec<RunPicture>,
    /// Unit of the horizontal axes.
    pub unit: &'static str,
    pub legend: Picture,
    /// Number of runs, if not all are drawn.
    pub of: Option<usize>,
    /// A sentence about runs without a single answer.
    pub missing: Option<String>,
}

/// One run over time.
pub(crate) struct RunPicture {
    pub run: i64,
    pub name: String,
    pub said: String,
    pub picture: Picture,
}

/// Returns the runs that are drawn, each with the quantity that is drawn: the total, or the sensor's time in a run without a model.
fn drawn(comparison: &Comparison) -> (Vec<Chosen<'_, Name>>, Option<usize>) {
    chosen(comparison, |run| {
        let names = [stage::TOTAL, stage::SENSING];
        names.into_iter().find(|name| comparison.known(run.number, name).is_some())
    })
}

/// Reads the runs that are drawn.
///
/// # Errors
/// Returns an error when the store cannot be read.
pub(crate) async fn run_courses(store: &Store, comparison: &Comparison) -> Result<RunCourses, WebError> {
    let mut all = RunCourses::new();
    for (_, run, name) in drawn(comparison).0 {
        let samples = comparison.known(run.number, &name).map_or(0, |known| known.count());
        let points = (samples / SAMPLES).clamp(FEWEST, POINTS as u64) as usize;
        let main = [name];
        let names: Vec<Name> = [stage::TOTAL, stage::UNATTRIBUTED].into_iter().chain(stage::ORDER).collect();
        let (series, means, episodes) = tokio::try_join!(
            store.series(run.number, &main, points),
            store.stage_means(run.number, &names, points),
            store.episodes(run.number),
        )?;
        all.insert(run.number, RunCourse { series, means, episodes });
    }
    Ok(all)
}

/// Returns the runs that are drawn, all on the same axes; `None` where nothing is known of any.
pub(crate) fn over_time(comparison: &Comparison, courses: &RunCourses) -> Option<OverTime> {
    let (chosen, of) = drawn(comparison);
    let known = chosen.into_iter().filter_map(|(one, run, name)| {
        let course = courses.get(&run.number)?;
        let points = course.series.stages.iter().map(|stage| stage.points.len()).max().unwrap_or_default();
        (points >= FEWEST_POINTS).then_some(())?;
        Some((one, run, &course.episodes, data(one, run, &name, course)))
    });
    let (runs, all): (Vec<_>, Vec<(String, StagesOverTime)>) =
        known.map(|(one, run, episodes, data)| ((one, run, episodes), data)).unzip();
    let (labels, all): (Vec<String>, Vec<StagesOverTime>) = all.into_iter().unzip();
    let axes = OverTimeAxes::of(&all)?;
    let picture = |(((one, run, episodes), data), label): (
        (&(&Configuration, &RunSummary, &Episodes), &StagesOverTime),
        &String,
    )| {
        let beyond = match axes.beyond(data) {
            0 => None,
            beyond => Some(format!("{} beyond ↑", counted(beyond, "mean", "means"))),
        };
        let is_short = axes.is_short(data) || data.length < data.width * FEW;
        let short = is_short.then(|| lasted(run, episodes)).flatten();
        let width = Some(points_of(data.width));
        let said = [episodes::said(episodes), episodes::unanswered(episodes, run), width, short, beyond];
        RunPicture {
            run: run.number,
            name: one.name.clone(),
            said: said.into_iter().flatten().collect::<Vec<_>>().join(", "),
            picture: Picture::of_plot(&data.plot(&axes), "course", label),
        }
    };
    Some(OverTime {
        runs: runs.iter().zip(&all).zip(&labels).map(picture).collect(),
        unit: axes.unit(),
        legend: Picture::of_legend(&OverTimeAxes::legend(&all), "key plain"),
        of,
        missing: without_answer(comparison),
    })
}

/// Returns `5.3 ms from first to last start`; `None` of a single iteration, and where the clock was set back.
fn lasted(run: &RunSummary, episodes: &Episodes) -> Option<String> {
    let seconds = (run.last_iteration? - episodes.first.unwrap_or(run.started)).seconds();
    let said = if seconds < 1.0 { duration(seconds).to_string() } else { length(seconds) };
    (seconds > 0.0).then(|| format!("{said} from first to last start"))
}

/// Returns `points of 10 s`.
fn points_of(seconds: f64) -> String {
    let (count, unit) = match seconds as u64 {
        hours if hours >= 3_600 => (hours / 3_600, "h"),
        minutes if minutes >= 60 => (minutes / 60, "min"),
        seconds => (seconds, "s"),
    };
    format!("points of {count}\u{202f}{unit}")
}

/// Returns a run in words, and in seconds since its first iteration.
fn data(one: &Configuration, run: &RunSummary, name: &Name, course: &RunCourse) -> (String, StagesOverTime) {
    let RunCourse { series, means, episodes } = course;
    let points: &[SeriesPoint] = series.stages.first().map_or(&[], |stage| &stage.points);
    let width = f64::from(series.bucket_s.max(1));
    let begun = episodes.first.unwrap_or(run.started);
    let since = |at: WallTime| (at - begun).seconds();
    let last = points.last().map_or(0.0, |point| since(point.at));
    // A clock that was set back ends before it began.
    let lasted = run.last_iteration.map_or(0.0, since).max(last).max(width.min(1.0));
    let inside = |at: &WallTime| (0.0..=lasted).contains(&since(*at));
    let mean = |name: &str, at: WallTime| -> Option<&MeanBucket> {
        let buckets = &means.iter().find(|known| known.stage == *name)?.buckets;
        buckets.binary_search_by_key(&at, |bucket| bucket.at).ok().and_then(|found| buckets.get(found))
    };
    let bucket = |point: &SeriesPoint| {
        let parts = stack::parts(!one.bounds.is_empty(), |name| {
            mean(name, point.at).map(|known| (known.count, known.mean))
        });
        let alone = || vec![StagePart { name: name.to_string(), seconds: point.mean, bound: None }];
        StageBucket {
            begin: since(point.at),
            median: point.p50,
            p95: point.p95,
            parts: if parts.is_empty() { alone() } else { parts },
        }
    };
    let buckets: Vec<StageBucket> = points.iter().map(bucket).collect();
    let medians = || buckets.iter().map(|bucket| bucket.median);
    let (lo, hi) = medians().fold((f64::INFINITY, 0.0_f64), |(lo, hi), it| (lo.min(it), hi.max(it)));
    let range = if buckets.is_empty() {
        "nothing is kept".to_owned()
    } else {
        format!("medians from {} to {} over {}", duration(lo), duration(hi), length(lasted))
    };
    let more = [episodes::said(episodes), episodes::unanswered(episodes, run)].into_iter().flatten();
    let said: Vec<String> = [range].into_iter().chain(more).collect();
    let label = format!("Run {}, {name} over time: {}", run.number, said.join("; "));
    let data = StagesOverTime {
        length: lasted,
        width,
        buckets,
        borders: episodes.borders.iter().filter(|at| inside(at)).map(|at| since(*at)).collect(),
        warm_up: episodes.warm_up_until.map(since).filter(|until| *until > 0.0),
        unanswered: episodes.unanswered.iter().filter(|at| inside(at)).map(|at| since(*at)).collect(),
        p95: run.total.as_ref().and_then(|total| total.p95),
    };
    (label, data)
}
