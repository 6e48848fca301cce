//! Counters of hosts and runs: summed up over a transaction and written at its end.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use peernet_clock::WallTime;
use peernet_logger::HostId;
use peernet_stream::OutcomeCounts;
use sqlx::{Arguments, SqliteConnection};

use super::ends::UNREPORTED_END;
use super::prepared::RunPart;
use crate::column::column;
use crate::extent::Extent;
use crate::insert::Insert;
use crate::stored::{CountColumns, StoredCounts, gap_columns};

/// Maximum number of hosts whose counters are cached: the largest value of `[aggregator] max_hosts`. When the cache has
/// more hosts, all counters are discarded. They are read again when they are needed.
const MAX_CACHED_HOSTS: usize = 65_536;

/// Maximum number of skipped starts of a run. An agent may report any number, and neither the column nor a sum of runs
/// may overflow.
const MAX_SKIPPED_STARTS: u64 = 1 << 53;

/// Additions of a transaction to the counters of a host.
#[derive(Debug, Default)]
pub(super) struct HostCounts {
    /// Id of the host's row.
    id: i64,
    added: StoredCounts,
    /// Time of the newest event.
    pub(super) newest: Option<WallTime>,
}

/// Additions of a transaction to the counters of a run.
#[derive(Debug, Default)]
struct RunCounts {
    outcomes: OutcomeCounts,
    warm_up: u64,
    skipped_starts: u64,
    /// Start of the newest iteration.
    newest_start: WallTime,
    /// Ranges of the iterations' numbers and of the seconds in which they started; `None` without an iteration.
    number_and_second_ranges: Option<(Extent, Extent)>,
}

/// Additions of a transaction, and a cache of the hosts' counters.
#[derive(Debug)]
pub(super) struct Counters {
    hosts: HashMap<HostId, HostCounts>,
    runs: HashMap<i64, RunCounts>,
    /// Counters of the hosts, by row, without the additions of the current transaction.
    totals: HashMap<i64, StoredCounts>,
    write_hosts: Insert,
    write_runs: Insert,
}

impl Default for Counters {
    fn default() -> Self {
        Self {
            hosts: HashMap::new(),
            runs: HashMap::new(),
            totals: HashMap::new(),
            // An agent may report any number of missing events, and the column must not overflow. So the totals are
            // added in Rust, where the addition saturates, and the statement only writes them. `Insert` puts `VALUES`
            // with a row for each host into the brackets.
            write_hosts: Insert::new(
                "UPDATE host SET last_seen_ns = now.column2, events = now.column3, nodes = now.column4, \
                 gaps = now.column5, missing = now.column6, quarantined = now.column7 FROM (",
                7,
                ") AS now WHERE host.id = now.column1",
            ),
            // Only an end that was not reported (`column8` is `UNREPORTED_END`) moves to a newer iteration.
            write_runs: Insert::new(
                "UPDATE run SET warm_up = warm_up + added.column2, ok = ok + added.column3, \
                 failed = failed + added.column4, lost = lost + added.column5, timeout = timeout + added.column6, \
                 last_iteration_ns = max(coalesce(last_iteration_ns, added.column7), added.column7), \
                 ended_ns = iif(end_reason = added.column8, max(ended_ns, added.column7), ended_ns), \
                 skipped_starts = min(skipped_starts + added.column9, added.column10), \
                 arriving_from_s = coalesce(arriving_from_s, added.column11), \
                 arriving_first_number = min(coalesce(arriving_first_number, added.column12), added.column12), \
                 arriving_last_number = max(coalesce(arriving_last_number, added.column13), added.column13), \
                 arriving_first_s = min(coalesce(arriving_first_s, added.column14), added.column14), \
                 arriving_last_s = max(coalesce(arriving_last_s, added.column15), added.column15) FROM (",
                15,
                ") AS added WHERE run.number = added.column1",
            ),
        }
    }
}

impl Counters {
    /// Returns the additions to a host; `id` is its row.
    pub(super) fn host(&mut self, host: HostId, id: i64) -> &mut HostCounts {
        let counts = self.hosts.entry(host).or_default();
        counts.id = id;
        counts
    }

    /// Returns whether the database and the current transaction have stored nothing from a host so far; `id` is the
    /// host's row. Gaps of events that the host sent to another database do not count.
    pub(super) async fn is_first_contact(
        &mut self,
        connection: &mut SqliteConnection,
        host: HostId,
        id: i64,
    ) -> Result<bool, sqlx::Error> {
        let added = self.hosts.get(&host).map(|pending| pending.added).unwrap_or_default();
        let mut counts = match self.totals.entry(id) {
            Entry::Occupied(entry) => *entry.get(),
            Entry::Vacant(entry) => *entry.insert(read_total(connection, id, &added).await?),
        };
        counts.add(&added);
        Ok(counts.events == 0 && counts.quarantined == 0 && counts.missing == counts.in_other_database)
    }

    /// Adds the part of a run that is in a batch.
    pub(super) fn add_run_part(&mut self, run: i64, part: &RunPart) {
        let counts = self.runs.entry(run).or_default();
        counts.outcomes.merge(&part.counts.outcomes());
        counts.warm_up += part.counts.warm_up;
        counts.skipped_starts =
            counts.skipped_starts.saturating_add(part.skipped_starts).min(MAX_SKIPPED_STARTS);
        counts.newest_start = counts.newest_start.max(part.newest_start);
        let (numbers, seconds) = counts.number_and_second_ranges.unwrap_or((part.numbers, part.seconds));
        counts.number_and_second_ranges = Some((numbers.hull(part.numbers), seconds.hull(part.seconds)));
    }

