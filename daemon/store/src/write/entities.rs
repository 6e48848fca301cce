//! Storing and lookup of hosts, pipelines and runs, to which the rows of iterations refer.

use std::collections::HashMap;
use std::str::FromStr;

use peernet_clock::WallTime;
use peernet_logger::{HostId, RunId};
use peernet_stream::{HostDescription, RunDescription, RunEnded};
use serde::Serialize;
use sqlx::{FromRow, SqliteConnection};

use super::{LiveRunDescription, Refusal};
use crate::stored::{CountColumns, StoredCounts, gap_columns};

/// Maximum number of runs in the cache. When it is reached, all cached runs are discarded. A run is read again when it
/// is needed.
const MAX_CACHED_RUNS: usize = 10_000;
/// Pipeline and model of a run whose start has not arrived.
pub(crate) const UNKNOWN: &str = "unknown";

/// The host whose batch or message is being stored.
///
/// Runs are looked up by their reporter, never by their id alone: no kind of event can find or change the run of
/// another host.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reporter {
    pub(super) id: HostId,
    /// Id of the host's row in the table `host`.
    pub(super) row: i64,
}

/// The writer's cache of the small tables.
#[derive(Debug, Default)]
pub(super) struct Entities {
    /// Ids of the rows of hosts.
    hosts: HashMap<HostId, i64>,
    /// Runs by the reporting host's row and the id under which it reports the run.
    runs: HashMap<(i64, RunId), KnownRun>,
    /// Runs that were added to `runs` since `take_loaded_runs` was last called.
    loaded_runs: Vec<(HostId, RunId, i64)>,
    /// Runs that were created without a start event since `take_runs_without_start` was last called.
    runs_without_start: Vec<(HostId, RunId)>,
}

/// A run that exists in the store.
#[derive(Clone, Copy, Debug)]
pub(super) struct KnownRun {
    pub(super) number: i64,
    /// Id under which the run is stored. It differs from the reported id if another host used that id first. So no host
    /// can prevent another host from storing a run by using the run's id first.
    uuid: RunId,
}

/// Result of looking up a run id.
#[derive(Clone, Copy, Debug)]
struct Lookup {
    /// The reporter's run with this id.
    reporters_run: Option<KnownRun>,
    /// `true` if any host has a run with this id. Valid only if `reporters_run` is `None`.
    is_taken: bool,
}

impl Entities {
    /// Returns the row of a host and creates it if it is missing.
    pub(super) async fn host(
        &mut self,
        connection: &mut SqliteConnection,
        host: HostId,
        now: WallTime,
    ) -> Result<i64, Refusal> {
        if let Some(id) = self.hosts.get(&host) {
            return Ok(*id);
        }
        // The update changes nothing. Without it, RETURNING would return no row for a host that exists already.
        let id = sqlx::query_scalar(
            "INSERT INTO host (uuid, first_seen_ns, last_seen_ns) VALUES (?1, ?2, ?2) \
             ON CONFLICT (uuid) DO UPDATE SET uuid = uuid RETURNING id",
        )
        .bind(host.to_string())
        .bind(now.unix_nanos())
        .fetch_one(connection)
        .await?;
        self.hosts.insert(host, id);
        Ok(id)
    }

    /// Returns the row of a host, if the host is stored.
    pub(super) async fn find_host(
        &self,
        connection: &mut SqliteConnection,
        host: HostId,
    ) -> Result<Option<i64>, Refusal> {
        if let Some(id) = self.hosts.get(&host) {
            return Ok(Some(*id));
        }
        let id = sqlx::query_scalar("SELECT id FROM host WHERE uuid = ?").bind(host.to_string());
        Ok(id.fetch_optional(connection).await?)
    }

    /// Stores a host's description of itself.
    pub(super) async fn introduce(
        &mut self,
        connection: &mut SqliteConnection,
        description: &HostDescription,
        now: WallTime,
    ) -> Result<i64, Refusal> {
        let id = self.host(connection, description.id, now).await?;
        let json = json(description)?;
        sqlx::query("UPDATE host SET name = ?, description = ?, last_seen_ns = ? WHERE id = ?")
            .bind(description.name.as_str())
            .bind(json)
            .bind(now.unix_nanos())
            .bind(id)
            .execute(connection)
            .await?;
        Ok(id)
    }

