//! Runs of a comparison over time, from stored buckets and single rows. The numbers of buckets and rows are limited for
//! runs of any length.

use std::collections::HashMap;

use futures::{StreamExt, TryStreamExt};
use peernet_analysis::compare::{Latency, LatencyBar};
use peernet_analysis::stage_split::sent_in_part;
use peernet_clock::WallTime;
use peernet_figures::drawing::{OverTimeAxes, StageBucket, StagePart, StagesOverTime};
use peernet_logger::{Name, stage};
use peernet_statistics::number::{self, duration, long_duration};
use peernet_store::{
    DelayAccuracy, Episodes, MeanBucket, RunSummary, Series, SeriesPoint, StageMeans, Store,
};

use super::choice::{ChosenRun, choose_runs, unsuccessful_runs_sentence};
use super::differences::{CONCURRENT_READS, compared_stages};
use super::{Comparison, Configuration};
use crate::error::WebError;
use crate::picture::Picture;
use crate::view::run::number_of_points;
use crate::view::{episodes, stack};

/// Maximum number of points that are requested for a run.
const MAX_POINTS: usize = 100;
/// Minimum number of points of a run that is drawn. The drawn length of a shorter run would be too inexact.
const MIN_DRAWN_POINTS: usize = 3;
/// If a run has fewer points than this, the caption states its length, because the drawn length is inexact by up to one
/// point at each end.
const MIN_EXACT_POINTS: f64 = 5.0;

/// Stored data of a run over time.
#[derive(Clone, Debug)]
pub(crate) struct RunTimeSeries {
    /// Time series of the total, or of `sensing` in a run without a model.
    pub series: Series,
    /// Means of the stages and the total, in the buckets of `series`.
    pub means: Vec<StageMeans>,
    pub episodes: Episodes,
}

/// Data of runs over time, by the number of the run.
pub(crate) type TimeSeriesByRun = HashMap<i64, RunTimeSeries>;

/// Runs over time, side by side.
pub(crate) struct OverTime {
    pub runs: Vec<RunPicture>,
    /// Unit of the horizontal axes.
    pub unit: &'static str,
    pub legend: Picture,
    /// Number of all runs with data; `None` if all of them are drawn.
    pub all_runs: Option<usize>,
    /// A sentence about runs without a successful iteration.
    pub missing: Option<String>,
}

/// One run over time.
pub(crate) struct RunPicture {
    pub run: i64,
    pub name: String,
    pub caption: String,
    pub picture: Picture,
}

/// Chooses the runs that are drawn, each with the drawn quantity: the latency by which all runs are compared, or
/// `sensing` in a run without a model. If not all runs with data are drawn, also returns the number of all runs with data.
fn drawn_runs(comparison: &Comparison) -> (Vec<ChosenRun<'_, Name>>, Option<usize>) {
    choose_runs(comparison, |run| {
        let names = comparison.total_column.latency_names();
        names.into_iter().find(|name| comparison.summary(run.number, name).is_some())
    })
}

/// Reads the time series of the runs that are drawn.
///
/// # Errors
/// Returns an error when the store cannot be read.
pub(crate) async fn run_time_series(
    store: &Store,
    comparison: &Comparison,
) -> Result<TimeSeriesByRun, WebError> {
    let names = &compared_stages();
    let request = |(_, run, name): ChosenRun<'_, Name>| {
        let iterations = comparison.summary(run.number, &name).map_or(0, |summary| summary.count());
        (run.number, [name], number_of_points(iterations, MAX_POINTS))
    };
    let read = |(run, main, points): (i64, [Name; 1], usize)| async move {
        let (series, means, episodes) = tokio::try_join!(
            store.series(run, &main, points),
            store.stage_means(run, names, points),
            store.episodes(run),
        )?;
        Ok((run, RunTimeSeries { series, means, episodes }))
    };
    let runs: Vec<_> = drawn_runs(comparison).0.into_iter().map(request).collect();
    futures::stream::iter(runs).map(read).buffered(CONCURRENT_READS).try_collect().await
}

/// Returns the pictures of the runs that are drawn, all with the same axes; `None` if no run has enough points.
pub(crate) fn over_time(comparison: &Comparison, series_by_run: &TimeSeriesByRun) -> Option<OverTime> {
    let (chosen, all_runs) = drawn_runs(comparison);
    let with_points = chosen.into_iter().filter_map(|(configuration, run, name)| {
        let time_series = series_by_run.get(&run.number)?;
        let points =
            time_series.series.stages.iter().map(|stage| stage.points.len()).max().unwrap_or_default();
        (points >= MIN_DRAWN_POINTS).then_some(())?;
        Some((configuration, run, &time_series.episodes, data(comparison, run, &name, time_series)))
    });
    let (runs, all): (Vec<_>, Vec<(String, StagesOverTime)>) = with_points
        .map(|(configuration, run, episodes, data)| ((configuration, run, episodes), data))
        .unzip();
    let (labels, all): (Vec<String>, Vec<StagesOverTime>) = all.into_iter().unzip();
    let axes = OverTimeAxes::of(&all)?;
    let picture = |(((configuration, run, episodes), data), label): (
        (&(&Configuration, &RunSummary, &Episodes), &StagesOverTime),
        &String,
    )| {
        let beyond = match axes.beyond(data) {
            0 => None,
            beyond => Some(format!("{} beyond ↑", number::counted(beyond as u64, "mean"))),
        };
        let is_short = axes.is_short(data) || data.length < data.width * MIN_EXACT_POINTS;
        let short = is_short.then(|| length_text(run, episodes)).flatten();
        let width = Some(bucket_width_text(data.width));
        let texts = [
            episodes::episode_count_text(episodes),
            episodes::failed_count_text(episodes, run),
            width,
            short,
            beyond,
        ];
        RunPicture {
            run: run.number,
            name: configuration.name.clone(),
            caption: texts.into_iter().flatten().collect::<Vec<_>>().join(", "),
            picture: Picture::of_plot(&data.plot(&axes), "course", label),
        }
    };
    Some(OverTime {
        runs: runs.iter().zip(&all).zip(&labels).map(picture).collect(),
        unit: axes.unit(),
        legend: Picture::of_legend(&OverTimeAxes::legend(&all, comparison.total_column), "key plain"),
        all_runs,
        missing: unsuccessful_runs_sentence(comparison),
    })
}

