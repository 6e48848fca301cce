//! Roll-ups: statistics that are updated in the same transaction in which nodes are stored.
//!
//! A roll-up has the moments and the sketch of the values in one bucket. Buckets are 1 s, 10 s, 1 min or 1 h wide, or
//! cover the whole run; a value belongs to the bucket in which its iteration started. The key of the table is run,
//! width, bucket, name, quantity, so that a commit appends rows and a page of the dashboard reads one range of rows.
//!
//! With a thousand agents the cost per row matters, because each agent changes a bucket of every width and name in each
//! commit. Four measures keep this cost low: the values of a commit are summed up before rows are changed; no rows are
//! read for a bucket that is certainly new; the buckets that still grow are kept in memory in their stored form; and
//! all rows are written with a few large statements, in the order of the table's key.

mod growing;
mod packed;
mod table;

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::Arc;

use peernet_statistics::Summary;
use sqlx::SqliteConnection;

use self::growing::GrowingBuckets;
#[cfg(test)]
pub(crate) use self::table::QUERIES;
pub(crate) use self::table::RollupRow;
use self::table::Upserts;

/// Widths of the buckets in seconds, finest first.
pub(crate) const WIDTHS_S: [i64; 4] = [1, 10, 60, 3600];
/// Width that stands for the whole run.
pub(crate) const WHOLE_RUN: i64 = 0;
/// Maximum memory for growing buckets, bytes. Above this limit, the buckets of the runs that were written least
/// recently are removed from memory; they are read again when needed. The limit is enough for some thousand runs with
/// usual trees.
const MAX_CACHE_BYTES: usize = 96 << 20;

/// Quantity of a node of which statistics are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) enum Quantity {
    /// Value of the node.
    Value = 0,
    /// Half the width of the bounds of the node's value.
    HalfWidth = 1,
    /// Lower end of the bounds of the node's value.
    LowerEnd = 2,
    /// Upper end of the bounds of the node's value. An infinite end has no place in a summary, so that a throughput may
    /// have fewer upper ends than lower ends.
    UpperEnd = 3,
}

impl Quantity {
    /// Number of quantities.
    pub(crate) const COUNT: usize = 4;

    /// Returns the quantity that has this number in the table `quantity`.
    pub(crate) const fn from_number(number: i64) -> Option<Self> {
        match number {
            0 => Some(Self::Value),
            1 => Some(Self::HalfWidth),
            2 => Some(Self::LowerEnd),
            3 => Some(Self::UpperEnd),
            _ => None,
        }
    }

    /// Returns whether the quantity is stored in buckets of this width.
    const fn is_stored_in(self, width_s: i64) -> bool {
        match self {
            Self::Value | Self::HalfWidth => true,
            // Only medians over whole runs have an interval, and each further row costs time in every commit.
            Self::LowerEnd | Self::UpperEnd => width_s == WHOLE_RUN,
        }
    }
}

/// Id of a name, and quantity. All values with the same key within a bucket have one summary.
type SeriesKey = (i64, Quantity);

/// Addition to a bucket: series, the bucket's start, values.
// The summary is shared: often one summary is the only addition to its bucket in several widths.
type Addition = (SeriesKey, i64, Arc<Summary>);

/// Returns the start of the bucket of a width that contains a second.
pub(crate) const fn bucket(second_s: i64, width_s: i64) -> i64 {
    if width_s == WHOLE_RUN { 0 } else { second_s - second_s.rem_euclid(width_s) }
}

/// The roll-ups that current runs write to.
#[derive(Debug, Default)]
pub(crate) struct Rollups {
    /// Additions of the current transaction, by run, second and series.
    pending: HashMap<(i64, i64, SeriesKey), Summary>,
    /// Number of delays of the current transaction, by run, name and verdict.
    verdicts: HashMap<(i64, i64, u8), i64>,
    /// Buckets by run, as in the database after the current transaction.
    growing: HashMap<i64, GrowingBuckets>,
    /// Memory of `growing`, bytes.
    bytes: usize,
    /// Number of the current transaction; it shows which run was written least recently.
    transaction: u64,
    upserts: Upserts,
    scope: Scope,
}

/// Selection of the buckets to write.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) enum Scope {
    /// All buckets.
    #[default]
    All,
    /// Buckets that begin at this second or later, but not the whole run, because nodes before this second are deleted.
    From(i64),
    /// Buckets of minutes and hours only, because the finer buckets exist already.
    Coarser,
}

impl Scope {
    pub(crate) const fn covers(self, width_s: i64, bucket_s: i64) -> bool {
        match self {
            Self::All => true,
            Self::From(second_s) => width_s != WHOLE_RUN && bucket_s >= second_s,
            Self::Coarser => width_s >= 60,
        }
    }
}

impl Rollups {
    /// Creates empty roll-ups that write only the buckets of `scope`.
    pub(crate) fn with_scope(scope: Scope) -> Self {
        Self { scope, ..Self::default() }
    }

