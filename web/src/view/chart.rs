//! The last minutes of a pipeline: data for its chart, and a table with means per minute.

use std::collections::BTreeMap;

use peernet_aggregator::{LiveSecond, LiveState, PercentileSeries, PipelineSnapshot};
use peernet_analysis::stage_split::mean_of_groups;
use peernet_analysis::transfer::Transfer;
use peernet_clock::{Direction, WallTime};
use peernet_logger::{Name, stage};
use peernet_statistics::number::{DurationFormat, NONE, count};
use peernet_store::IncidentRow;
use peernet_stream::PlacementKind;
use serde::Serialize;

use super::data::{JsonBlock, RoundedNumber};
use super::incidents::IncidentLine;
use super::place;
use super::speed;
use super::stack::Stack;
use crate::look;
use crate::zone::{Zone, ZonedTime};

/// Reasons why there is no single number for the upward and the downward throughput; `None` for a direction that has a
/// number.
pub(crate) type Obstacles = [Option<&'static str>; 2];

/// An incident on a time axis.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct IncidentMark {
    /// Unix time, milliseconds.
    pub at: i64,
    /// Name of the icon.
    pub sign: &'static str,
    /// Reporting host; the mark is drawn in the charts of this host.
    pub host: String,
    /// The only pipeline that the incident concerns; `None` if it concerns the whole host.
    pub pipeline: Option<String>,
}

impl IncidentMark {
    /// Converts incidents to marks on time axes. Incidents of the aggregator are omitted, because they do not affect measurements.
    pub(crate) fn all(rows: &[IncidentRow]) -> Vec<Self> {
        rows.iter()
            .filter_map(|row| {
                Some(Self {
                    at: row.at.unix_nanos() / 1_000_000,
                    // The icon does not depend on the zone.
                    sign: IncidentLine::new(row, Zone::Utc).sign,
                    host: row.host_name.as_ref()?.to_string(),
                    pipeline: row.pipeline.clone(),
                })
            })
            .collect()
    }
}

/// One chart with its table view.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ChartCard {
    /// `host/pipeline`, the key of the chart's data.
    pub key: String,
    pub name: String,
    pub href: String,
    /// Host of the pipeline, and the host that computes: `cam-2 → rack-a`.
    pub route: String,
    /// Description of the chart in words.
    pub finding: String,
    /// Columns of the table view: the parts of the total that occur, without `unattributed`.
    pub columns: Vec<&'static str>,
    pub minutes: Vec<Minute>,
    data: ChartData,
}

/// One minute of the table view; means in ms.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Minute {
    pub at: ZonedTime,
    pub iterations: String,
    pub stages: Vec<String>,
    pub total: String,
}

/// Data of one chart. The lists in `n`, `means` and `transfers` have an element for each second, beginning with the
/// second `from` (Unix time). A second without a report is `null` in `n`.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct ChartData {
    key: String,
    host: String,
    pipeline: String,
    remote: bool,
    from: i64,
    /// Successful iterations.
    n: Vec<Option<u64>>,
    /// Means of the parts of the total by their names, and of `total`, ms.
    means: BTreeMap<String, Vec<RoundedNumber>>,
    transfers: TransferData,
    p95: PercentileData,
    /// Reasons why a direction has no line.
    obstacles: Obstacles,
    /// CPU and GPU load of the host in percent, as (Unix seconds, value). Empty for a pipeline that sends messages,
    /// whose chart shows throughputs instead.
    cpu: Vec<(i64, RoundedNumber)>,
    gpu: Vec<(i64, RoundedNumber)>,
}

/// For each second: the bytes of the messages whose delay is known, and the sum of these delays in µs. `None` if no
/// delay is known.
// The chart adds up bytes and delays of several seconds before it divides, so the data has no speed of a single second.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct TransferData {
    up: Vec<Option<(RoundedNumber, RoundedNumber)>>,
    down: Vec<Option<(RoundedNumber, RoundedNumber)>>,
}

/// The 95th percentile of `total` in buckets.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct PercentileData {
    /// Length of each bucket, seconds; null while even the longest buckets would hold too few iterations.
    size: Option<u32>,
    /// First second of a bucket (Unix time), and the percentile in ms.
    points: Vec<(i64, RoundedNumber)>,
}

impl PercentileData {
    fn new(series: &PercentileSeries) -> Self {
        let points = series.points.iter().map(|point| (point.at, RoundedNumber(Some(point.p95 * 1e3))));
        Self { size: series.bucket_s, points: points.collect() }
    }
}

#[derive(Serialize)]
struct PageData<'a> {
    charts: Vec<&'a ChartData>,
    marks: &'a [IncidentMark],
}

/// Returns the bytes of the messages whose delay is known, and the sum of these delays in µs; `None` if no delay is
/// known.
fn timed_transfer(transfer: Option<Transfer>) -> Option<(RoundedNumber, RoundedNumber)> {
    let transfer = transfer.filter(|transfer| transfer.speed().is_some())?;
    Some((RoundedNumber(Some(transfer.timed_bytes)), RoundedNumber(Some(transfer.seconds * 1e6))))
}

/// Returns the means that a chart draws: the parts of the total, and the total.
fn drawn_means(second: &LiveSecond) -> impl Iterator<Item = &(Name, f64)> {
    second.parts.iter().chain(second.means.iter().filter(|(name, _)| *name == stage::TOTAL))
}