    /// Returns the reporter's run with this id. If the run is not stored, because its start event has not arrived, the
    /// run is created. Until the start event arrives, `seen_at` counts as the start of the run.
    pub(super) async fn find_or_create_run(
        &mut self,
        connection: &mut SqliteConnection,
        reporter: Reporter,
        run: RunId,
        seen_at: WallTime,
    ) -> Result<KnownRun, Refusal> {
        let lookup = self.look_up(connection, reporter, run).await?;
        if let Some(reporters_run) = lookup.reporters_run {
            return Ok(reporters_run);
        }
        let (uuid, reported) = lookup.ids(run);
        let pipeline = pipeline(connection, reporter.row, UNKNOWN).await?;
        let number = sqlx::query_scalar(
            "INSERT INTO run (uuid, reported_uuid, pipeline, started_ns, placement, model, facts, configuration, version) \
             VALUES (?1, ?2, ?3, ?4, 'local', ?5, '[]', '', '') RETURNING number",
        )
        .bind(uuid.to_string())
        .bind(reported.map(|run| run.to_string()))
        .bind(pipeline)
        .bind(seen_at.unix_nanos())
        .bind(UNKNOWN)
        .fetch_one(connection)
        .await?;
        self.runs_without_start.push((reporter.id, run));
        Ok(self.remember(reporter, run, KnownRun { number, uuid }))
    }

    /// Returns the reporter's run with this id, if it exists.
    pub(super) async fn find_run(
        &mut self,
        connection: &mut SqliteConnection,
        reporter: Reporter,
        run: RunId,
    ) -> Result<Option<KnownRun>, Refusal> {
        Ok(self.look_up(connection, reporter, run).await?.reporters_run)
    }

    /// Returns whether a run with this id belongs to another host and no run with this id belongs to the reporter.
    pub(super) async fn is_foreign(
        &mut self,
        connection: &mut SqliteConnection,
        reporter: Reporter,
        run: RunId,
    ) -> Result<bool, Refusal> {
        let lookup = self.look_up(connection, reporter, run).await?;
        Ok(lookup.reporters_run.is_none() && lookup.is_taken)
    }

    /// Looks up a run id.
    async fn look_up(
        &mut self,
        connection: &mut SqliteConnection,
        reporter: Reporter,
        run: RunId,
    ) -> Result<Lookup, Refusal> {
        if let Some(known) = self.runs.get(&(reporter.row, run)) {
            return Ok(Lookup { reporters_run: Some(*known), is_taken: false });
        }
        let rows: Vec<(i64, String, i64)> = sqlx::query_as(
            "SELECT run.number, run.uuid, pipeline.host FROM run JOIN pipeline ON pipeline.id = run.pipeline \
             WHERE run.uuid = ?1 OR run.reported_uuid = ?1",
        )
        .bind(run.to_string())
        .fetch_all(connection)
        .await?;
        // Both columns are searched: the reporter's run is stored under another id if the reported id was taken.
        let is_taken = !rows.is_empty();
        let reporters_run = rows.into_iter().find(|(_, _, host)| *host == reporter.row);
        let reporters_run = reporters_run
            .map(|(number, uuid, _)| Ok::<_, sqlx::Error>(KnownRun { number, uuid: id(&uuid)? }))
            .transpose()?;
        let reporters_run = reporters_run.map(|reporters_run| self.remember(reporter, run, reporters_run));
        Ok(Lookup { reporters_run, is_taken })
    }

