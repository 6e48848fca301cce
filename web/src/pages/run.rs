//! Page of one run: latency by stage, its accuracy, and unusual iterations.

use askama::Template;
use axum::Router;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::routing::get;
use peernet_analysis::accuracy::{ACCURACIES, ACCURACY_TITLES};
use peernet_analysis::actuator_results::ActuatorResults;
use peernet_analysis::outcomes::failed_share;
use peernet_analysis::trust::{MissingCount, Report, TrustInput};
use peernet_figures::drawing::View;
use peernet_logger::stage;
use peernet_statistics::histogram::MAX_BINS;
use peernet_statistics::number::{NONE, SPACE, count, counted, join_ends, percent, rate, share};
use peernet_store::{IterationFilter, RunDetail, RunStatistics, StageStatistics};
use peernet_stream::ExperimentPosition;
use serde::Deserialize;

use super::registration::PageRegistration;
use super::shell::Shell;
use super::{Page, page, path};
use crate::error::WebError;
use crate::parameters::Parameters;
use crate::picture::Picture;
use crate::state::{App, AppState};
use crate::view::chip::Chip;
use crate::view::clocks::ClockCell;
use crate::view::data::JsonBlock;
use crate::view::histogram::histogram;
use crate::view::notes::Note;
use crate::view::run::{Bucket, FailedRow, OtherStatistics, SlowIteration, StoredRun, number_of_points};
use crate::view::runs::End;
use crate::view::stack::Stack;
use crate::view::stages::{StageRow, TOO_FEW, directions};
use crate::view::trust::Trust;
use crate::view::{accuracy, clock_fault, link, place, runs};
use crate::zone::Zone;

/// Registration of this page.
pub(super) const PAGE: PageRegistration =
    PageRegistration { routes: || Router::new().route("/runs/{run}", get(show)), entry: None, topic: None };

/// Maximum number of points of the line over time.
const MAX_POINTS: usize = 240;
/// Number of slowest iterations that are drawn over time.
const DRAWN_SLOWEST: u32 = 40;
/// Maximum number of rows of the table of failed iterations.
const MAX_FAILED: u32 = 8;

/// Reason why a run has no rate.
const NO_LENGTH: &str = "the length of the run is not known: the run has no end yet, the edge's clock was set, or the run stood still";

/// Query parameters.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Query {
    /// Stage whose distribution is shown; `total` unless given.
    stage: Option<String>,
    /// `histogram` or `cumulative`.
    #[serde(with = "ViewName")]
    view: View,
    /// `linear` or `log`.
    scale: CountScale,
}

/// Names of the views in an address.
#[derive(Deserialize)]
#[serde(remote = "View")]
enum ViewName {
    #[serde(rename = "histogram")]
    Counts,
    #[serde(rename = "cumulative")]
    Cumulative,
}

/// The scale of counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum CountScale {
    #[default]
    Linear,
    Log,
}

