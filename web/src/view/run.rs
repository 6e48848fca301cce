//! View of a stored run.

use peernet_analysis::summary::{Scale, is_reported_as_count};
use peernet_analysis::transfer::DirectionNodes;
use peernet_analysis::trust::Starts;
use peernet_clock::{Direction, WallTime};
use peernet_figures::drawing::StageBar;
use peernet_figures::scale::Scale as AxisScale;
use peernet_logger::stage;
use peernet_statistics::VALUES_PER_POINT;
use peernet_statistics::number::{
    DurationFormat, NONE, SPACE, count, fixed, long_duration, throughput, times,
};
use peernet_store::{Episodes, IterationRow, RunDetail, RunStatistics, Series, StageStatistics};
use serde::Serialize;

use super::data::{JsonBlock, RoundedNumber};
use super::episodes;
use super::speed;
use super::stack::Stack;
use crate::look;
use crate::picture::Picture;
use crate::zone::{Zone, ZonedTime};

/// Maximum number of rows of the table of the slowest iterations.
const MAX_SLOWEST: usize = 8;

/// Stored data of a run.
pub(crate) struct StoredRun<'a> {
    pub run: &'a RunDetail,
    pub statistics: &'a RunStatistics,
    /// Time series of the total alone, and gaps.
    pub series: &'a Series,
    pub slowest: &'a [IterationRow],
    /// The first failed iterations.
    pub failed: &'a [IterationRow],
    pub episodes: &'a Episodes,
    /// Numbers and times of the starts after the warm-up.
    pub starts: Starts,
}

/// Statistics of a quantity that is not a duration.
pub(crate) struct OtherStatistics {
    pub name: String,
    pub mean: String,
    pub p50: String,
    pub max: String,
    pub unit: String,
}

/// Minimum number of points over time that are requested for a run.
const MIN_POINTS: usize = 20;

/// Returns the number of points over time that are requested for a run with this number of iterations: so many that
/// each has enough iterations for a 95th percentile, but at least [`MIN_POINTS`].
pub(crate) fn number_of_points(iterations: u64, max_points: usize) -> usize {
    ((iterations / VALUES_PER_POINT) as usize).clamp(MIN_POINTS, max_points)
}

/// One bucket of the time series of the total.
pub(crate) struct Bucket {
    pub at: ZonedTime,
    pub count: String,
    pub mean: String,
    pub p50: String,
    pub p95: String,
}

/// A row of the slowest iterations.
pub(crate) struct SlowIteration {
    pub number: u64,
    pub number_text: String,
    pub at: ZonedTime,
    pub total: String,
    /// Total as a multiple of the run's median.
    pub factor: String,
    /// The part of the total that exceeds its median most: name, CSS class of its colour, excess.
    pub cause: Option<(String, &'static str, String)>,
    pub bar: Picture,
}

/// A row of the failed iterations.
pub(crate) struct FailedRow {
    pub number: u64,
    pub number_text: String,
    pub at: ZonedTime,
    pub outcome: String,
    pub reason: String,
}

/// Data of the chart over time. Times are Unix times and durations, both in milliseconds.
#[derive(Serialize)]
struct Data {
    run: i64,
    /// Length of a bucket, seconds.
    bucket: u32,
    /// Start of each bucket, with the median and the 95th percentile of the total.
    points: Vec<(i64, RoundedNumber, RoundedNumber)>,
    /// Start of each of the slowest iterations, with its total, the CSS class of its cause, and its number.
    slow: Vec<(i64, RoundedNumber, &'static str, u64)>,
    /// Beginning and end of each gap, and the number of missing events.
    gaps: Vec<(i64, i64, u64)>,
    /// Starts of episodes, without the first.
    borders: Vec<i64>,
    /// Beginning and end of each warm-up.
    warm_up: Vec<(i64, i64)>,
    /// Starts of failed iterations.
    failed: Vec<i64>,
}

impl StoredRun<'_> {
    /// Returns rows of the first failed iterations, with the reasons.
    pub(crate) fn failed_rows(&self, zone: Zone) -> Vec<FailedRow> {
        let row = |row: &IterationRow| FailedRow {
            number: row.number,
            number_text: count(row.number),
            at: zone.moment(row.started),
            // The warm-up is named, because statistics and counts exclude its iterations.
            outcome: {
                let words = row.outcome.display_name();
                if row.warm_up { format!("{words}, warm-up") } else { words.to_owned() }
            },
            reason: row.reason.clone().unwrap_or_else(|| NONE.to_owned()),
        };
        self.failed.iter().map(row).collect()
    }

