//! Judges a run's one-way delays again, from all exchanges, including exchanges after the delays.
//!
//! The stored stamps and judgements do not change. The new bounds are the intersection of the earlier bounds and of the
//! bounds from the stored exchanges, so no interval gets wider. A delay keeps its judgement if both hosts read the same
//! clock, if a clock was stepped near the delay, or if no clock samples of its time are stored.

mod clouds;
mod delay_sums;
mod relation_periods;
mod rolling;

use peernet_analysis::transfer::DirectionNodes;
use peernet_clock::{DelaySource, Direction, OneWayDelay, RawTime, RelatedClocks, Verdict, WallTime};
use peernet_logger::{RawStamps, Slug, stage};
use peernet_stream::NetworkName;
use sqlx::FromRow;

use self::clouds::{Clouds, EdgeTime};
use self::delay_sums::DelaySums;
use super::{StoredDelay, sql, wall};
use crate::error::StoreError;
use crate::readers::Readers;
use crate::types::{RecomputedDelays, RecomputedStage};

/// Name of the requested data in errors.
const WHAT: &str = "a run's delays";
/// Number of delays that are read at a time.
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

/// The properties of a run from which its delays are judged again: edge, network, model, and the range of its times.
#[derive(FromRow)]
struct RunContext {
    host: i64,
    network: String,
    model: String,
    // Starts of the first and of the last iteration.
    first_ns: Option<i64>,
    last_ns: Option<i64>,
    // Starts of the earliest and of the latest minute with successful iterations.
    first_s: Option<i64>,
    last_s: Option<i64>,
}

