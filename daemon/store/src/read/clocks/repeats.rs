//! Seconds that an edge's clock showed more than once, because it was set back.

use std::collections::HashMap;

use sqlx::FromRow;

use super::WHAT;
use crate::error::StoreError;
use crate::read::sql;
use crate::readers::Readers;

/// A window and the range of its samples' times.
#[derive(Debug, FromRow)]
struct Window {
    window: i64,
    first_ns: i64,
    last_ns: i64,
}

/// Windows with times that an earlier window has, too. The later one counts: the samples of the earlier one are from before
/// the clock was set back.
#[derive(Debug, Default)]
pub(super) struct RepeatedTimes {
    /// Place of each window in the order of arrival.
    places: HashMap<i64, usize>,
    /// Place, first and last time of the windows that begin before an earlier one ends.
    later: Vec<(usize, i64, i64)>,
}

impl RepeatedTimes {
    pub(super) async fn read(
        readers: &Readers,
        link: i64,
        (from, to): (i64, i64),
    ) -> Result<Self, StoreError> {
        let windows: Vec<Window> = sqlx::query_as(sql::CLOCK_WINDOW_ORDER)
            .bind(link)
            .bind(from)
            .bind(to)
            .fetch_all(&readers.pool())
            .await
            .map_err(readers.failed(WHAT))?;
        let mut repeats = Self::default();
        let mut end = i64::MIN;
        for (place, Window { window, first_ns, last_ns }) in windows.into_iter().enumerate() {
            if first_ns <= end {
                repeats.later.push((place, first_ns, last_ns));
            }
            end = end.max(last_ns);
            repeats.places.insert(window, place);
        }
        Ok(repeats)
    }

    /// Returns whether a later window has this time.
    pub(super) fn is_superseded(&self, window: i64, at_ns: i64) -> bool {
        let Some(place) = self.places.get(&window) else { return false };
        let covers =
            |(later, first, last): &(usize, i64, i64)| later > place && *first <= at_ns && at_ns <= *last;
        self.later.iter().any(covers)
    }
}