    /// Adds values of a name. All values are from iterations of one run that started in the same second, `second_s`.
    pub(crate) fn merge(
        &mut self,
        run: i64,
        name: i64,
        quantity: Quantity,
        second_s: i64,
        summary: &Summary,
    ) {
        if summary.count() == 0 {
            return;
        }
        match self.pending.entry((run, second_s, (name, quantity))) {
            Entry::Occupied(mut entry) => entry.get_mut().merge(summary),
            Entry::Vacant(entry) => {
                entry.insert(summary.clone());
            }
        }
    }

    /// Adds `count` delays of a run and a name that have this verdict.
    pub(crate) fn add_verdicts(&mut self, run: i64, name: i64, verdict: u8, count: u64) {
        *self.verdicts.entry((run, name, verdict)).or_default() += count.cast_signed();
    }

    /// Returns the number of summaries that wait to be written.
    pub(crate) fn pending_summaries(&self) -> usize {
        self.pending.len()
    }

    /// Writes the additions since the last call.
    pub(crate) async fn write(&mut self, connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
        self.transaction += 1;
        let mut pending: Vec<(i64, Addition)> = self
            .pending
            .drain()
            .map(|((run, second_s, series), summary)| (run, (series, second_s, Arc::new(summary))))
            .collect();
        pending.sort_unstable_by_key(|(run, (series, second_s, _))| (*run, *series, *second_s));
        let mut rows = Vec::with_capacity(pending.len() * (WIDTHS_S.len() + 1));
        for run_additions in pending.chunk_by(|(a, _), (b, _)| a == b) {
            let Some((run, _)) = run_additions.first() else { continue };
            let mut growing = match self.growing.remove(run) {
                Some(growing) => {
                    self.bytes -= growing.bytes();
                    growing
                }
                None => GrowingBuckets::read(connection, *run).await?,
            };
            let first_row = rows.len();
            let mut additions: Vec<Addition> =
                run_additions.iter().map(|(_, addition)| addition.clone()).collect();
            for width_s in WIDTHS_S.into_iter().chain([WHOLE_RUN]) {
                additions = merge_into_width(&additions, width_s);
                let is_covered = |((_, quantity), bucket_s, _): &&Addition| {
                    quantity.is_stored_in(width_s) && self.scope.covers(width_s, *bucket_s)
                };
                let covered: Vec<Addition> = additions.iter().filter(is_covered).cloned().collect();
                growing.add(connection, width_s, &covered, &mut rows).await?;
            }
            // The rows are sorted in the order of the table's primary key, so that neighbouring rows are on the same
            // page.
            rows[first_row..].sort_unstable_by_key(RollupRow::key);
            growing.shrink(self.transaction);
            self.bytes += growing.bytes();
            self.growing.insert(*run, growing);
        }
        self.upserts.write_rollups(connection, rows).await?;
        let mut verdicts: Vec<_> = self.verdicts.drain().collect();
        verdicts.sort_unstable();
        self.upserts.write_verdicts(connection, &verdicts).await?;
        self.evict(MAX_CACHE_BYTES);
        Ok(())
    }

    /// Discards the state that is only in memory, because the transaction failed.
    pub(crate) fn forget(&mut self) {
        self.pending.clear();
        self.verdicts.clear();
        self.growing.clear();
        self.bytes = 0;
    }

    /// If the growing buckets take more than `max_bytes` of memory, removes the runs that were written least recently,
    /// until the memory is a tenth below `max_bytes`.
    fn evict(&mut self, max_bytes: usize) {
        if self.bytes <= max_bytes {
            return;
        }
        let mut by_age: Vec<_> = self
            .growing
            .iter()
            .map(|(run, growing)| (growing.last_transaction(), *run, growing.bytes()))
            .collect();
        by_age.sort_unstable();
        for (_, run, bytes) in by_age {
            // The limit is undercut by a tenth, so that not every transaction has to sort the runs.
            if self.bytes <= max_bytes - max_bytes / 10 {
                break;
            }
            self.growing.remove(&run);
            self.bytes -= bytes;
        }
    }

    /// Approximate memory of the growing buckets, bytes.
    #[cfg(test)]
    pub(crate) fn bytes(&self) -> usize {
        self.bytes
    }

    /// Removes runs from memory if their buckets take more than `bytes`.
    #[cfg(test)]
    pub(crate) fn shrink_to(&mut self, bytes: usize) {
        self.evict(bytes);
    }
}

/// Merges narrower buckets into buckets of a width. The argument and the result are in the order of series and time.
fn merge_into_width(finer: &[Addition], width_s: i64) -> Vec<Addition> {
    let key = |(series, bucket_s, _): &Addition| (*series, bucket(*bucket_s, width_s));
    finer
        .chunk_by(|a, b| key(a) == key(b))
        .filter_map(|additions| {
            let [first, others @ ..] = additions else { return None };
            let (series, bucket_s) = key(first);
            let mut sum = Arc::clone(&first.2);
            if !others.is_empty() {
                let sum = Arc::make_mut(&mut sum);
                others.iter().for_each(|(_, _, summary)| sum.merge(summary));
            }
            Some((series, bucket_s, sum))
        })
        .collect()
}
