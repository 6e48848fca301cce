//! A clock relation that learns the stored exchanges in the order of time.

use std::collections::VecDeque;

use peernet_clock::{
    ClockClaim, DelaySource, Exchange, ExchangeObservation, Interval, RawTime, RelatedClocks, Relation,
    RelationSettings, Span,
};
use sqlx::FromRow;

use super::super::clocks::sources;
use super::super::{sql, value_of_number};
use crate::error::StoreError;
use crate::readers::Readers;

/// Name of the requested data in errors.
const WHAT: &str = "clock samples";
/// Time before and after a delay from which stored exchanges are used. The newest eight exchanges that the relation has
/// learnt are used at any distance ([`RelationSettings::window`]). The agent, by default, uses the exchanges of an
/// equally long time before a delay.
pub(super) const EXCHANGE_RANGE: Span = Span::from_seconds(10);
/// Longest time by which a delay may be earlier than the latest delay before it in the order of iterations, without
/// samples being read again. It covers iterations that take up to a minute.
const MAX_DISORDER: Span = Span::from_seconds(60);
/// Number of clock samples that are read at a time.
const PAGE: u32 = 1_000;

/// A stored clock sample.
#[derive(FromRow)]
struct Row {
    /// End of the sample's second, by the edge's related clock.
    time_ns: i64,
    /// End of the sample's second, by the edge's wall clock.
    at_ns: i64,
    max_drift_ppm: f64,
    max_drift_change_ppm_per_s: Option<f64>,
    // The exchange with the lowest upper bound of the offset in this second.
    upper_sent_ns: Option<i64>,
    upper_received_ns: Option<i64>,
    upper_replied_ns: Option<i64>,
    upper_returned_ns: Option<i64>,
    upper_uncertainty_ns: Option<i64>,
    // The exchange with the highest lower bound of the offset in this second.
    lower_sent_ns: Option<i64>,
    lower_received_ns: Option<i64>,
    lower_replied_ns: Option<i64>,
    lower_returned_ns: Option<i64>,
    lower_uncertainty_ns: Option<i64>,
    offset_lo_ns: Option<i64>,
    offset_hi_ns: Option<i64>,
    offset_source: Option<u8>,
    offset_sources: Option<String>,
}

/// Interval of the offset that follows from the claims of both hosts' time daemons.
type Claim = Option<(DelaySource, Interval)>;

/// The clock relation of one relation period, from the stored exchanges around a time that usually advances.
pub(super) struct RollingRelation {
    /// The link and the number of its relation period.
    key: (i64, i64),
    clocks: RelatedClocks,
    /// The latest time that was asked for.
    latest: RawTime,
    /// The relation; `None` before the first sample. The first sample gives the drift limit, because all samples of a
    /// relation period have the same limit.
    relation: Option<Relation>,
    /// Rows that were read but not learnt yet.
    unlearnt_rows: VecDeque<Row>,
    /// Time of the last row that was read, by the edge's related clock and by its wall clock. Two rows may have the same
    /// time of a free-running clock.
    read_until_ns: (i64, i64),
    /// `true` if all rows were read.
    is_complete: bool,
    /// Claims of the samples whose seconds end at most `MAX_DISORDER` before `latest`, or later, with the ends of these
    /// seconds in ascending order.
    claims: VecDeque<(RawTime, Claim)>,
}

impl RollingRelation {
    /// Creates the clock relation of a relation period. The first samples that it will read also suffice for times that
    /// are earlier than `at` by at most `MAX_DISORDER`.
    pub(super) fn new(key: (i64, i64), clocks: RelatedClocks, at: RawTime) -> Self {
        Self {
            key,
            clocks,
            latest: at,
            relation: None,
            unlearnt_rows: VecDeque::new(),
            read_until_ns: ((at - EXCHANGE_RANGE - MAX_DISORDER).nanos(), i64::MIN),
            is_complete: false,
            claims: VecDeque::new(),
        }
    }

    /// Returns the relation at a time; `None` if no sample was stored until shortly after this time. The relation has
    /// the claim of the first sample whose second ends at this time or later, or of the last sample if all end earlier.
    /// The claim holds at the end of its second.
    pub(super) async fn at(
        &mut self,
        readers: &Readers,
        at: RawTime,
    ) -> Result<Option<&Relation>, StoreError> {
        if at < self.latest - MAX_DISORDER {
            // The exchanges and the claims of this time were discarded, so the samples are read again.
            *self = Self::new(self.key, self.clocks, at);
        }
        self.latest = self.latest.max(at);
        let until = (at + EXCHANGE_RANGE).nanos();
        loop {
            while let Some(row) = self.unlearnt_rows.pop_front_if(|row| row.time_ns <= until) {
                self.learn(&row)?;
            }
            if self.is_complete || !self.unlearnt_rows.is_empty() {
                break;
            }
            self.read(readers).await?;
        }
        let oldest = self.latest - MAX_DISORDER;
        while self.claims.pop_front_if(|(end, _)| *end < oldest).is_some() {}
        let next_claim = self.claims.partition_point(|(end, _)| *end < at);
        let claim = self.claims.get(next_claim).or_else(|| self.claims.back());
        if let (Some(relation), Some((end, claim))) = (&mut self.relation, claim) {
            let claim_with = |error: fn(Interval) -> Interval| {
                claim.map(|(source, offset)| ClockClaim { source, error: error(offset) })
            };
            // A sample has one claim about the offset, but the relation takes a claim about each clock. The edge's
            // clock is declared exact, and the cloud's clock gets the whole interval.
            let edge_claim = claim_with(|_| Interval::exactly(Span::ZERO));
            relation.set_claims(edge_claim, claim_with(|offset| offset), *end);
        }
        Ok(self.relation.as_ref())
    }