#[derive(Template)]
#[template(path = "pages/run.html")]
struct Run {
    shell: Shell,
    number: i64,
    pipeline: String,
    facts: Vec<String>,
    clock_fault: Option<Chip>,
    pinned: bool,
    notes: Vec<Note>,
    end: End,
    /// Mean total and its standard deviation, ms.
    lead: (String, Option<String>),
    /// Name, number and unit of each statistic.
    stats: Vec<(&'static str, String, &'static str)>,
    /// Number of measured iterations, and a note on the iterations that this number leaves out.
    iterations: (String, String),
    /// Numbers of lost, timed-out and failed iterations, and their common share.
    lost: (String, String),
    /// Number of missed deadlines, and its share; `None` without a deadline.
    missed: Option<(String, String)>,
    /// Number of skipped starts, and its share; `None` if no start was skipped.
    skipped: Option<(String, String)>,
    clock: ClockCell,
    /// Name of each direction, and the verdict on its delays.
    directions: Vec<(String, Chip)>,
    bar: Picture,
    stages: Vec<StageRow>,
    others: Vec<OtherStatistics>,
    distribution: Distribution,
    /// Length of a bucket of the chart over time, seconds.
    bucket: u32,
    buckets: Vec<Bucket>,
    /// Texts about episodes, failed iterations, and a standstill.
    time_remarks: Vec<String>,
    /// Kinds of marks that the chart over time has.
    marks: MarkKinds,
    /// `true` if any bucket has enough samples for a 95th percentile.
    has_p95: bool,
    /// Axis of the bars of the slowest iterations.
    axis: Picture,
    slowest: Vec<SlowIteration>,
    failed: Vec<FailedRow>,
    trust: Trust,
    experiment: Option<ExperimentPosition>,
    /// Label of each accuracy, its value in percent, and the interval of the value.
    accuracies: Vec<(&'static str, String, String)>,
    actuator: ActuatorNumbers,
    configuration: Vec<(String, String)>,
    /// Configuration of the pipeline as TOML.
    toml: String,
    data: JsonBlock,
}

/// For each kind of mark in the chart over time: `true` if the chart has such marks.
struct MarkKinds {
    episode_borders: bool,
    warm_up: bool,
    failed: bool,
}

/// The selected distribution, and the links that select another distribution or view.
struct Distribution {
    stage: String,
    /// `None` if the run has no measurement of this name.
    plot: Option<Picture>,
    /// Name of each view, the query parameters of its link, and `true` for the selected one.
    views: [(&'static str, String, bool); 2],
    /// Name of each scale, the query parameters of its link, and `true` for the selected one.
    scales: [(&'static str, String, bool); 2],
    /// Query parameters of view and scale. They are appended to the link of a stage, so that the linked page has the same view and scale.
    view_query: String,
}

/// `GET /runs/{run}`.
async fn show(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
    Parameters(query): Parameters<Query>,
) -> Page {
    let number = path(number)?;
    let store = app.store();
    let run = store.run(number).await?;
    let run = run.ok_or_else(|| WebError::NotFound(format!("no run #{number} is stored")))?;
    let stage_name = query.stage.clone().unwrap_or_else(|| stage::TOTAL.to_string());
    let names = [stage::TOTAL];
    let failed_only = IterationFilter { after: 0, limit: MAX_FAILED, failed_only: true };
    let (statistics, stored_histogram, series, slowest, failed, episodes, trust) = tokio::try_join!(
        store.statistics_of(number),
        store.histogram(number, &stage_name, MAX_BINS),
        store.series(number, &names, number_of_points(run.summary.counts.ok, MAX_POINTS)),
        store.slowest_iterations(number, DRAWN_SLOWEST),
        store.iterations(number, &failed_only),
        store.episodes(number),
        store.trust_input(&run),
    )?;
    let plot = stored_histogram.map(|stored| histogram(&stored, query.view, query.scale == CountScale::Log));
    let distribution = Distribution::new(stage_name, plot, &query);
    let stored = StoredRun {
        run: &run,
        statistics: &statistics,
        series: &series,
        slowest: &slowest,
        failed: &failed,
        episodes: &episodes,
        starts: trust.starts,
    };
    page(&assemble(&app, &stored, distribution, &trust)?)
}

impl Distribution {
    fn new(stage: String, plot: Option<Picture>, query: &Query) -> Self {
        let view = |view| if view == View::Cumulative { "cumulative" } else { "histogram" };
        let scale = |scale| if scale == CountScale::Log { "log" } else { "linear" };
        let link = |chosen_view: View, chosen_scale: CountScale| {
            format!("&view={}&scale={}", view(chosen_view), scale(chosen_scale))
        };
        Self {
            views: [View::Counts, View::Cumulative].map(|one| {
                let name = if one == View::Counts { "Histogram" } else { "Cumulative" };
                (name, link(one, query.scale), one == query.view)
            }),
            scales: [CountScale::Linear, CountScale::Log]
                .map(|one| (scale(one), link(query.view, one), one == query.scale)),
            view_query: link(query.view, query.scale),
            stage,
            plot,
        }
    }
}

/// Results of the actuator. Each result has a number, and a text about the episodes or answers that the number covers.
#[derive(Debug, PartialEq)]
struct ActuatorNumbers {
    /// Success rate in percent with its interval; `None` if no success is reported.
    success: Option<(String, String)>,
    /// Return per episode; `None` if no rewards are reported.
    episode_return: Option<(String, String)>,
    /// Number of superseded answers; `None` if there are none.
    superseded: Option<(String, String)>,
}

impl ActuatorNumbers {
    fn new(results: &ActuatorResults, answered: u64) -> Self {
        let episodes = |number: u64| format!("{} with a result", counted(number, "episode"));
        Self {
            success: results.success.map(|found| {
                let (lo, hi) = found.interval;
                let interval = join_ends([share(lo), share(hi)]);
                (share(found.rate), format!("{interval}, {}", episodes(found.episodes)))
            }),
            episode_return: results.episode_return.map(|found| (found.text(), episodes(found.episodes))),
            superseded: (results.superseded > 0).then(|| {
                (count(results.superseded), format!("of {} answers were not acted on", count(answered)))
            }),
        }
    }
}

fn facts(run: &RunDetail, zone: Zone) -> Vec<String> {
    let summary = &run.summary;
    let placement = &summary.placement;
    let mut facts = vec![match summary.end_time() {
        Some(end) => zone.range(summary.started, end),
        None => {
            format!("{}, {}", zone.moment(summary.started).date(), zone.moment(summary.started).time_of_day())
        }
    }];
    facts.push(place::route(summary.host_name.as_str(), placement));
    facts.extend(placement.network.clone());
    facts.push(place::model(placement));
    facts.extend(
        run.facts.iter().find(|(name, _)| name.eq_ignore_ascii_case("load")).map(|(_, load)| load.clone()),
    );
    facts.extend(summary.reason.as_ref().map(ToString::to_string));
    facts
}

fn assemble(
    app: &AppState,
    stored: &StoredRun<'_>,
    distribution: Distribution,
    trust: &TrustInput,
) -> Result<Run, WebError> {
    let StoredRun { run, statistics: RunStatistics { stages, bounds, .. }, series, episodes, .. } = stored;
    let summary = &run.summary;
    let stack = Stack::of_run(stages, bounds);
    let total = summary.total.as_ref();
    let format = stack.duration_format();
    let quantile =
        |value: Option<f64>| value.map_or_else(|| NONE.to_owned(), |seconds| format.duration(seconds));
    let missing = MissingCount::from_gaps(run.gaps.iter().map(|gap| gap.count));
    let (zone, snapshot) = (app.zone, app.live_state());
    let link = link::href_of_placement(&snapshot, summary.host_name.as_str(), &summary.placement);
    // The page needs no link to itself.
    let href = "";
    let delay_notes = Note::delay_notes(summary.pipeline.as_str(), href, link.as_deref(), bounds, |name| {
        stages.iter().find(|stage| stage.stage == *name).map(|stage| stage.statistics)
    });
    Ok(Run {
        shell: Shell::new(app, &snapshot, "/runs", place::run_name(summary)),
        number: summary.number,
        pipeline: summary.pipeline.to_string(),
        facts: facts(run, zone),
        clock_fault: summary.has_clock_fault.then_some(clock_fault::CHIP),
        pinned: summary.pinned,
        notes: trust
            .replayed_latencies()
            .into_iter()
            .map(|latencies| Note::replayed(&latencies))
            .chain(runs::gap_notes(&run.gaps, zone))
            .chain(runs::deleted_iterations_note(summary, app.aggregator.retention()))
            .chain(delay_notes)
            .collect(),
        end: End::of(summary, &snapshot, zone),
        lead: total.map_or((NONE.to_owned(), None), |total| {
            (format.duration(total.mean), total.std.map(|std| format.number(std)))
        }),
        stats: vec![
            ("Median", quantile(total.map(|total| total.p50)), "ms"),
            ("p95", quantile(total.and_then(|total| total.p95)), "ms"),
            ("p99", quantile(total.and_then(|total| total.p99)), "ms"),
            ("Max", quantile(total.map(|total| total.max)), "ms"),
            ("Rate", stored.rate().map_or_else(|| NONE.to_owned(), rate), "/s"),
        ],
        iterations: (
            count(summary.counts.total()),
            format!("{} warm-up left out, {} not recorded", count(summary.warm_up), missing.number()),
        ),
        lost: (
            format!(
                "{}, {}, {}",
                count(summary.counts.lost),
                count(summary.counts.timeout),
                count(summary.counts.failed)
            ),
            failed_share(&summary.counts)
                .map_or_else(|| NONE.to_owned(), |share| format!("{}{SPACE}%", percent(share))),
        ),
        missed: summary
            .misses
            .and_then(|misses| Some((count(misses.missed), misses.text(summary.deadline_s)?))),
        skipped: stored.starts.skipped_text().map(|text| (count(stored.starts.skipped), text)),
        clock: ClockCell::of(summary.placement.kind, bounds),
        directions: directions(bounds),
        bar: stack.full_width_bar("stages big"),
        stages: StageRow::of_run(stages, bounds),
        others: stored.other_statistics(),
        distribution,
        bucket: series.bucket_s,
        buckets: stored.buckets(zone),
        has_p95: series.stages.iter().flat_map(|stage| &stage.points).any(|point| point.p95.is_some()),
        time_remarks: stored.time_remarks(),
        marks: MarkKinds {
            episode_borders: !episodes.borders.is_empty(),
            warm_up: !episodes.warm_up.is_empty(),
            failed: !episodes.failed_starts.is_empty(),
        },
        axis: Picture::milliseconds_axis(&stored.scale(), ""),
        slowest: stored.slow_rows(zone),
        failed: stored.failed_rows(zone),
        trust: Trust::from(&Report::new(trust)),
        experiment: summary.experiment.clone(),
        accuracies: accuracies(stages),
        actuator: ActuatorNumbers::new(&summary.actuator, summary.counts.ok),
        configuration: configuration(run),
        toml: run.configuration.clone(),
        data: stored.data()?,
    })
}

/// Returns the accuracies of the model; empty if samples had no labels.
fn accuracies(stages: &[StageStatistics]) -> Vec<(&'static str, String, String)> {
    let accuracies = ACCURACIES.into_iter().zip(ACCURACY_TITLES).filter_map(|(name, label)| {
        let statistics = stages.iter().find(|stage| stage.stage == *name)?.statistics;
        let (share, interval) = accuracy::texts(&statistics)?;
        Some((label, share, interval))
    });
    accuracies.collect()
}

fn configuration(run: &RunDetail) -> Vec<(String, String)> {
    let mut pairs = run.facts.clone();
    pairs.push(("Edge".to_owned(), run.summary.host_name.to_string()));
    pairs.extend(run.summary.placement.peer.iter().map(|peer| ("Cloud".to_owned(), peer.to_string())));
    pairs.push(("Version".to_owned(), format!("agent {}", run.version)));
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn actuator_results_state_what_they_cover() {
        let none = ActuatorNumbers { success: None, episode_return: None, superseded: None };
        assert_eq!(ActuatorNumbers::new(&ActuatorResults::default(), 9), none);
        let statistics_of = |name: &str| match name {
            "superseded" => Some((12, 1.0, Some(0.0))),
            "episode-success" => Some((263, 81.0 / 263.0, None)),
            "episode-return" => Some((1, 2.5, None)),
            _ => None,
        };
        let found = ActuatorNumbers::new(&ActuatorResults::from_statistics(statistics_of), 1_000);
        let text = |text: &str, words: &str| Some((text.to_owned(), words.to_owned()));
        assert_eq!(found.success, text("30.8", "25.5 – 36.6, 263 episodes with a result"));
        assert_eq!(found.episode_return, text("2.50", "1 episode with a result"));
        assert_eq!(found.superseded, text("12", "of 1,000 answers were not acted on"));
    }
}
