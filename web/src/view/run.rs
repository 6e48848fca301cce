//! What the page of a run shows of the store's answers.

use peernet_aggregator::{Episodes, IterationRow, RunDetail, RunStatistics, Series, StageStatistics};
use peernet_clock::{Verdict, WallTime};
use peernet_report::accuracy::{ACCURACIES, UNKNOWN_LABEL};
use peernet_report::results::SKIPPED_STARTS;
use serde::Serialize;

use super::clocks;
use super::data::{JsonBlock, Short};
use super::episodes;
use super::speed::{self, Way};
use super::stack::Stack;
use crate::look;
use crate::numbers::{NONE, SPACE, count, difference_ms, figure, stage_ms, times, total_ms};
use crate::svg::{Bar, Scale, shown_in};
use crate::zone::{Moment, Zone};

/// Rows of the table of the slowest iterations.
const SLOWEST: usize = 8;

/// What the store says about a run.
pub(crate) struct Stored<'a> {
    pub run: &'a RunDetail,
    pub known: &'a RunStatistics,
    pub series: &'a Series,
    pub slowest: &'a [IterationRow],
    /// The first iterations without an answer.
    pub unanswered: &'a [IterationRow],
    pub episodes: &'a Episodes,
}

/// What was measured beside durations.
pub(crate) struct Other {
    pub name: String,
    pub mean: String,
    pub p50: String,
    pub max: String,
    pub unit: String,
}

/// One bucket of the course over time.
pub(crate) struct Bucket {
    pub at: Moment,
    pub count: String,
    pub mean: String,
    pub p50: String,
    pub p95: String,
}

/// A row of the slowest iterations.
pub(crate) struct Slow {
    pub number: u64,
    pub label: String,
    pub at: Moment,
    pub total: String,
    pub factor: String,
    pub blame: Option<(String, &'static str, String)>,
    pub bar: Bar,
}

/// A row of the iterations without an answer.
pub(crate) struct Unanswered {
    pub number: u64,
    pub label: String,
    pub at: Moment,
    pub outcome: String,
    pub reason: String,
}

/// For the chart over time: milliseconds of Unix time, milliseconds of duration.
#[derive(Serialize)]
struct Data {
    run: i64,
    bucket: u32,
    points: Vec<(i64, Short, Short)>,
    slow: Vec<(i64, Short, &'static str, u64)>,
    gaps: Vec<(i64, i64, u64)>,
    /// When episodes began, but for the first.
    borders: Vec<i64>,
    warm_up: Option<(i64, i64)>,
    /// When iterations without an answer began.
    unanswered: Vec<i64>,
}

impl Stored<'_> {
    /// The first iterations without an answer, and why.
    pub(crate) fn unanswered_rows(&self, zone: Zone) -> Vec<Unanswered> {
        let row = |row: &IterationRow| Unanswered {
            number: row.number,
            label: count(row.number),
            at: zone.moment(row.started),
            outcome: row.outcome.clone(),
            reason: row.reason.clone().unwrap_or_else(|| NONE.to_owned()),
        };
        self.unanswered.iter().map(row).collect()
    }

    /// How many episodes there are, and how much had no answer.
    pub(crate) fn parted(&self) -> Vec<String> {
        let unanswered = episodes::unanswered(self.episodes, &self.run.summary);
        [episodes::said(self.episodes), unanswered].into_iter().flatten().collect()
    }

    /// A scale that holds the slowest iteration.
    pub(crate) fn scale(&self) -> Scale {
        Scale::fit(self.slowest.first().and_then(|row| row.total).unwrap_or(0.0) * 1e3, 5)
    }

    /// The course of the total, bucket by bucket.
    pub(crate) fn buckets(&self, zone: Zone) -> Vec<Bucket> {
        let points = self.series.stages.iter().flat_map(|stage| &stage.points);
        let rows = points.map(|point| Bucket {
            at: zone.moment(point.at),
            count: count(point.count),
            mean: stage_ms(point.mean),
            p50: stage_ms(point.p50),
            p95: point.p95.map_or_else(|| NONE.to_owned(), stage_ms),
        });
        rows.collect()
    }