    /// Stores a run's description, which may arrive after some of its iterations. Returns the run and its pipeline.
    pub(super) async fn store_run_start(
        &mut self,
        connection: &mut SqliteConnection,
        reporter: Reporter,
        run: &RunDescription,
    ) -> Result<(KnownRun, i64), Refusal> {
        let (uuid, reported) = self.look_up(connection, reporter, run.run).await?.ids(run.run);
        // If the run exists already, because an iteration arrived first, its number stays: stored rows refer to it.
        let pipeline = pipeline(connection, reporter.row, run.pipeline.as_str()).await?;
        let facts = json(&run.facts)?;
        let experiment = run.experiment.as_ref().map(json).transpose()?;
        let conditions = (!run.conditions.is_empty()).then(|| json(&run.conditions)).transpose()?;
        let placement = &run.placement;
        let number = sqlx::query_scalar(
            "INSERT INTO run (uuid, reported_uuid, pipeline, started_ns, placement, peer, network, address, model, device, \
             facts, configuration, version, experiment, conditions) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?) \
             ON CONFLICT (uuid) DO UPDATE SET pipeline = excluded.pipeline, started_ns = excluded.started_ns, \
             placement = excluded.placement, peer = excluded.peer, network = excluded.network, \
             address = excluded.address, model = excluded.model, device = excluded.device, facts = excluded.facts, \
             configuration = excluded.configuration, version = excluded.version, \
             experiment = excluded.experiment, conditions = excluded.conditions \
             RETURNING number",
        )
        .bind(uuid.to_string())
        .bind(reported.map(|run| run.to_string()))
        .bind(pipeline)
        .bind(run.started.unix_nanos())
        .bind(placement.kind.name())
        .bind(placement.peer.as_ref().map(ToString::to_string))
        .bind(placement.network.as_deref())
        .bind(placement.address.as_deref())
        .bind(placement.model.as_str())
        .bind(placement.device.as_deref())
        .bind(facts)
        .bind(run.configuration.as_str())
        .bind(run.version.as_str())
        .bind(experiment)
        .bind(conditions)
        .fetch_one(connection)
        .await?;
        Ok((self.remember(reporter, run.run, KnownRun { number, uuid }), pipeline))
    }

    /// Stores a run's pipeline and placement from a live update. The run's start event takes precedence,
    /// whether it arrived before or arrives later.
    pub(super) async fn describe_run(
        &mut self,
        connection: &mut SqliteConnection,
        description: &LiveRunDescription,
        now: WallTime,
    ) -> Result<(), Refusal> {
        let reporter =
            Reporter { id: description.host, row: self.host(connection, description.host, now).await? };
        let Some(known) = self.find_run(connection, reporter, description.run).await? else { return Ok(()) };
        let pipeline = pipeline(connection, reporter.row, description.pipeline.as_str()).await?;
        let placement = &description.placement;
        // The condition on `version` leaves a run unchanged whose start event has arrived. The condition on `model`
        // leaves a run unchanged that already has its pipeline and placement from a live update.
        sqlx::query(
            "UPDATE run SET pipeline = ?, placement = ?, peer = ?, network = ?, address = ?, model = ?, device = ? \
             WHERE number = ? AND model = ? AND version = ''",
        )
        .bind(pipeline)
        .bind(placement.kind.name())
        .bind(placement.peer.as_ref().map(ToString::to_string))
        .bind(placement.network.as_deref())
        .bind(placement.address.as_deref())
        .bind(placement.model.as_str())
        .bind(placement.device.as_deref())
        .bind(known.number)
        .bind(UNKNOWN)
        .execute(connection)
        .await?;
        Ok(())
    }

    /// Stores the end of a run.
    pub(super) async fn store_run_end(
        &mut self,
        connection: &mut SqliteConnection,
        reporter: Reporter,
        end: &RunEnded,
    ) -> Result<(), Refusal> {
        // The end may be the only event of the run that arrived.
        let run = self.find_or_create_run(connection, reporter, end.run, end.ended).await?;
        sqlx::query("UPDATE run SET ended_ns = ?, end_reason = ? WHERE number = ?")
            .bind(end.ended.unix_nanos())
            .bind(end.reason.as_str())
            .bind(run.number)
            .execute(connection)
            .await?;
        Ok(())
    }

    /// Discards the state that is only in memory, because the transaction failed.
    pub(super) fn forget(&mut self) {
        self.hosts.clear();
        self.runs.clear();
        self.loaded_runs.clear();
        self.runs_without_start.clear();
    }

    /// Adds a run to the cache.
    fn remember(&mut self, reporter: Reporter, run: RunId, known: KnownRun) -> KnownRun {
        // Discarding the whole cache costs little: only the few active runs are read again.
        if self.runs.len() >= MAX_CACHED_RUNS {
            self.runs.clear();
        }
        self.runs.insert((reporter.row, run), known);
        self.loaded_runs.push((reporter.id, run, known.number));
        known
    }

    /// Returns the runs that were added to the cache since the last call, with their numbers.
    pub(super) fn take_loaded_runs(&mut self) -> Vec<(HostId, RunId, i64)> {
        std::mem::take(&mut self.loaded_runs)
    }

    /// Returns the runs that were created without a start event since the last call.
    pub(super) fn take_runs_without_start(&mut self) -> Vec<(HostId, RunId)> {
        std::mem::take(&mut self.runs_without_start)
    }
}