    /// Returns texts about the number of episodes, the failed iterations, and a standstill.
    pub(crate) fn time_remarks(&self) -> Vec<String> {
        let failed = episodes::failed_count_text(self.episodes, &self.run.summary);
        let standstill = self.starts.times.standstill_s.map(|seconds| {
            format!("no start for {}: the clock was set, or the pipeline stood still", long_duration(seconds))
        });
        [episodes::episode_count_text(self.episodes), failed, standstill].into_iter().flatten().collect()
    }

    /// Returns the starts per second after the warm-up; `None` if the time from the first to the last start is unknown,
    /// as after a standstill.
    pub(crate) fn rate(&self) -> Option<f64> {
        self.starts.actual_hz()
    }

    /// Returns a scale of durations in ms, from zero to at least the total of the slowest iteration.
    pub(crate) fn scale(&self) -> AxisScale {
        let (largest, ticks) = (self.slowest.first().and_then(|row| row.total).unwrap_or(0.0), 5);
        AxisScale::up_to(largest * 1e3, ticks)
    }

    /// Returns the format of the run's tables of durations.
    fn duration_format(&self) -> DurationFormat {
        let total = self.run.summary.total.as_ref();
        DurationFormat::for_total(total.map(|total| total.mean), total.and_then(|total| total.std))
    }

    /// Returns the time series of the total, bucket by bucket.
    pub(crate) fn buckets(&self, zone: Zone) -> Vec<Bucket> {
        let points = self.series.stages.iter().flat_map(|stage| &stage.points);
        let format = self.duration_format();
        let rows = points.map(|point| Bucket {
            at: zone.moment(point.at),
            count: count(point.count),
            mean: format.duration(point.mean),
            p50: format.duration(point.p50),
            p95: point.p95.map_or_else(|| NONE.to_owned(), |p95| format.duration(p95)),
        });
        rows.collect()
    }

    /// Returns the statistics of quantities that are not durations.
    pub(crate) fn other_statistics(&self) -> Vec<OtherStatistics> {
        // A mean of the throughputs of single iterations is not a speed, because small messages count as much as large
        // ones. `transfer_rows` returns the speed.
        let is_throughput = |stage: &StageStatistics| {
            [stage::UPLOAD_THROUGHPUT, stage::DOWNLOAD_THROUGHPUT].contains(&stage.stage)
        };
        let is_other = |stage: &&StageStatistics| {
            stage.unit != "s" && !is_reported_as_count(&stage.stage) && !is_throughput(stage)
        };
        let other_stages = self.statistics.stages.iter().filter(is_other);
        let rows = other_stages.map(|stage| {
            let (statistics, scale) = (&stage.statistics, Scale::for_unit(&stage.unit));
            // All numbers of a row have the same decimals, as in the summary of a result folder.
            let decimals = scale.decimals(statistics.p50);
            let [mean, p50, max] = [statistics.mean, statistics.p50, statistics.max]
                .map(|value| fixed(value * scale.factor(), decimals));
            let unit = scale.symbol(&stage.unit).to_owned();
            OtherStatistics { name: stage.stage.to_string(), mean, p50, max, unit }
        });
        rows.chain(self.transfer_rows()).collect()
    }

