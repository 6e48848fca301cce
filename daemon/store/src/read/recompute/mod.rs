//! Judging of a run's one-way delays again, including the exchanges after them.
//!
//! The stored stamps and judgements do not change. The new bounds are the intersection of the bounds from the stored exchanges
//! and of the earlier bounds, so none gets wider. A delay keeps its judgement if nothing can be added: both ends on one
//! clock, near a step, or no samples of that time.

mod clouds;
mod delay_sums;
mod rolling;
mod windows;

use peernet_clock::{DelaySource, Direction, OneWayDelay, RawTime, RelatedClocks, Span, Verdict, WallTime};
use peernet_logger::{RawStamps, Slug, stage};
use sqlx::FromRow;

use self::clouds::{Clouds, EdgeTime};
use self::delay_sums::DelaySums;
use super::{StoredDelay, sql, wall};
use crate::error::StoreError;
use crate::readers::Readers;
use crate::types::{Recomputed, RecomputedStage};

const WHAT: &str = "a run's delays";
/// Number of delays that are read at once.
const PAGE: u32 = 2_000;

/// A stored delay.
#[derive(FromRow)]
struct Row {
    iteration: i64,
    node: i64,
    text: String,
    sent_ns: i64,
    received_ns: Option<i64>,
    raw_ns: Option<i64>,
    source: Option<u8>,
    verdict: Option<u8>,
    sent_raw_ns: Option<i64>,
    received_raw_ns: Option<i64>,
    value: Option<f64>,
    lo: Option<f64>,
    hi: Option<f64>,
    cloud: Option<i64>,
}

/// Width in seconds of the buckets by which a run's times are looked up.
const MINUTE_S: i64 = 60;

/// The edge and the network of a run, and the range of its times.
#[derive(FromRow)]
struct Extent {
    host: i64,
    network: String,
    model: String,
    first_ns: Option<i64>,
    last_ns: Option<i64>,
    first_s: Option<i64>,
    last_s: Option<i64>,
}

impl Extent {
    /// Returns the starts of the earliest and of the latest iteration on the edge's wall clock. They are exact to the minute if
    /// the clock was set back in between.
    fn times(&self) -> (WallTime, WallTime) {
        let nanos = |seconds: i64| seconds.saturating_mul(1_000_000_000);
        let (first, last) = (self.first_ns.unwrap_or(0), self.last_ns.unwrap_or(0));
        let (mut from, mut to) = (first.min(last), first.max(last));
        if let Some(begin) = self.first_s.filter(|begin| nanos(begin + MINUTE_S) <= from) {
            from = nanos(begin);
        }
        if let Some(begin) = self.last_s.filter(|begin| nanos(*begin) > to) {
            to = nanos(begin + MINUTE_S);
        }
        (wall(from), wall(to))
    }
}

/// A delay with its earlier and its new judgement.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RejudgedDelay {
    pub(crate) direction: Direction,
    pub(crate) before: Option<OneWayDelay>,
    pub(crate) after: Option<OneWayDelay>,
    /// The clocks by whose stamps it was judged again; `None` if it keeps its judgement.
    pub(crate) clocks: Option<RelatedClocks>,
}

pub(crate) async fn recompute(readers: &Readers, run: i64) -> Result<Option<Recomputed>, StoreError> {
    let mut stages = [
        (Direction::Up, stage::UPLOAD, DelaySums::default(), DelaySums::default()),
        (Direction::Down, stage::DOWNLOAD, DelaySums::default(), DelaySums::default()),
    ];
    let mut clocks = [false; RelatedClocks::ALL.len()];
    let samples = rejudge_delays(readers, run, |delay| {
        for (known, is_used) in RelatedClocks::ALL.iter().zip(&mut clocks) {
            *is_used |= delay.clocks == Some(*known);
        }
        let of_direction = stages.iter_mut().filter(|(direction, ..)| *direction == delay.direction);
        of_direction.for_each(|(_, _, old, new)| {
            old.add(delay.before.as_ref());
            new.add(delay.after.as_ref());
        });
    })
    .await?;
    let Some(samples) = samples else { return Ok(None) };
    let stages = stages
        .into_iter()
        .filter(|(_, _, old, new)| !old.is_empty() || !new.is_empty())
        .map(|(_, stage, old, new)| RecomputedStage {
            stage,
            before: old.judgement(),
            after: new.judgement(),
        })
        .collect();
    let clocks =
        RelatedClocks::ALL.iter().zip(clocks).filter_map(|(clocks, is_used)| is_used.then_some(*clocks));
    Ok(Some(Recomputed { number: run, samples, clocks: clocks.collect(), stages }))
}