impl Lookup {
    /// Returns the id under which the reporter's run is stored. If the reporter uses another id for this run, also
    /// returns that id.
    fn ids(&self, run: RunId) -> (RunId, Option<RunId>) {
        let uuid = match self.reporters_run {
            Some(reporters_run) => reporters_run.uuid,
            // Another host has stored a run with this id first.
            None if self.is_taken => RunId::random(),
            None => run,
        };
        (uuid, (uuid != run).then_some(run))
    }
}

fn json<T: Serialize>(value: &T) -> Result<String, Refusal> {
    // A further attempt would fail as well, so the error is attributed to the batch and not to the database.
    serde_json::to_string(value).map_err(|error| Refusal::Batch(error.to_string()))
}

/// Returns the id of a pipeline. Adds the pipeline if it is missing.
async fn pipeline(connection: &mut SqliteConnection, host: i64, name: &str) -> Result<i64, Refusal> {
    // The update changes nothing. Without it, RETURNING would return no row for a pipeline that exists already.
    let id = sqlx::query_scalar(
        "INSERT INTO pipeline (host, name) VALUES (?, ?) ON CONFLICT DO UPDATE SET name = name RETURNING id",
    )
    .bind(host)
    .bind(name)
    .fetch_one(connection)
    .await?;
    Ok(id)
}

/// Returns the newest runs: for each run its host, the id under which the host reports the run, and the run's number.
pub(crate) async fn read_newest_runs(
    connection: &mut SqliteConnection,
    limit: u32,
) -> Result<Vec<(HostId, RunId, i64)>, sqlx::Error> {
    let rows: Vec<(String, String, i64)> = sqlx::query_as(
        "SELECT host.uuid, coalesce(run.reported_uuid, run.uuid), run.number FROM run \
         JOIN pipeline ON pipeline.id = run.pipeline JOIN host ON host.id = pipeline.host \
         ORDER BY run.number DESC LIMIT ?",
    )
    .bind(limit)
    .fetch_all(connection)
    .await?;
    rows.into_iter().map(|(host, run, number)| Ok((id(&host)?, id(&run)?, number))).collect()
}

/// Returns the runs that have not ended and have stored iterations but no stored start, with their hosts. Runs whose
/// pipeline was stored from a live update are left out.
pub(crate) async fn read_runs_without_start(
    connection: &mut SqliteConnection,
    limit: u32,
) -> Result<Vec<(HostId, RunId)>, sqlx::Error> {
    let rows: Vec<(String, String)> = sqlx::query_as(
        "SELECT host.uuid, coalesce(run.reported_uuid, run.uuid) FROM run \
         JOIN pipeline ON pipeline.id = run.pipeline JOIN host ON host.id = pipeline.host \
         WHERE run.ended_ns IS NULL AND run.model = ? AND run.version = '' ORDER BY run.number DESC LIMIT ?",
    )
    .bind(UNKNOWN)
    .bind(limit)
    .fetch_all(connection)
    .await?;
    rows.iter().map(|(host, run)| Ok((id(host)?, id(run)?))).collect()
}

/// Returns the counts of the hosts that were seen last. Hosts without a name are left out: they have not introduced
/// themselves, and only events of other hosts name them.
pub(crate) async fn read_host_counts(
    connection: &mut SqliteConnection,
    limit: u32,
) -> Result<Vec<(HostId, StoredCounts)>, sqlx::Error> {
    #[derive(FromRow)]
    struct Host {
        uuid: String,
        #[sqlx(flatten)]
        counts: CountColumns,
    }
    let rows: Vec<Host> = sqlx::query_as(concat!(
        "SELECT uuid, events, nodes, gaps, missing, quarantined, ",
        gap_columns!(),
        " FROM host WHERE name IS NOT NULL ORDER BY last_seen_ns DESC LIMIT ?",
    ))
    .bind(limit)
    .fetch_all(connection)
    .await?;
    rows.into_iter().map(|row| Ok((id(&row.uuid)?, StoredCounts::from(row.counts)))).collect()
}

/// Parses a stored id.
pub(super) fn id<T: FromStr<Err = uuid::Error>>(text: &str) -> Result<T, sqlx::Error> {
    text.parse().map_err(|error: uuid::Error| sqlx::Error::Decode(error.into()))
}
