//! Links and their clock samples.

mod assumptions;
mod bucket;
mod repeats;

use std::iter::successors;

use futures::TryStreamExt;
use peernet_analysis::clock_points::bucket_number;
use peernet_clock::{DelaySource, Interval, Offset, RelatedClocks, Span, Verdict, WallTime};
use peernet_statistics::BUCKET_WIDTHS_S;
use peernet_stream::{DelayPoint, DelaySecond, ProbeCounts, RoundTrip};
use serde::Deserialize;
use sqlx::FromRow;

pub(super) use self::assumptions::PeriodAssumptions;
pub(crate) use self::assumptions::link_assumptions;
use self::bucket::Bucket;
use self::repeats::RepeatedTimes;
use super::{corrupt_data, count, parse, sql, value_of_number, wall};
use crate::error::StoreError;
use crate::readers::Readers;
use crate::stored::ClockPoint;
use crate::types::{ClockSeries, LinkKey, LinkRow};
use crate::write::UNKNOWN;

/// Name of the requested data in errors.
const WHAT: &str = "clock samples";
/// Maximum number of points in one answer.
const MAX_POINTS: u32 = 10_000;

/// A link as stored, with the times of its first and last clock samples.
#[derive(FromRow)]
struct StoredLink {
    edge: String,
    edge_name: Option<String>,
    cloud: String,
    cloud_name: String,
    network: String,
    first_ns: Option<i64>,
    last_ns: Option<i64>,
}

/// One clock sample, which describes one second. In JSON, it is an array in the order of the fields.
#[derive(FromRow, Deserialize)]
struct Row {
    at_ns: i64,
    #[sqlx(rename = "window")]
    relation_period: i64,
    offset_ns: Option<i64>,
    offset_lo_ns: Option<i64>,
    offset_hi_ns: Option<i64>,
    offset_source: Option<u8>,
    offset_verdict: Option<u8>,
    offset_sources: Option<String>,
    skew_ppm: Option<f64>,
    exchanges: Option<i64>,
    age_ns: Option<i64>,
    probes_sent: u32,
    probes_answered: u32,
    probes_lost: u32,
    probes_refused: u32,
    round_trip_min_ns: Option<i64>,
    round_trip_median_ns: Option<i64>,
    up_count: Option<u32>,
    up_ns: Option<i64>,
    up_lo_ns: Option<i64>,
    up_hi_ns: Option<i64>,
    up_bits_per_second: Option<f64>,
    up_verdict: Option<u8>,
    down_count: Option<u32>,
    down_ns: Option<i64>,
    down_lo_ns: Option<i64>,
    down_hi_ns: Option<i64>,
    down_bits_per_second: Option<f64>,
    down_verdict: Option<u8>,
    clocks: Option<u8>,
    proven_skew_min_ppm: Option<f64>,
    proven_skew_max_ppm: Option<f64>,
    #[sqlx(rename = "grown_window_ns")]
    oldest_exchange_age_ns: Option<i64>,
}

pub(crate) async fn links(readers: &Readers) -> Result<Vec<LinkRow>, StoreError> {
    const WHAT: &str = "links";
    let rows: Vec<StoredLink> =
        sqlx::query_as(sql::LINKS).fetch_all(&readers.pool()).await.map_err(readers.error_for(WHAT))?;
    let mut links = Vec::with_capacity(rows.len());
    for row in rows {
        // A link whose samples have all been deleted has no range of times and is left out.
        let (Some(first), Some(last)) = (row.first_ns, row.last_ns) else { continue };
        links.push(LinkRow {
            edge: parse(WHAT, &row.edge)?,
            edge_name: parse(WHAT, row.edge_name.as_deref().unwrap_or(UNKNOWN))?,
            cloud: parse(WHAT, &row.cloud)?,
            cloud_name: parse(WHAT, &row.cloud_name)?,
            network: parse(WHAT, &row.network)?,
            first: wall(first),
            last: wall(last),
        });
    }
    Ok(links)
}

/// Returns the row of a link; `None` for an unknown link.
async fn link_id(
    readers: &Readers,
    LinkKey { edge, cloud, network }: &LinkKey,
) -> Result<Option<i64>, StoreError> {
    sqlx::query_scalar(sql::LINK)
        .bind(edge.to_string())
        .bind(cloud.to_string())
        .bind(network.as_str())
        .fetch_optional(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))
}