    /// Returns two rows for each direction in which messages were sent: the speed while sending, and the traffic.
    fn transfer_rows(&self) -> Vec<OtherStatistics> {
        let RunStatistics { stages, bounds, .. } = self.statistics;
        let transfers = self.statistics.transfers();
        let row = |name, value: Option<String>| OtherStatistics {
            name,
            mean: value.unwrap_or_else(|| NONE.to_owned()),
            p50: NONE.to_owned(),
            max: NONE.to_owned(),
            unit: "MB/s".to_owned(),
        };
        let directions = Direction::ALL.into_iter();
        let sent = directions.filter_map(|direction| Some((direction, transfers.of(direction)?)));
        sent.flat_map(|(direction, transfer)| {
            let name = &DirectionNodes::of(direction).delay;
            let traffic = self.starts.measured_seconds().and_then(|seconds| transfer.traffic(seconds));
            let delay = stages.iter().find(|stage| stage.stage == *name);
            let delay = delay.map(|stage| &stage.statistics);
            let speed = speed::text(&transfers, bounds, direction, delay);
            [
                row(format!("{name}: speed while sending"), speed),
                row(format!("{name}: traffic"), traffic.map(throughput)),
            ]
        })
        .collect()
    }

    /// Returns the slowest iterations, on one scale.
    pub(crate) fn slow_rows(&self, zone: Zone) -> Vec<SlowIteration> {
        let (scale, format) = (self.scale(), self.duration_format());
        let rows = self.slowest.iter().take(MAX_SLOWEST).map(|row| {
            let stack = Stack::of_iteration(row);
            let bar = StageBar { has_values: false, ..StageBar::new(&stack.parts, scale) };
            let no_label = "";
            SlowIteration {
                number: row.number,
                number_text: count(row.number),
                at: zone.moment(row.started),
                total: row.total.map_or_else(|| NONE.to_owned(), |total| format.duration(total)),
                factor: row.factor.map_or_else(|| NONE.to_owned(), times),
                cause: row.causes.first().map(|cause| {
                    let more = format.difference(cause.excess());
                    let name = cause.name.to_string();
                    let css_class = look::class(&name);
                    (name, css_class, format!("{more}{SPACE}ms"))
                }),
                bar: Picture::of_items(&bar.items(), "stages thin", no_label),
            }
        });
        rows.collect()
    }

    /// Returns the data of the chart over time.
    pub(crate) fn data(&self) -> Result<JsonBlock, serde_json::Error> {
        let Self { series, slowest, episodes, .. } = self;
        let milliseconds = |time: WallTime| time.unix_nanos() / 1_000_000;
        let all = |times: &[WallTime]| times.iter().copied().map(milliseconds).collect();
        // If the clock was set back during a warm-up, the warm-up seems to end before its beginning. The chart leaves
        // out such a warm-up.
        let warm_up = episodes.warm_up.iter().filter(|(from, until)| until > from);
        let points = series.stages.iter().flat_map(|stage| &stage.points).map(|point| {
            (
                milliseconds(point.at),
                RoundedNumber(Some(point.p50 * 1e3)),
                RoundedNumber(point.p95.map(|p95| p95 * 1e3)),
            )
        });
        let slow = slowest.iter().map(|row| {
            let css_class = row.causes.first().map_or("total", |cause| look::class(cause.name.as_str()));
            (
                milliseconds(row.started),
                RoundedNumber(row.total.map(|total| total * 1e3)),
                css_class,
                row.number,
            )
        });
        let gaps = series.gaps.iter().map(|gap| (milliseconds(gap.from), milliseconds(gap.to), gap.count));
        JsonBlock::new(&Data {
            run: self.run.summary.number,
            bucket: series.bucket_s,
            points: points.collect(),
            slow: slow.collect(),
            gaps: gaps.collect(),
            borders: all(&episodes.borders),
            warm_up: warm_up.map(|(from, until)| (milliseconds(*from), milliseconds(*until))).collect(),
            failed: all(&episodes.failed_starts),
        })
    }
}

#[cfg(test)]
mod tests;