/// Returns `5.3 ms between the starts of the first and the last iteration`; `None` for a single iteration, or if the
/// clock was set back during the run.
fn length_text(run: &RunSummary, episodes: &Episodes) -> Option<String> {
    let first_iteration = episodes.first.unwrap_or(run.started);
    let seconds = (run.last_iteration? - first_iteration).seconds();
    let length = if seconds < 1.0 { duration(seconds).to_string() } else { long_duration(seconds) };
    (seconds > 0.0).then(|| format!("{length} between the starts of the first and the last iteration"))
}

/// Returns the time that a point of the plot covers, in words: `points of 10 s`.
fn bucket_width_text(seconds: f64) -> String {
    let (count, unit) = match seconds as u64 {
        seconds if seconds >= 3_600 => (seconds / 3_600, "h"),
        seconds if seconds >= 60 => (seconds / 60, "min"),
        seconds => (seconds, "s"),
    };
    format!("points of {count}\u{202f}{unit}")
}

/// Returns the description of a run's plot in words, and its data. Times are in seconds since the first iteration.
fn data(
    comparison: &Comparison,
    run: &RunSummary,
    name: &Name,
    time_series: &RunTimeSeries,
) -> (String, StagesOverTime) {
    let RunTimeSeries { series, means, episodes } = time_series;
    let points: &[SeriesPoint] = series.stages.first().map_or(&[], |stage| &stage.points);
    let width = f64::from(series.bucket_s.max(1));
    let first_iteration = episodes.first.unwrap_or(run.started);
    let since = |at: WallTime| (at - first_iteration).seconds();
    let last = points.last().map_or(0.0, |point| since(point.at));
    // If the clock was set back during the run, the last iteration may start before the first one. The plot is at least
    // one second long.
    let length_s = run.last_iteration.map_or(0.0, since).max(last).max(1.0);
    let is_inside = |at: &WallTime| (0.0..=length_s).contains(&since(*at));
    let mean = |name: &str, at: WallTime| -> Option<&MeanBucket> {
        let buckets = &means.iter().find(|stage| stage.stage == *name)?.buckets;
        buckets.binary_search_by_key(&at, |bucket| bucket.at).ok().and_then(|index| buckets.get(index))
    };
    let statistics = comparison.statistics_by_run.get(&run.number);
    let bounds = [stage::UPLOAD, stage::DOWNLOAD].map(|way| statistics.and_then(|all| all.bound(&way)));
    let sent_messages = DelayAccuracy::sent_messages(&bounds.into_iter().flatten().collect::<Vec<_>>());
    let bucket = |point: &SeriesPoint| {
        // The store has the number of sent messages of the whole run only, so the number of this bucket is estimated.
        let sent_in_bucket = sent_in_part(sent_messages, run.counts.ok, point.count);
        let latency_of = |name: &str| {
            let MeanBucket { count, mean, .. } = *mean(name, point.at)?;
            Some(Latency { mean, std: None, count })
        };
        let bar = LatencyBar::new(comparison.total_column, point.count, sent_in_bucket, latency_of);
        let parts = stack::bar_parts(bar.unwrap_or_default().parts);
        let single_part = || vec![StagePart { name: name.to_string(), seconds: point.mean, bound: None }];
        StageBucket {
            begin: since(point.at),
            median: point.p50,
            p95: point.p95,
            parts: if parts.is_empty() { single_part() } else { parts },
        }
    };
    let buckets: Vec<StageBucket> = points.iter().map(bucket).collect();
    let medians = || buckets.iter().map(|bucket| bucket.median);
    let (lo, hi) =
        medians().fold((f64::INFINITY, 0.0_f64), |(lo, hi), median| (lo.min(median), hi.max(median)));
    let range = if buckets.is_empty() {
        "no statistics are stored".to_owned()
    } else {
        format!("medians from {} to {} over {}", duration(lo), duration(hi), long_duration(length_s))
    };
    let remarks = [episodes::episode_count_text(episodes), episodes::failed_count_text(episodes, run)]
        .into_iter()
        .flatten();
    let parts: Vec<String> = [range].into_iter().chain(remarks).collect();
    let label = format!("Run {}, {name} over time: {}", run.number, parts.join("; "));
    let data = StagesOverTime {
        length: length_s,
        width,
        buckets,
        borders: episodes.borders.iter().filter(|at| is_inside(at)).map(|at| since(*at)).collect(),
        warm_up: episodes
            .warm_up
            .iter()
            .map(|(from, until)| (since(*from).max(0.0), since(*until)))
            // If the clock was set back during a warm-up, the warm-up seems to end before its beginning.
            .filter(|(from, until)| until > from)
            .collect(),
        failed: episodes.failed_starts.iter().filter(|at| is_inside(at)).map(|at| since(*at)).collect(),
        p95: run.total.as_ref().and_then(|total| total.p95),
    };
    (label, data)
}
