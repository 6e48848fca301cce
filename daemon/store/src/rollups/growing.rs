//! The buckets of one run that may still grow.

use std::collections::BTreeMap;

use sqlx::SqliteConnection;

use super::packed::PackedSummary;
use super::table::{self, RollupRow};
use super::{Addition, SeriesKey, WHOLE_RUN, WIDTHS_S, bucket};

/// Number of buckets of a width that are kept in memory. One bucket is not enough, because iterations may end in
/// another order than they started.
const CACHED_BUCKETS: usize = 2;
/// Approximate memory of a run in addition to its rows, bytes.
const OVERHEAD: usize = 512;

/// Buckets of one width.
#[derive(Debug)]
struct WidthBuckets {
    /// The rows of each bucket in memory, sorted by series. The map contains either all rows of a bucket or none.
    buckets: BTreeMap<i64, Vec<(SeriesKey, PackedSummary)>>,
    /// Every stored bucket that starts at this second or later is in `buckets`, so no rows are read for these buckets.
    complete_from_s: i64,
}

/// The buckets of a run in memory.
#[derive(Debug)]
pub(super) struct GrowingBuckets {
    run: i64,
    /// In the order of [`WIDTHS_S`], then the whole run.
    widths: [WidthBuckets; WIDTHS_S.len() + 1],
    /// Approximate memory of this value.
    bytes: usize,
    /// Number of the transaction that last wrote this run.
    last_transaction: u64,
}

impl GrowingBuckets {
    /// Reads the start of the newest bucket of each width, but no rows.
    pub(super) async fn read(connection: &mut SqliteConnection, run: i64) -> Result<Self, sqlx::Error> {
        let newest = table::newest_buckets(connection, run).await?;
        let widths = newest.map(|newest| WidthBuckets {
            buckets: BTreeMap::new(),
            complete_from_s: newest.map_or(i64::MIN, |newest| newest.saturating_add(1)),
        });
        Ok(Self { run, widths, bytes: OVERHEAD, last_transaction: 0 })
    }

    pub(super) const fn bytes(&self) -> usize {
        self.bytes
    }

    /// Returns the number of the transaction that last wrote this run.
    pub(super) const fn last_transaction(&self) -> u64 {
        self.last_transaction
    }

    /// Adds values to the buckets of a width, and appends the changed rows to `rows`.
    pub(super) async fn add(
        &mut self,
        connection: &mut SqliteConnection,
        width_s: i64,
        additions: &[Addition],
        rows: &mut Vec<RollupRow>,
    ) -> Result<(), sqlx::Error> {
        // `WHOLE_RUN` is not in `WIDTHS_S`. Its entry is the last one in `widths`.
        let index = WIDTHS_S.iter().position(|other| *other == width_s).unwrap_or(WIDTHS_S.len());
        let width = &mut self.widths[index];
        let mut missing_buckets: Vec<i64> = additions
            .iter()
            .map(|(_, bucket_s, _)| *bucket_s)
            .filter(|bucket_s| *bucket_s < width.complete_from_s && !width.buckets.contains_key(bucket_s))
            .collect();
        missing_buckets.sort_unstable();
        missing_buckets.dedup();
        if !missing_buckets.is_empty() {
            // `read_buckets` sorts by bucket and series, so each list is sorted by series.
            for row in table::read_buckets(connection, self.run, width_s, &missing_buckets).await? {
                let (bucket_s, series, packed) = row.into_parts()?;
                width.buckets.entry(bucket_s).or_default().push((series, packed));
            }
        }
        for (series, bucket_s, summary) in additions {
            let bucket = width.buckets.entry(*bucket_s).or_default();
            let index = match bucket.binary_search_by_key(series, |(series, _)| *series) {
                Ok(index) => {
                    bucket[index].1.add(summary)?;
                    index
                }
                Err(index) => {
                    bucket.insert(index, (*series, PackedSummary::pack(summary)));
                    index
                }
            };
            let packed = bucket[index].1.clone();
            rows.push(RollupRow::new((self.run, width_s, *bucket_s), *series, packed));
        }
        Ok(())
    }

    /// Removes all buckets from memory except the newest [`CACHED_BUCKETS`] of each width, and
    /// records the transaction that wrote this run.
    pub(super) fn shrink(&mut self, transaction: u64) {
        self.last_transaction = transaction;
        for width in &mut self.widths {
            while width.buckets.len() > CACHED_BUCKETS
                && let Some((bucket_s, _)) = width.buckets.pop_first()
            {
                width.complete_from_s = width.complete_from_s.max(bucket_s.saturating_add(1));
            }
        }
        let rows = self.widths.iter().flat_map(|width| width.buckets.values().flatten());
        self.bytes = OVERHEAD + rows.map(|(_, packed)| packed.bytes()).sum::<usize>();
    }
}

const _: () = assert!(bucket(-1, 10) == -10 && bucket(59, 60) == 0 && bucket(7, WHOLE_RUN) == 0);
