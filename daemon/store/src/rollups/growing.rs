//! The buckets of one run that may still grow.

use std::collections::BTreeMap;

use sqlx::SqliteConnection;

use super::packed::PackedSummary;
use super::table::{self, RollupRow};
use super::{Added, Series, WHOLE_RUN, WIDTHS_S, bucket};

/// Number of older buckets of a width kept in addition to the newest bucket: iterations may end in another order than they started.
const OLDER_BUCKETS: usize = 2;
/// Approximate memory of a run in addition to its rows, bytes.
const OVERHEAD: usize = 512;

/// Buckets of one width.
#[derive(Debug)]
struct Width {
    /// All rows of each bucket, by series. A bucket in this map is complete.
    buckets: BTreeMap<i64, Vec<(Series, PackedSummary)>>,
    /// All of the database's buckets that start at this second or later are in `buckets`.
    known_from: i64,
}

/// The buckets of a run in memory.
#[derive(Debug)]
pub(super) struct GrowingBuckets {
    run: i64,
    /// In the order of [`WIDTHS_S`], then the whole run.
    widths: [Width; WIDTHS_S.len() + 1],
    bytes: usize,
    transaction: u64,
}

impl GrowingBuckets {
    /// Reads the newest bucket of each width, but no rows.
    pub(super) async fn read(connection: &mut SqliteConnection, run: i64) -> Result<Self, sqlx::Error> {
        let newest = table::newest_buckets(connection, run).await?;
        let widths = newest.map(|newest| Width {
            buckets: BTreeMap::new(),
            known_from: newest.map_or(i64::MIN, |newest| newest.saturating_add(1)),
        });
        Ok(Self { run, widths, bytes: OVERHEAD, transaction: 0 })
    }

    pub(super) const fn bytes(&self) -> usize {
        self.bytes
    }

    /// Returns the number of the transaction that last wrote it.
    pub(super) const fn last_transaction(&self) -> u64 {
        self.transaction
    }

    /// Adds to the buckets of a width, and appends their new rows to `rows`.
    pub(super) async fn add(
        &mut self,
        connection: &mut SqliteConnection,
        width_s: i64,
        added: &[Added],
        rows: &mut Vec<RollupRow>,
    ) -> Result<(), sqlx::Error> {
        let at = WIDTHS_S.iter().position(|known| *known == width_s).unwrap_or(WIDTHS_S.len());
        let width = &mut self.widths[at];
        let mut unknown: Vec<i64> = added
            .iter()
            .map(|(_, bucket_s, _)| *bucket_s)
            .filter(|bucket_s| *bucket_s < width.known_from && !width.buckets.contains_key(bucket_s))
            .collect();
        unknown.sort_unstable();
        unknown.dedup();
        if !unknown.is_empty() {
            for row in table::read_buckets(connection, self.run, width_s, &unknown).await? {
                let (bucket_s, series, packed) = row.into_parts();
                width.buckets.entry(bucket_s).or_default().push((series, packed));
            }
        }
        for (series, bucket_s, summary) in added {
            let bucket = width.buckets.entry(*bucket_s).or_default();
            let at = match bucket.binary_search_by_key(series, |(series, _)| *series) {
                Ok(at) => {
                    bucket[at].1.add(summary)?;
                    at
                }
                Err(at) => {
                    bucket.insert(at, (*series, PackedSummary::pack(summary)));
                    at
                }
            };
            let packed = bucket[at].1.clone();
            rows.push(RollupRow::new((self.run, width_s, *bucket_s), *series, packed));
        }
        Ok(())
    }

    /// Removes all but the newest buckets of each width.
    pub(super) fn shrink(&mut self, transaction: u64) {
        self.transaction = transaction;
        for width in &mut self.widths {
            while width.buckets.len() > OLDER_BUCKETS
                && let Some((bucket_s, _)) = width.buckets.pop_first()
            {
                width.known_from = width.known_from.max(bucket_s.saturating_add(1));
            }
        }
        let rows = self.widths.iter().flat_map(|width| width.buckets.values().flatten());
        self.bytes = OVERHEAD + rows.map(|(_, packed)| packed.bytes()).sum::<usize>();
    }
}

const _: () = assert!(bucket(-1, 10) == -10 && bucket(59, 60) == 0 && bucket(7, WHOLE_RUN) == 0);