    /// Reads the next rows.
    async fn read(&mut self, readers: &Readers) -> Result<(), StoreError> {
        let by_wall_clocks = self.clocks == RelatedClocks::Wall;
        let statement = if by_wall_clocks { sql::CLOCK_EXCHANGES } else { sql::CLOCK_EXCHANGES_BY_RAW };
        let rows: Vec<Row> = sqlx::query_as(statement)
            .bind(self.key.0)
            .bind(self.key.1)
            .bind(self.read_until_ns.0)
            .bind(PAGE)
            .bind(self.read_until_ns.1)
            .fetch_all(&readers.pool())
            .await
            .map_err(readers.error_for(WHAT))?;
        self.is_complete = rows.len() < PAGE as usize;
        self.read_until_ns = rows.last().map_or(self.read_until_ns, |row| (row.time_ns, row.at_ns));
        self.unlearnt_rows.extend(rows);
        Ok(())
    }

    /// Adds the exchanges and the claim of a row.
    fn learn(&mut self, row: &Row) -> Result<(), StoreError> {
        let relation = self.relation.get_or_insert_with(|| {
            let settings = RelationSettings {
                clocks: self.clocks,
                max_drift_ppm: row.max_drift_ppm,
                // Agents that reported no limit assumed none.
                max_drift_change_ppm_per_s: row.max_drift_change_ppm_per_s.unwrap_or(f64::INFINITY),
                window: EXCHANGE_RANGE,
                // The relation has exchanges from up to `EXCHANGE_RANGE` after the latest time, and may be asked for
                // times up to `MAX_DISORDER` before it, which need exchanges from `EXCHANGE_RANGE` before them.
                retention: EXCHANGE_RANGE + EXCHANGE_RANGE + MAX_DISORDER,
                // The sources of a stored offset contain a claim only if the agent trusted it.
                trust_time_daemons: true,
                ..RelationSettings::default()
            };
            // The relation is not told whether both hosts read the same clock: delays of such hosts are stored with the
            // source `same-clock` and are not judged again.
            Relation::new(settings)
        });
        let mut exchanges = [row.upper(), row.lower()];
        // The two exchanges of a sample are learnt in the order of time: a clock may have jumped between them.
        exchanges.sort_by_key(|exchange| exchange.map(|exchange| exchange.sent));
        for exchange in exchanges.into_iter().flatten() {
            relation.learn(&ExchangeObservation {
                exchange,
                // Clock samples do not contain this time.
                cloud_elapsed: None,
                // A new relation period begins when a clock is interrupted, so all exchanges of a relation period are
                // from one epoch.
                edge_epoch: 1,
                cloud_epoch: Some(1),
            });
        }
        self.claims.push_back((RawTime::from_nanos(row.time_ns), row.claim()?));
        Ok(())
    }
}

impl Row {
    fn upper(&self) -> Option<Exchange> {
        exchange([
            self.upper_sent_ns,
            self.upper_received_ns,
            self.upper_replied_ns,
            self.upper_returned_ns,
            self.upper_uncertainty_ns,
        ])
    }

    fn lower(&self) -> Option<Exchange> {
        exchange([
            self.lower_sent_ns,
            self.lower_received_ns,
            self.lower_replied_ns,
            self.lower_returned_ns,
            self.lower_uncertainty_ns,
        ])
    }

    fn claim(&self) -> Result<Claim, StoreError> {
        if let Some(json) = &self.offset_sources {
            return Ok(sources(json)?.into_iter().find(|(source, _)| source.is_claim()));
        }
        let source =
            self.offset_source.map(|number| value_of_number(WHAT, DelaySource::ALL, number)).transpose()?;
        let bounds = self.offset_lo_ns.zip(self.offset_hi_ns);
        let interval = |(lo, hi)| Interval { lo: Span::from_nanos(lo), hi: Span::from_nanos(hi) };
        Ok(source.filter(|source| source.is_claim()).zip(bounds.map(interval)))
    }
}

fn exchange(stamps: [Option<i64>; 5]) -> Option<Exchange> {
    let [sent, received, replied, returned, uncertainty] = stamps;
    Some(Exchange {
        sent: RawTime::from_nanos(sent?),
        received: RawTime::from_nanos(received?),
        replied: RawTime::from_nanos(replied?),
        returned: RawTime::from_nanos(returned?),
        uncertainty: Span::from_nanos(uncertainty?),
    })
}