impl RunContext {
    /// Returns the starts of the earliest and of the latest iteration on the edge's wall clock. If the clock was set
    /// back during the run, both times are exact to the minute only.
    fn times(&self) -> (WallTime, WallTime) {
        let nanos = |seconds: i64| seconds.saturating_mul(1_000_000_000);
        let (first, last) = (self.first_ns.unwrap_or(0), self.last_ns.unwrap_or(0));
        let (mut from, mut to) = (first.min(last), first.max(last));
        if let Some(minute_s) = self.first_s.filter(|minute_s| nanos(minute_s + MINUTE_S) <= from) {
            from = nanos(minute_s);
        }
        if let Some(minute_s) = self.last_s.filter(|minute_s| nanos(*minute_s) > to) {
            to = nanos(minute_s + MINUTE_S);
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
    /// The clocks by whose stamps the delay was judged again; `None` if the delay keeps its judgement.
    pub(crate) clocks: Option<RelatedClocks>,
}

pub(crate) async fn recompute(readers: &Readers, run: i64) -> Result<Option<RecomputedDelays>, StoreError> {
    let mut stages = Direction::ALL.map(|direction| (direction, DelaySums::default(), DelaySums::default()));
    let mut used_clocks = [false; RelatedClocks::ALL.len()];
    let samples = rejudge_delays(readers, run, |delay| {
        for (clocks, is_used) in RelatedClocks::ALL.iter().zip(&mut used_clocks) {
            *is_used |= delay.clocks == Some(*clocks);
        }
        let stage = stages.iter_mut().filter(|(direction, ..)| *direction == delay.direction);
        stage.for_each(|(_, old, new)| {
            old.add(delay.before.as_ref());
            new.add(delay.after.as_ref());
        });
    })
    .await?;
    let Some(samples) = samples else { return Ok(None) };
    let stages = stages
        .into_iter()
        .filter(|(_, old, new)| !old.is_empty() || !new.is_empty())
        .map(|(direction, old, new)| RecomputedStage {
            stage: DirectionNodes::of(direction).delay.clone(),
            before: old.judgement(),
            after: new.judgement(),
        })
        .collect();
    let clocks = RelatedClocks::ALL.iter().zip(used_clocks);
    let clocks = clocks.filter_map(|(clocks, is_used)| is_used.then_some(*clocks));
    Ok(Some(RecomputedDelays { number: run, samples, clocks: clocks.collect(), stages }))
}

/// Judges again the delays that a run's statistics include, and calls `each` with every delay in the order of
/// iterations and nodes. Returns the number of clock samples that were used, or `None` for an unknown run.
pub(crate) async fn rejudge_delays(
    readers: &Readers,
    run: i64,
    mut each: impl FnMut(RejudgedDelay),
) -> Result<Option<u64>, StoreError> {
    let run_context: Option<RunContext> = sqlx::query_as(sql::RUN_EXTENT)
        .bind(run)
        .bind(NetworkName::default().as_str())
        .fetch_optional(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    let Some(run_context) = run_context else { return Ok(None) };
    let mut clouds = Clouds::new(readers, (run_context.host, &run_context.network), run_context.times());
    // The pipeline of an observed system has a fixed model name.
    let is_observed = run_context.model == Slug::observed().as_str();
    // Iteration and node of the last delay that was read.
    let mut last_delay = (i64::MIN, i64::MIN);
    loop {
        let rows: Vec<Row> = sqlx::query_as(sql::RUN_DELAYS)
            .bind(run)
            .bind(last_delay.0)
            .bind(last_delay.1)
            .bind(PAGE)
            .fetch_all(&readers.pool())
            .await
            .map_err(readers.error_for(WHAT))?;
        // Delays are read in pages, so that memory is limited and no read transaction lasts long.
        let Some(last) = rows.last() else { return Ok(Some(clouds.samples())) };
        last_delay = (last.iteration, last.node);
        for row in &rows {
            let direction = if stage::UPLOAD == row.text.as_str() { Direction::Up } else { Direction::Down };
            let before = row.delay()?;
            each(rejudge(&mut clouds, row, (direction, is_observed), before).await?);
        }
    }
}

/// Judges a delay again. In an observed system, both stamps are times at which a topic's message was received, so their
/// difference may be negative.
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
    // A delay with the verdict `Stepped` keeps this verdict. The agent may have noticed the step by an exchange that it
    // refused, and clock samples do not contain refused exchanges.
    if before.is_some_and(|delay| delay.source == DelaySource::SameClock || delay.verdict == Verdict::Stepped)
    {
        return Ok(unchanged);
    }
    let sent = wall(row.sent_ns);
    let (clocks, stamps) = row.stamps(direction, sent, received);
    let time = match direction {
        Direction::Up => EdgeTime { clocks, at: stamps.sent, wall: sent },
        Direction::Down => EdgeTime { clocks, at: stamps.received, wall: received },
    };
    let Some(relation) = clouds.relation(cloud, time).await? else { return Ok(unchanged) };
    let after = match is_observed {
        true => relation.reception_difference(direction, stamps.sent, stamps.received),
        false => relation.delay(direction, stamps.sent, stamps.received),
    };
    Ok(RejudgedDelay { after: Some(combine(before, after)), clocks: Some(clocks), ..unchanged })
}

/// Combines the earlier and the new judgement.
fn combine(earlier: Option<OneWayDelay>, new: OneWayDelay) -> OneWayDelay {
    let Some(earlier) = earlier else { return new };
    let usable_bounds = |delay: OneWayDelay| delay.bounds.filter(|_| delay.verdict != Verdict::Inconsistent);
    let (earlier_bounds, new_bounds) = match (usable_bounds(earlier), usable_bounds(new)) {
        (Some(earlier_bounds), Some(new_bounds)) => (earlier_bounds, new_bounds),
        // The stored exchanges give no bounds, so the earlier judgement is better.
        (Some(_), None) if new.verdict == Verdict::Unsynchronised => return earlier,
        // The earlier judgement has no usable bounds, or the new one shows a step or a contradiction.
        _ => return new,
    };
    // Both intervals contain the true delay, so they overlap unless an assumption is violated.
    let Some(bounds) = earlier_bounds.intersection(new_bounds) else {
        return OneWayDelay { value: None, bounds: None, verdict: Verdict::Inconsistent, ..new };
    };
    // The estimate must lie within the new bounds, which may be narrower than the bounds with which the estimate was
    // made.
    let value = new.value.or(earlier.value).map(|value| value.clamp(bounds.lo, bounds.hi));
    let is_wide = value.is_none_or(|value| bounds.is_wide_for(value));
    let verdict = match (earlier.verdict, new.verdict) {
        (Verdict::Stale, Verdict::Stale) => Verdict::Stale,
        _ if is_wide => Verdict::Limited,
        _ => Verdict::Ok,
    };
    OneWayDelay { value, bounds: Some(bounds), verdict, ..new }
}

impl Row {
    /// Returns the stamps by which the delay is judged, and the clocks of these stamps. If both hosts recorded raw
    /// stamps, the delay is judged by the raw stamps, and otherwise by the stamps of the wall clocks. A cloud that
    /// cannot read a free-running clock reports stamps of its wall clock as raw stamps.
    fn stamps(&self, direction: Direction, sent: WallTime, received: WallTime) -> (RelatedClocks, RawStamps) {
        let wall_stamps =
            RawStamps { sent: RawTime::from_wall(sent), received: RawTime::from_wall(received) };
        let Some((sent, received)) = self.sent_raw_ns.zip(self.received_raw_ns) else {
            return (RelatedClocks::Wall, wall_stamps);
        };
        let raw_stamps =
            RawStamps { sent: RawTime::from_nanos(sent), received: RawTime::from_nanos(received) };
        let has_cloud_wall_stamp = match direction {
            Direction::Up => raw_stamps.received == wall_stamps.received,
            Direction::Down => raw_stamps.sent == wall_stamps.sent,
        };
        (if has_cloud_wall_stamp { RelatedClocks::RawToWall } else { RelatedClocks::Raw }, raw_stamps)
    }

    /// Returns the delay as stored, or `None` if the delay was never judged.
    fn delay(&self) -> Result<Option<OneWayDelay>, StoreError> {
        let Self { raw_ns, source, verdict, value, .. } = *self;
        StoredDelay { raw_ns, source, verdict, value, bounds: self.lo.zip(self.hi) }.into_delay(WHAT)
    }
}
