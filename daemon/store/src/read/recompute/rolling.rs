//! A relation that learns stored exchanges in the order of time.

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
/// Time before and after a delay within which exchanges are used. The agent itself uses exchanges of the same time
/// before a delay, unless configured otherwise.
pub(super) const EXCHANGE_RANGE: Span = Span::from_seconds(10);
/// Longest time by which a delay may be earlier than the delay that was judged before it. An iteration may take as long
/// as that.
const MAX_DISORDER: Span = Span::from_seconds(60);
/// Number of samples of one read.
const PAGE: u32 = 1_000;

/// A stored second.
#[derive(FromRow)]
struct Row {
    /// End of the second, by the edge's related clock.
    time_ns: i64,
    max_drift_ppm: f64,
    max_drift_change_ppm_per_s: Option<f64>,
    upper_sent_ns: Option<i64>,
    upper_received_ns: Option<i64>,
    upper_replied_ns: Option<i64>,
    upper_returned_ns: Option<i64>,
    upper_uncertainty_ns: Option<i64>,
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

/// The exchanges of one window around the current time.
pub(super) struct RollingWindow {
    /// The link and its window.
    key: (i64, i64),
    clocks: RelatedClocks,
    /// Created with the drift limit of the first sample. All samples of a window have the same limit.
    relation: Option<Relation>,
    /// Rows that were read but not learnt yet.
    unlearnt_rows: VecDeque<Row>,
    /// Time of the last row that was read.
    read_until_ns: i64,
    /// `true` if all rows were read.
    is_complete: bool,
    /// Claims that are not set yet, with the ends of their seconds.
    claims: VecDeque<(RawTime, Claim)>,
    /// The claim that is set.
    current_claim: Claim,
}

impl RollingWindow {
    /// Creates a window for times around and after `at`. Times may be earlier than `at` by at most `MAX_DISORDER`.
    pub(super) fn new(key: (i64, i64), clocks: RelatedClocks, at: RawTime) -> Self {
        Self {
            key,
            clocks,
            relation: None,
            unlearnt_rows: VecDeque::new(),
            read_until_ns: (at - EXCHANGE_RANGE - MAX_DISORDER).nanos(),
            is_complete: false,
            claims: VecDeque::new(),
            current_claim: None,
        }
    }

    /// Returns the relation at a time. Successive times have to be nearly in order.
    pub(super) async fn at(
        &mut self,
        readers: &Readers,
        at: RawTime,
    ) -> Result<Option<&Relation>, StoreError> {
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
        while self.claims.pop_front_if(|(end, _)| *end < at).is_some() {}
        if let (Some(relation), Some((_, claim))) = (&mut self.relation, self.claims.front())
            && *claim != self.current_claim
        {
            self.current_claim = *claim;
            let claim_with = |error: fn(Interval) -> Interval| {
                claim.map(|(source, offset)| ClockClaim { source, error: error(offset) })
            };
            // The stored claim is about the offset: it is set as if the edge's clock were exact.
            relation.set_claims(claim_with(|_| Interval::exactly(Span::ZERO)), claim_with(|offset| offset));
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
            .bind(self.read_until_ns)
            .bind(PAGE)
            .fetch_all(&readers.pool())
            .await
            .map_err(readers.failed(WHAT))?;
        self.is_complete = rows.len() < PAGE as usize;
        self.read_until_ns = rows.last().map_or(self.read_until_ns, |row| row.time_ns);
        self.unlearnt_rows.extend(rows);
        Ok(())
    }

    /// Adds the exchanges and the claim of a row.
    fn learn(&mut self, row: &Row) -> Result<(), StoreError> {
        let relation = self.relation.get_or_insert_with(|| {
            let settings = RelationSettings {
                clocks: self.clocks,
                max_drift_ppm: row.max_drift_ppm,
                max_drift_change_ppm_per_s: row.max_drift_change_ppm_per_s.unwrap_or(f64::INFINITY),
                window: EXCHANGE_RANGE,
                retention: EXCHANGE_RANGE + EXCHANGE_RANGE + MAX_DISORDER,
                // The sources of a stored offset contain only claims that were used.
                trust_time_daemons: true,
                ..RelationSettings::default()
            };
            // A delay between hosts that proved that they read one clock is stored as such and not judged again, so the
            // settings for this proof do not matter.
            Relation::new(settings)
        });
        let mut exchanges = [row.upper(), row.lower()];
        // The exchanges are learnt in the order of time, because a clock may have jumped between them.
        exchanges.sort_by_key(|exchange| exchange.map(|exchange| exchange.sent));
        for exchange in exchanges.into_iter().flatten() {
            relation.learn(&ExchangeObservation {
                exchange,
                cloud_elapsed: None,
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
        let is_time_daemon =
            |source: &DelaySource| matches!(source, DelaySource::Kernel | DelaySource::Chrony);
        if let Some(json) = &self.offset_sources {
            return Ok(sources(json)?.into_iter().find(|(source, _)| is_time_daemon(source)));
        }
        let source =
            self.offset_source.map(|number| value_of_number(WHAT, DelaySource::ALL, number)).transpose()?;
        let bounds = self.offset_lo_ns.zip(self.offset_hi_ns);
        let interval = |(lo, hi)| Interval { lo: Span::from_nanos(lo), hi: Span::from_nanos(hi) };
        Ok(source.filter(is_time_daemon).zip(bounds.map(interval)))
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