/// Judges the delays of a run on which its statistics are based, and calls `each` with them in the order of iterations and nodes.
/// Returns the number of samples that were used, or `None` for an unknown run.
pub(crate) async fn rejudge_delays(
    readers: &Readers,
    run: i64,
    mut each: impl FnMut(RejudgedDelay),
) -> Result<Option<u64>, StoreError> {
    let extent: Option<Extent> = sqlx::query_as(sql::RUN_EXTENT)
        .bind(run)
        .fetch_optional(&readers.pool())
        .await
        .map_err(readers.failed(WHAT))?;
    let Some(extent) = extent else { return Ok(None) };
    let mut clouds = Clouds::new(readers, (extent.host, &extent.network), extent.times());
    let is_observed = extent.model == Slug::observed().as_str();
    let mut page_ends = (i64::MIN, i64::MIN);
    loop {
        let rows: Vec<Row> = sqlx::query_as(sql::RUN_DELAYS)
            .bind(run)
            .bind(page_ends.0)
            .bind(page_ends.1)
            .bind(PAGE)
            .fetch_all(&readers.pool())
            .await
            .map_err(readers.failed(WHAT))?;
        let Some(last) = rows.last() else { return Ok(Some(clouds.samples())) };
        page_ends = (last.iteration, last.node);
        for row in &rows {
            let direction = if stage::UPLOAD == row.text.as_str() { Direction::Up } else { Direction::Down };
            let before = row.judged()?;
            each(rejudge(&mut clouds, row, (direction, is_observed), before).await?);
        }
    }
}

/// Judges a delay again. Both stamps of an observed system come from receivers, so their difference may be negative.
async fn rejudge(
    clouds: &mut Clouds<'_>,
    row: &Row,
    (direction, is_observed): (Direction, bool),
    before: Option<OneWayDelay>,
) -> Result<RejudgedDelay, StoreError> {
    let unchanged = RejudgedDelay { direction, before, after: before, clocks: None };
    let (Some(cloud), Some(received)) = (row.cloud, row.received_ns.map(WallTime::from_unix_nanos)) else {
        return Ok(unchanged);
    };
    // A stepped delay keeps its verdict: no sample shows that its own exchange was refused.
    if before.is_some_and(|it| it.source == DelaySource::SameClock || it.verdict == Verdict::Stepped) {
        return Ok(unchanged);
    }
    let sent = wall(row.sent_ns);
    let (clocks, stamps) = row.stamps(direction, sent, received);
    let time = match direction {
        Direction::Up => EdgeTime { clocks, at: stamps.sent, wall: sent },
        Direction::Down => EdgeTime { clocks, at: stamps.received, wall: received },
    };
    let Some(relation) = clouds.relation(cloud, time).await? else { return Ok(unchanged) };
    let now = match is_observed {
        true => relation.reception_difference(direction, stamps.sent, stamps.received),
        false => relation.delay(direction, stamps.sent, stamps.received),
    };
    Ok(RejudgedDelay { after: Some(combine(before, now)), clocks: Some(clocks), ..unchanged })
}

/// Combines the earlier and the new judgement.
fn combine(before: Option<OneWayDelay>, now: OneWayDelay) -> OneWayDelay {
    let Some(before) = before else { return now };
    let of_then = before.bounds.filter(|_| before.verdict != Verdict::Inconsistent);
    let (then, of_now) = match (of_then, now.bounds.filter(|_| now.verdict != Verdict::Inconsistent)) {
        (Some(then), Some(of_now)) => (then, of_now),
        (Some(_), None) if now.verdict == Verdict::Unsynchronised => return before,
        _ => return now,
    };
    let Some(bounds) = then.intersection(of_now) else {
        return OneWayDelay { value: None, bounds: None, verdict: Verdict::Inconsistent, ..now };
    };
    let value = now.value.or(before.value).map(|value| value.clamp(bounds.lo, bounds.hi));
    let wide = value.is_none_or(|value| bounds.width() > Span::from_nanos(value.abs().nanos() / 2));
    let verdict = match (before.verdict, now.verdict) {
        (Verdict::Stale, Verdict::Stale) => Verdict::Stale,
        _ if wide => Verdict::Limited,
        _ => Verdict::Ok,
    };
    OneWayDelay { value, bounds: Some(bounds), verdict, ..now }
}

impl Row {
    /// Returns the stamps by which the delay is judged, and their clocks: the free-running clocks if both ends have their stamps, otherwise
    /// the wall clocks. A cloud without raw stamps gave stamps of its wall clock instead.
    fn stamps(&self, direction: Direction, sent: WallTime, received: WallTime) -> (RelatedClocks, RawStamps) {
        let by_wall = RawStamps { sent: RawTime::from_wall(sent), received: RawTime::from_wall(received) };
        let Some((sent, received)) = self.sent_raw_ns.zip(self.received_raw_ns) else {
            return (RelatedClocks::Wall, by_wall);
        };
        let raw = RawStamps { sent: RawTime::from_nanos(sent), received: RawTime::from_nanos(received) };
        let is_of_wall_clock = match direction {
            Direction::Up => raw.received == by_wall.received,
            Direction::Down => raw.sent == by_wall.sent,
        };
        (if is_of_wall_clock { RelatedClocks::RawToWall } else { RelatedClocks::Raw }, raw)
    }

    /// Returns the delay as stored, or `None` if it was never judged.
    fn judged(&self) -> Result<Option<OneWayDelay>, StoreError> {
        let Self { raw_ns, source, verdict, value, .. } = *self;
        StoredDelay { raw_ns, source, verdict, value, bounds: self.lo.zip(self.hi) }.judged(WHAT)
    }
}