impl ChartCard {
    pub(crate) fn new(pipeline: &PipelineSnapshot, snapshot: &LiveState, zone: Zone) -> Self {
        let host = pipeline.host_name.to_string();
        let name = pipeline.pipeline.to_string();
        let stack = pipeline.window(10).map(Stack::of_window).unwrap_or_default();
        let has_part = |name: &&str| {
            pipeline.series.iter().flat_map(|second| &second.parts).any(|(part, _)| part == *name)
        };
        let columns: Vec<&'static str> =
            look::parts().filter(has_part).filter(|name| *name != "unattributed").collect();
        Self {
            key: format!("{host}/{name}"),
            href: place::pipeline_href(&host, &name),
            route: place::route(&host, &pipeline.placement),
            finding: format!(
                "Stages of {name} over the last 10 minutes. In the 10 seconds before the page was loaded: {}",
                stack.description((None, None))
            ),
            minutes: minutes(&pipeline.series, &columns, zone),
            columns,
            data: ChartData::new(pipeline, snapshot, host),
            name,
        }
    }

    /// Returns the key of the chart, and the reasons why a direction has no line. The page shows the reasons under the
    /// chart's legend.
    pub(crate) fn obstacles(&self) -> (String, Obstacles) {
        (self.key.clone(), self.data.obstacles)
    }

    /// Returns the JSON block of a page with these charts.
    pub(crate) fn data(cards: &[Self], marks: &[IncidentMark]) -> Result<JsonBlock, serde_json::Error> {
        JsonBlock::new(&PageData { charts: cards.iter().map(|card| &card.data).collect(), marks })
    }
}

impl ChartData {
    fn new(pipeline: &PipelineSnapshot, snapshot: &LiveState, host: String) -> Self {
        let series = &pipeline.series;
        let from = series.first().map_or(0, |second| second.at);
        // The live state keeps the last 600 seconds, so the limit removes none of them.
        let length = series.last().map_or(0, |second| (second.at - from + 1).clamp(0, 600)) as usize;
        let mut data = Self {
            key: format!("{host}/{}", pipeline.pipeline),
            pipeline: pipeline.pipeline.to_string(),
            remote: pipeline.placement.kind == PlacementKind::Remote,
            from,
            n: vec![None; length],
            means: BTreeMap::new(),
            transfers: TransferData { up: vec![None; length], down: vec![None; length] },
            p95: PercentileData::new(&pipeline.total_p95),
            obstacles: Direction::ALL.map(|direction| speed::obstacle_in(series, direction)),
            cpu: Vec::new(),
            gpu: Vec::new(),
            host,
        };
        for second in series {
            let Some(index) = usize::try_from(second.at - from).ok().filter(|index| *index < length) else {
                continue;
            };
            data.n[index] = Some(second.counts.ok);
            data.transfers.up[index] = timed_transfer(second.transfers.up);
            data.transfers.down[index] = timed_transfer(second.transfers.down);
            for (name, seconds) in drawn_means(second) {
                let means = data.means.entry(name.to_string());
                means.or_insert_with(|| vec![RoundedNumber(None); length])[index] =
                    RoundedNumber(Some(seconds * 1e3));
            }
        }
        if !data.remote
            && let Some(host) = snapshot.hosts.iter().find(|host| host.id == pipeline.host)
        {
            let points = |share_of: fn(&peernet_stream::HostMetrics) -> Option<f64>| {
                let measured = host.history.iter().filter(|point| share_of(&point.metrics).is_some());
                measured
                    .map(|point| {
                        (
                            point.at.unix_seconds(),
                            RoundedNumber(share_of(&point.metrics).map(|share| share * 100.0)),
                        )
                    })
                    .collect()
            };
            data.cpu = points(|metrics| metrics.cpu);
            data.gpu = points(|metrics| metrics.gpu);
        }
        data
    }
}

/// Returns the means per minute, newest first, weighted by the successful iterations of each second.
fn minutes(series: &[std::sync::Arc<LiveSecond>], columns: &[&'static str], zone: Zone) -> Vec<Minute> {
    let mut by_minute: BTreeMap<i64, Vec<&LiveSecond>> = BTreeMap::new();
    for second in series {
        by_minute.entry(second.at.div_euclid(60)).or_default().push(second);
    }
    let rows = by_minute.into_iter().rev().map(|(minute, seconds)| {
        // If a second lacks a part of the total, the part took no time in this second, as in the chart.
        let average = |name: &str| {
            let means = seconds.iter().map(|second| {
                let mean = drawn_means(second).find(|(node, _)| node == name).map(|(_, mean)| *mean);
                (second.counts.ok, mean)
            });
            mean_of_groups(means)
        };
        let total = average(&stage::TOTAL);
        let std = None;
        let format = DurationFormat::for_total(total, std);
        let text = |mean: Option<f64>| mean.map_or_else(|| NONE.to_owned(), |mean| format.duration(mean));
        Minute {
            at: zone.moment(WallTime::from_unix_nanos(minute.saturating_mul(60_000_000_000))),
            iterations: count(seconds.iter().map(|second| second.counts.total()).sum()),
            stages: columns.iter().map(|name| text(average(name))).collect(),
            total: text(total),
        }
    });
    rows.collect()
}