    /// Writes all additions. `storage_s` is the reading of the storage clock, seconds. Returns each
    /// host's totals in the database, and the time of its newest event if events were added.
    pub(super) async fn write(
        &mut self,
        connection: &mut SqliteConnection,
        now: WallTime,
        storage_s: i64,
    ) -> Result<HashMap<HostId, (StoredCounts, Option<WallTime>)>, sqlx::Error> {
        self.write_runs
            .run(connection, &self.runs, |(run, counts), to| {
                to.add(*run)?;
                to.add(column(counts.warm_up))?;
                to.add(column(counts.outcomes.ok))?;
                to.add(column(counts.outcomes.failed))?;
                to.add(column(counts.outcomes.lost))?;
                to.add(column(counts.outcomes.timeout))?;
                to.add(counts.newest_start.unix_nanos())?;
                to.add(UNREPORTED_END)?;
                to.add(column(counts.skipped_starts))?;
                to.add(column(MAX_SKIPPED_STARTS))?;
                to.add(counts.number_and_second_ranges.map(|_| storage_s))?;
                to.add(counts.number_and_second_ranges.map(|(numbers, _)| numbers.first))?;
                to.add(counts.number_and_second_ranges.map(|(numbers, _)| numbers.last))?;
                to.add(counts.number_and_second_ranges.map(|(_, seconds)| seconds.first))?;
                to.add(counts.number_and_second_ranges.map(|(_, seconds)| seconds.last))
            })
            .await?;
        self.runs.clear();
        // The cache is emptied here and not in `is_first_contact`: a total that was read before the transaction
        // inserted its gaps must stay until the transaction's additions are added to the total.
        if self.totals.len() > MAX_CACHED_HOSTS {
            self.totals.clear();
        }
        let mut hosts = Vec::with_capacity(self.hosts.len());
        for (host, counts) in self.hosts.drain() {
            let total = match self.totals.entry(counts.id) {
                Entry::Occupied(entry) => entry.into_mut(),
                Entry::Vacant(entry) => entry.insert(read_total(connection, counts.id, &counts.added).await?),
            };
            total.add(&counts.added);
            hosts.push((host, counts.id, *total, counts.newest));
        }
        self.write_hosts
            .run(connection, &hosts, |(_, id, total, _), to| {
                to.add(*id)?;
                to.add(now.unix_nanos())?;
                to.add(column(total.events))?;
                to.add(column(total.nodes))?;
                to.add(column(total.gaps))?;
                to.add(column(total.missing))?;
                to.add(column(total.quarantined))
            })
            .await?;
        Ok(hosts.into_iter().map(|(host, _, total, newest)| (host, (total, newest))).collect())
    }

    /// Discards the state that is only in memory, because the transaction failed.
    pub(super) fn forget(&mut self) {
        self.hosts.clear();
        self.runs.clear();
        self.totals.clear();
    }
}

impl HostCounts {
    pub(super) fn add(&mut self, counts: &StoredCounts) {
        self.added.add(counts);
    }
}

impl StoredCounts {
    pub(super) fn add(&mut self, other: &Self) {
        let Self {
            events,
            nodes,
            gaps,
            missing,
            in_other_database,
            unknown_gaps,
            unknown_gaps_in_other_database,
            // The store does not count duplicates; the live state does.
            duplicates: _,
            quarantined,
        } = other;
        self.events = self.events.saturating_add(*events);
        self.nodes = self.nodes.saturating_add(*nodes);
        self.gaps = self.gaps.saturating_add(*gaps);
        self.missing = self.missing.saturating_add(*missing);
        self.in_other_database = self.in_other_database.saturating_add(*in_other_database);
        self.unknown_gaps = self.unknown_gaps.saturating_add(*unknown_gaps);
        self.unknown_gaps_in_other_database =
            self.unknown_gaps_in_other_database.saturating_add(*unknown_gaps_in_other_database);
        self.quarantined = self.quarantined.saturating_add(*quarantined);
    }
}

/// Reads the counters of a host as they were before the transaction. `added` are the transaction's additions until now.
async fn read_total(
    connection: &mut SqliteConnection,
    host: i64,
    added: &StoredCounts,
) -> Result<StoredCounts, sqlx::Error> {
    let columns: CountColumns = sqlx::query_as(concat!(
        "SELECT events, nodes, gaps, missing, quarantined, ",
        gap_columns!(),
        " FROM host WHERE id = ?"
    ))
    .bind(host)
    .fetch_one(connection)
    .await?;
    let mut counts = StoredCounts::from(columns);
    // These three counts are read from the table of gaps, which already has the gaps of this transaction.
    counts.in_other_database = counts.in_other_database.saturating_sub(added.in_other_database);
    counts.unknown_gaps = counts.unknown_gaps.saturating_sub(added.unknown_gaps);
    counts.unknown_gaps_in_other_database =
        counts.unknown_gaps_in_other_database.saturating_sub(added.unknown_gaps_in_other_database);
    Ok(counts)
}
