//! Reports of hosts on runs of other hosts.
//!
//! They do not change these runs, because runs are looked up by their reporter ([`Reporter`]). The attempt becomes an
//! incident of the reporting host.

use std::collections::{BTreeSet, HashMap, HashSet};

use peernet_clock::WallTime;
use peernet_logger::{HostId, RunId};
use peernet_stream::IncidentKind;
use sqlx::SqliteConnection;

use super::Refusal;
use super::entities::{Entities, Reporter};

/// Maximum number of runs that are remembered as reported; beyond it, all are forgotten and reported again.
const MAX_REMEMBERED_REPORTS: usize = 10_000;

/// Reports that a transaction found, and reports that earlier transactions recorded as incidents.
#[derive(Debug, Default)]
pub(super) struct ForeignReports {
    /// By the row of the host: its id, one of the runs, and their number.
    found: HashMap<i64, (HostId, RunId, u64)>,
    /// Rows of hosts with the foreign runs that they named.
    reported: HashSet<(i64, RunId)>,
}

impl ForeignReports {
    /// Finds runs of other hosts among the runs that a batch names.
    pub(super) async fn check(
        &mut self,
        connection: &mut SqliteConnection,
        entities: &mut Entities,
        reporter: Reporter,
        claimed: &BTreeSet<RunId>,
    ) -> Result<(), Refusal> {
        for run in claimed {
            if entities.is_foreign(connection, reporter, *run).await? {
                if self.reported.len() >= MAX_REMEMBERED_REPORTS {
                    self.reported.clear();
                }
                if self.reported.insert((reporter.row, *run)) {
                    self.found.entry(reporter.row).or_insert((reporter.id, *run, 0)).2 += 1;
                }
            }
        }
        Ok(())
    }

    /// Stores an incident for each host that named foreign runs.
    pub(super) async fn write(
        &mut self,
        connection: &mut SqliteConnection,
        now: WallTime,
    ) -> Result<(), sqlx::Error> {
        for (row, (host, run, runs)) in self.found.drain() {
            let text = format!(
                "this host reported on {runs} runs that belong to other hosts, such as {run}: its reports are stored as runs \
                 of this host, and the runs of the other hosts are unchanged"
            );
            tracing::warn!(%host, %run, runs, "a host reported on runs of other hosts: stored as runs of this host");
            sqlx::query("INSERT INTO incident (host, at_ns, kind, text) VALUES (?, ?, ?, ?)")
                .bind(row)
                .bind(now.unix_nanos())
                .bind(IncidentKind::Refused.name())
                .bind(text)
                .execute(&mut *connection)
                .await?;
        }
        Ok(())
    }

    /// Discards the state that is only in memory, because the transaction failed.
    pub(super) fn forget(&mut self) {
        self.found.clear();
        self.reported.clear();
    }
}
