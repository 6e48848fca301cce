//! Assumptions behind the bounds of one-way delays, as the relation periods of links store them.

use peernet_clock::{RelatedClocks, Span, WallTime};
use peernet_stream::NetworkName;
use sqlx::FromRow;

use super::{WHAT, link_id};
use crate::error::StoreError;
use crate::read::{sql, value_of_number};
use crate::readers::Readers;
use crate::types::{DelayAssumptions, LinkKey};

/// Tolerance before the first and after the last sample of a relation period. The time of a sample is the end of its
/// second, so a message may be older than the relation period's first sample. The delays of a message are judged when
/// the answer arrives, which may be after the relation period's last sample.
const TOLERANCE: Span = Span::from_seconds(60);

/// A relation period of a link with its assumptions.
#[derive(Debug, FromRow)]
struct RelationPeriod {
    cloud: i64,
    first_ns: i64,
    last_ns: i64,
    clocks: Option<u8>,
    max_drift_ppm: Option<f64>,
    max_drift_change_ppm_per_s: Option<f64>,
    claims_trusted: Option<bool>,
    probes_authenticated: Option<bool>,
}

impl RelationPeriod {
    fn assumptions(&self) -> Result<DelayAssumptions, StoreError> {
        let clocks =
            self.clocks.map(|number| value_of_number(WHAT, RelatedClocks::ALL, number)).transpose()?;
        Ok(DelayAssumptions {
            clocks: clocks.unwrap_or(RelatedClocks::Wall),
            max_drift_ppm: self.max_drift_ppm,
            max_drift_change_ppm_per_s: self.max_drift_change_ppm_per_s,
            claims_trusted: self.claims_trusted,
            probes_authenticated: self.probes_authenticated,
        })
    }
}

/// The relation periods of a run's edge over the run's network within a range of times, with their assumptions.
#[derive(Debug)]
pub(in crate::read) struct PeriodAssumptions(Vec<RelationPeriod>);

impl PeriodAssumptions {
    /// Reads the relation periods of a run's edge that have samples from `from` to `to`, by the edge's wall clock.
    pub(in crate::read) async fn read(
        readers: &Readers,
        run: i64,
        (from, to): (WallTime, WallTime),
    ) -> Result<Self, StoreError> {
        let edge_and_network: Option<(i64, String)> = sqlx::query_as(sql::RUN_LINKS)
            .bind(run)
            .bind(NetworkName::default().as_str())
            .fetch_optional(&readers.pool())
            .await
            .map_err(readers.error_for(WHAT))?;
        let Some((edge, network)) = edge_and_network else { return Ok(Self(Vec::new())) };
        let periods = sqlx::query_as(sql::ASSUMED_PERIODS)
            .bind(edge)
            .bind(network)
            .bind((from - TOLERANCE).unix_nanos())
            .bind((to + TOLERANCE).unix_nanos())
            .fetch_all(&readers.pool())
            .await
            .map_err(readers.error_for(WHAT))?;
        Ok(Self(periods))
    }

    /// Returns the assumptions for a message between the edge and a cloud. `at` is the time on the edge's wall clock
    /// when the edge sent or received the message. Returns `None` if no relation period has samples around this time.
    ///
    /// If the edge's clock was set back, several relation periods may contain the time. In this case, the relation
    /// period that arrived last is used.
    pub(in crate::read) fn at(
        &self,
        cloud: i64,
        at: WallTime,
    ) -> Result<Option<DelayAssumptions>, StoreError> {
        let contains_time = |tolerance: Span| {
            move |period: &&RelationPeriod| {
                let at = at.unix_nanos();
                period.cloud == cloud
                    && period.first_ns.saturating_sub(tolerance.nanos()) <= at
                    && at <= period.last_ns.saturating_add(tolerance.nanos())
            }
        };
        let periods = || self.0.iter().rev();
        // A relation period that contains the time is preferred to a relation period that is only near it.
        let period =
            periods().find(contains_time(Span::ZERO)).or_else(|| periods().find(contains_time(TOLERANCE)));
        period.map(RelationPeriod::assumptions).transpose()
    }
}

/// Returns the assumptions of a link's newest relation period, or `None` for an unknown link.
pub(crate) async fn link_assumptions(
    readers: &Readers,
    key: &LinkKey,
) -> Result<Option<DelayAssumptions>, StoreError> {
    let Some(link) = link_id(readers, key).await? else { return Ok(None) };
    let newest: Option<RelationPeriod> = sqlx::query_as(sql::NEWEST_ASSUMED_PERIOD)
        .bind(link)
        .fetch_optional(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    newest.as_ref().map(RelationPeriod::assumptions).transpose()
}
