//! Times that an edge's clock showed more than once, because the clock was set back.

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

/// Windows whose times overlap with the times of an earlier window. Samples of the earlier window were taken before the
/// clock was set back. For the common times, only the samples of the later window are used.
#[derive(Debug, Default)]
pub(super) struct RepeatedTimes {
    /// Position of each window in the order of arrival, by the window's number.
    positions: HashMap<i64, usize>,
    /// Position, first and last time of each window that begins before an earlier window ends.
    overlapping: Vec<(usize, i64, i64)>,
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
            .map_err(readers.error_for(WHAT))?;
        let mut repeats = Self::default();
        let mut end = i64::MIN;
        for (position, Window { window, first_ns, last_ns }) in windows.into_iter().enumerate() {
            if first_ns <= end {
                repeats.overlapping.push((position, first_ns, last_ns));
            }
            end = end.max(last_ns);
            repeats.positions.insert(window, position);
        }
        Ok(repeats)
    }

    /// Returns whether a window after `window` contains this time.
    pub(super) fn is_superseded(&self, window: i64, at_ns: i64) -> bool {
        let Some(position) = self.positions.get(&window) else { return false };
        let supersedes =
            |(other, first, last): &(usize, i64, i64)| other > position && *first <= at_ns && at_ns <= *last;
        self.overlapping.iter().any(supersedes)
    }
}
