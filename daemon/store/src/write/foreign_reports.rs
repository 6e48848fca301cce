//! Reports of hosts on runs of other hosts.
//!
//! Such reports do not change the runs of other hosts, because runs are looked up by their reporter ([`Reporter`]). The
//! attempt is recorded as an incident of the reporting host.

use std::collections::{BTreeSet, HashMap, HashSet};

use peernet_clock::WallTime;
use peernet_logger::{HostId, RunId};
use peernet_stream::IncidentKind;
use sqlx::SqliteConnection;

use super::Refusal;
use super::entities::{Entities, Reporter};

/// Maximum number of foreign runs that are remembered, so that no run causes a second incident. When it is reached, all
/// are forgotten, and a run may cause another incident.
const MAX_REMEMBERED_REPORTS: usize = 10_000;

/// Foreign runs that the current transaction found, and foreign runs that are already recorded in incidents.
#[derive(Debug, Default)]
pub(super) struct ForeignReports {
    /// By the row of the reporting host: the host's id, one of the foreign runs, and the number of foreign runs.
    new_reports: HashMap<i64, (HostId, RunId, u64)>,
    /// Rows of reporting hosts with the foreign runs that they named.
    known_reports: HashSet<(i64, RunId)>,
}

impl ForeignReports {
    /// Finds runs of other hosts among the runs that a batch names (`named_runs`).
    pub(super) async fn check(
        &mut self,
        connection: &mut SqliteConnection,
        entities: &mut Entities,
        reporter: Reporter,
        named_runs: &BTreeSet<RunId>,
    ) -> Result<(), Refusal> {
        for run in named_runs {
            if entities.is_foreign(connection, reporter, *run).await? {
                if self.known_reports.len() >= MAX_REMEMBERED_REPORTS {
                    self.known_reports.clear();
                }
                if self.known_reports.insert((reporter.row, *run)) {
                    self.new_reports.entry(reporter.row).or_insert((reporter.id, *run, 0)).2 += 1;
                }
            }
        }
        Ok(())
    }

    /// Stores one incident for each host that named foreign runs in the transaction which it had not named before.
    pub(super) async fn write(
        &mut self,
        connection: &mut SqliteConnection,
        now: WallTime,
    ) -> Result<(), sqlx::Error> {
        for (row, (host, run, runs)) in self.new_reports.drain() {
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
        self.new_reports.clear();
        self.known_reports.clear();
    }
}