    /// What was measured beside durations.
    pub(crate) fn others(&self) -> Vec<Other> {
        // What is counted is told above, as a share or a sum: quantiles of counts say little.
        let counts = [SKIPPED_STARTS, UNKNOWN_LABEL].into_iter().chain(ACCURACIES);
        let counted = |stage: &StageStatistics| counts.clone().any(|name| stage.stage == *name);
        let beside = self.known.stages.iter().filter(|stage| stage.unit != "s" && !counted(stage));
        let shown = beside.map(|stage| {
            let (unit, factor) = shown_in(&stage.unit);
            let figures = &stage.figures;
            let text = |value: f64| figure(value * factor);
            let [mean, p50, max] = match self.uncertain_speed(stage) {
                Some(between) => [between, NONE.to_owned(), NONE.to_owned()],
                None => [figures.mean, figures.p50, figures.max].map(text),
            };
            Other { name: stage.stage.to_string(), mean, p50, max, unit }
        });
        shown.collect()
    }

    /// What stands for a throughput whose delay is not known as a figure: its interval, or a dash.
    fn uncertain_speed(&self, stage: &StageStatistics) -> Option<String> {
        let way = [Way::Up, Way::Down].into_iter().find(|way| stage.stage == *way.throughput())?;
        let bound = self.known.bounds.iter().find(|bound| bound.stage == *way.delay())?;
        let verdict = clocks::verdict(bound).filter(|verdict| *verdict != Verdict::Ok)?;
        let delay = self
            .known
            .stages
            .iter()
            .find(|other| other.stage == *way.delay())
            .map(|other| other.figures.mean);
        let half = bound.half_width.filter(|_| verdict == Verdict::Limited).map(|width| width.p50);
        Some(speed::interval(stage.figures.mean, delay, half).unwrap_or_else(|| NONE.to_owned()))
    }

    /// The slowest iterations, on one scale.
    pub(crate) fn slow_rows(&self, zone: Zone) -> Vec<Slow> {
        let scale = self.scale();
        let rows = self.slowest.iter().take(SLOWEST).map(|row| {
            let stack = Stack::of_iteration(row);
            Slow {
                number: row.number,
                label: count(row.number),
                at: zone.moment(row.started),
                total: row.total.map_or_else(|| NONE.to_owned(), total_ms),
                factor: row.factor.map_or_else(|| NONE.to_owned(), times),
                blame: row.blame.as_ref().map(|blame| {
                    let more = difference_ms(blame.value - blame.median);
                    let name = blame.stage.to_string();
                    let look = look::class(&name);
                    (name, look, format!("{more}{SPACE}ms"))
                }),
                bar: Bar::new("thin", String::new(), &stack.parts, &scale).silent(),
            }
        });
        rows.collect()
    }

    /// Data for the chart over time.
    pub(crate) fn data(&self) -> Result<JsonBlock, serde_json::Error> {
        let Self { series, slowest, episodes, .. } = self;
        let milliseconds = |time: WallTime| time.unix_nanos() / 1_000_000;
        let all = |times: &[WallTime]| times.iter().copied().map(milliseconds).collect();
        let warm_up = episodes.first.zip(episodes.warm_up_until).filter(|(from, until)| until > from);
        let points = series.stages.iter().flat_map(|stage| &stage.points).map(|point| {
            (milliseconds(point.at), Short(Some(point.p50 * 1e3)), Short(point.p95.map(|p95| p95 * 1e3)))
        });
        let slow = slowest.iter().map(|row| {
            let blame = row.blame.as_ref().map_or("total", |blame| look::class(blame.stage.as_str()));
            (milliseconds(row.started), Short(row.total.map(|total| total * 1e3)), blame, row.number)
        });
        let gaps = series.gaps.iter().map(|gap| (milliseconds(gap.from), milliseconds(gap.to), gap.count));
        JsonBlock::new(&Data {
            run: self.run.summary.number,
            bucket: series.bucket_s,
            points: points.collect(),
            slow: slow.collect(),
            gaps: gaps.collect(),
            borders: all(&episodes.borders),
            warm_up: warm_up.map(|(from, until)| (milliseconds(from), milliseconds(until))),
            unanswered: all(&episodes.unanswered),
        })
    }
}