pub(crate) async fn series(
    readers: &Readers,
    key: &LinkKey,
    (from, to): (WallTime, WallTime),
    max_points: u32,
) -> Result<ClockSeries, StoreError> {
    let empty_series = ClockSeries { bucket_s: BUCKET_WIDTHS_S[0], points: Vec::new() };
    let Some(link) = link_id(readers, key).await? else { return Ok(empty_series) };
    // The width is computed from the times of the stored samples. The requested times may be much further apart.
    let extent: (Option<i64>, Option<i64>) = sqlx::query_as(sql::CLOCK_EXTENT)
        .bind(link)
        .bind(from.unix_nanos())
        .bind(to.unix_nanos())
        .fetch_one(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    let (Some(first), Some(last)) = extent else { return Ok(empty_series) };
    let width_s = bucket_width_s(first, last, max_points.clamp(1, MAX_POINTS));
    let repeats = RepeatedTimes::read(readers, link, (first, last)).await?;
    let mut points = Points { width_s, repeats, points: Vec::new(), bucket: None };
    let pool = readers.pool();
    // Each bucket of one second is one row, so the query needs no ranges.
    if width_s == 1 {
        let rows = sqlx::query_as::<_, Row>(sql::CLOCK_SAMPLES).bind(link).bind(first).bind(last);
        let mut rows = rows.fetch(&pool);
        while let Some(row) = rows.try_next().await.map_err(readers.error_for(WHAT))? {
            points.add(&row)?;
        }
    } else {
        let ranges = bucket_ranges(first, last, width_s)?;
        let buckets = sqlx::query_scalar::<_, String>(sql::CLOCK_BUCKETS).bind(link).bind(ranges);
        let mut buckets = buckets.fetch(&pool);
        while let Some(bucket) = buckets.try_next().await.map_err(readers.error_for(WHAT))? {
            let mut rows: Vec<Row> =
                serde_json::from_str(&bucket).map_err(|error| corrupt_data(WHAT, error))?;
            // SQLite does not guarantee the order of the rows within an aggregate function.
            rows.sort_by_key(|row| (row.at_ns, row.relation_period));
            rows.iter().try_for_each(|row| points.add(row))?;
        }
    }
    Ok(ClockSeries { bucket_s: width_s, points: points.into_points() })
}

/// Returns the first and the last time of each bucket, as JSON. A query that returns one row per bucket costs far less
/// than a query that returns one row per second.
fn bucket_ranges(first: i64, last: i64, width_s: u32) -> Result<String, StoreError> {
    let width_ns = i64::from(width_s) * 1_000_000_000;
    let mut from = first;
    let ranges = (bucket_number_of(first, width_s)..=bucket_number_of(last, width_s)).map(|number| {
        let through = number.saturating_add(1).saturating_mul(width_ns).min(last);
        [std::mem::replace(&mut from, through.saturating_add(1)), through]
    });
    let ranges: Vec<[i64; 2]> = ranges.collect();
    serde_json::to_string(&ranges).map_err(|error| corrupt_data(WHAT, error))
}

/// Collects clock samples into points.
struct Points {
    /// Width of a bucket, seconds.
    width_s: u32,
    repeats: RepeatedTimes,
    points: Vec<ClockPoint>,
    /// The bucket of the newest clock sample, which becomes the next point.
    bucket: Option<Bucket>,
}

impl Points {
    /// Adds the next clock sample.
    fn add(&mut self, row: &Row) -> Result<(), StoreError> {
        // If the edge's wall clock was set back, two relation periods have samples of the same times. Only the later
        // relation period is used.
        if self.repeats.is_superseded(row.relation_period, row.at_ns) {
            return Ok(());
        }
        let number = bucket_number_of(row.at_ns, self.width_s);
        if self.bucket.as_ref().is_some_and(|bucket| bucket.number() != number) {
            self.finish();
        }
        self.bucket.get_or_insert_with(|| Bucket::new(number)).add(row)
    }

    /// Converts the current bucket to a point.
    fn finish(&mut self) {
        let point = self.bucket.take().and_then(|bucket| bucket.point(self.width_s));
        self.points.extend(point);
    }

    fn into_points(mut self) -> Vec<ClockPoint> {
        self.finish();
        self.points
    }
}

/// Returns the smallest width of a bucket, in seconds, with which the range has at most
/// `max_points` buckets. The possible widths are [`BUCKET_WIDTHS_S`]; after the last of these
/// widths, each width is twice the previous width.
fn bucket_width_s(first: i64, last: i64, max_points: u32) -> u32 {
    let [.., day] = BUCKET_WIDTHS_S;
    let wider_widths = successors(day.checked_mul(2), |width_s| width_s.checked_mul(2));
    let fits = |width_s: &u32| {
        u64::try_from(bucket_number_of(last, *width_s) - bucket_number_of(first, *width_s))
            .is_ok_and(|difference| difference < u64::from(max_points))
    };
    let mut widths = BUCKET_WIDTHS_S.into_iter().chain(wider_widths.clone());
    widths.find(fits).or_else(|| wider_widths.last()).unwrap_or(day)
}

/// Returns the number of the bucket that contains a clock sample, counted from 1970. `at_ns` is the end of the second
/// that the sample describes.
fn bucket_number_of(at_ns: i64, width_s: u32) -> i64 {
    bucket_number(wall(at_ns), width_s)
}

impl Row {
    /// Returns the point of this row, without its offset.
    fn point_without_offset(&self) -> Result<ClockPoint, StoreError> {
        Ok(ClockPoint {
            at: wall(self.at_ns),
            relation_period: self.relation_period.cast_unsigned(),
            offset: None,
            probes: self.probes(),
            round_trip: self.round_trip(),
            up: self.up()?,
            down: self.down()?,
            clocks: self.clocks()?,
            proven_skew_ppm: self.proven_skew_min_ppm.zip(self.proven_skew_max_ppm),
            oldest_exchange_age: self.oldest_exchange_age_ns.map(Span::from_nanos),
        })
    }

    fn clocks(&self) -> Result<RelatedClocks, StoreError> {
        self.clocks
            // Agents before 0.3.0 sent no number, because they related only wall clocks.
            .map_or(Ok(RelatedClocks::Wall), |number| value_of_number(WHAT, RelatedClocks::ALL, number))
    }

    fn bounds(&self) -> Option<Interval> {
        interval(self.offset_lo_ns, self.offset_hi_ns)
    }

    const fn probes(&self) -> ProbeCounts {
        ProbeCounts {
            sent: self.probes_sent,
            answered: self.probes_answered,
            lost: self.probes_lost,
            refused: self.probes_refused,
        }
    }

    fn round_trip(&self) -> Option<RoundTrip> {
        let (min, median) = self.round_trip_min_ns.zip(self.round_trip_median_ns)?;
        Some(RoundTrip { min: Span::from_nanos(min), median: Span::from_nanos(median) })
    }

    fn up(&self) -> Result<Option<DelaySecond>, StoreError> {
        let median = (self.up_ns, self.up_lo_ns, self.up_hi_ns, self.up_bits_per_second);
        delays((self.up_count, self.up_verdict), median)
    }

    fn down(&self) -> Result<Option<DelaySecond>, StoreError> {
        let median = (self.down_ns, self.down_lo_ns, self.down_hi_ns, self.down_bits_per_second);
        delays((self.down_count, self.down_verdict), median)
    }

    fn offset(&self) -> Result<Option<Offset>, StoreError> {
        let (Some(estimate), Some(bounds), Some(source), Some(verdict)) =
            (self.offset_ns, self.bounds(), self.offset_source, self.offset_verdict)
        else {
            return Ok(None);
        };
        let source = value_of_number(WHAT, DelaySource::ALL, source)?;
        // The column is NULL if there is only one source. The interval of this source is the interval of the offset.
        let sources = match &self.offset_sources {
            Some(json) => sources(json)?,
            None => vec![(source, bounds)],
        };
        Ok(Some(Offset {
            at: wall(self.at_ns),
            estimate: Span::from_nanos(estimate),
            bounds,
            source,
            sources,
            verdict: value_of_number(WHAT, Verdict::ALL, verdict)?,
            skew_ppm: self.skew_ppm,
            exchanges: count(self.exchanges.unwrap_or(0)),
            age: self.age_ns.map(Span::from_nanos),
        }))
    }
}

/// Parses the column `offset_sources`: the interval that each source alone gives.
pub(super) fn sources(json: &str) -> Result<Vec<(DelaySource, Interval)>, StoreError> {
    let rows: Vec<(String, i64, i64)> =
        serde_json::from_str(json).map_err(|error| corrupt_data(WHAT, error))?;
    rows.into_iter()
        .map(|(name, lo, hi)| {
            let source = DelaySource::from_name(&name);
            let source = source.ok_or_else(|| corrupt_data(WHAT, format_args!("source {name:?}")))?;
            Ok((source, Interval { lo: Span::from_nanos(lo), hi: Span::from_nanos(hi) }))
        })
        .collect()
}

fn interval(lo: Option<i64>, hi: Option<i64>) -> Option<Interval> {
    lo.zip(hi).map(|(lo, hi)| Interval { lo: Span::from_nanos(lo), hi: Span::from_nanos(hi) })
}

/// Median delay, lower bound and upper bound of this delay, nanoseconds, and data rate, bits per second.
type Median = (Option<i64>, Option<i64>, Option<i64>, Option<f64>);

fn delays(
    (count, verdict): (Option<u32>, Option<u8>),
    (value, lo, hi, bits_per_second): Median,
) -> Result<Option<DelaySecond>, StoreError> {
    let Some((count, verdict)) = count.zip(verdict) else { return Ok(None) };
    let median = value.zip(interval(lo, hi)).map(|(value, bounds)| DelayPoint {
        value: Span::from_nanos(value),
        bounds,
        bits_per_second,
    });
    Ok(Some(DelaySecond { count, median, verdict: value_of_number(WHAT, Verdict::ALL, verdict)? }))
}
