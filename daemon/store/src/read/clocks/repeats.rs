//! Times that an edge's clock showed more than once, because the clock was set back.

use std::collections::HashMap;

use sqlx::FromRow;

use super::WHAT;
use crate::error::StoreError;
use crate::read::sql;
use crate::readers::Readers;

/// A relation period and the range of its samples' times.
#[derive(Debug, FromRow)]
struct RelationPeriod {
    #[sqlx(rename = "window")]
    relation_period: i64,
    first_ns: i64,
    last_ns: i64,
}

/// Relation periods whose times overlap with the times of an earlier relation period. Samples of the earlier relation
/// period were taken before the clock was set back. For the common times, only the samples of the later relation period
/// are used.
#[derive(Debug, Default)]
pub(super) struct RepeatedTimes {
    /// Position of each relation period in the order of arrival, by the relation period's number.
    positions: HashMap<i64, usize>,
    /// Position, first and last time of each relation period that begins before an earlier relation period ends.
    overlapping: Vec<(usize, i64, i64)>,
}

impl RepeatedTimes {
    pub(super) async fn read(
        readers: &Readers,
        link: i64,
        (from, to): (i64, i64),
    ) -> Result<Self, StoreError> {
        let relation_periods: Vec<RelationPeriod> = sqlx::query_as(sql::RELATION_PERIOD_ORDER)
            .bind(link)
            .bind(from)
            .bind(to)
            .fetch_all(&readers.pool())
            .await
            .map_err(readers.error_for(WHAT))?;
        let mut repeats = Self::default();
        let mut end = i64::MIN;
        for (position, RelationPeriod { relation_period, first_ns, last_ns }) in
            relation_periods.into_iter().enumerate()
        {
            if first_ns <= end {
                repeats.overlapping.push((position, first_ns, last_ns));
            }
            end = end.max(last_ns);
            repeats.positions.insert(relation_period, position);
        }
        Ok(repeats)
    }

    /// Returns whether a relation period that arrived after `relation_period` contains this time.
    pub(super) fn is_superseded(&self, relation_period: i64, at_ns: i64) -> bool {
        let Some(position) = self.positions.get(&relation_period) else { return false };
        let supersedes =
            |(other, first, last): &(usize, i64, i64)| other > position && *first <= at_ns && at_ns <= *last;
        self.overlapping.iter().any(supersedes)
    }
}
