//! Hosts, pipelines, runs and streams: what the rows of iterations refer to.

use std::collections::HashMap;
use std::str::FromStr;

use peernet_clock::WallTime;
use peernet_logger::stream::{HostDescription, PlacementKind, RunDescription, RunEnded};
use peernet_logger::{HostId, RunId};
use serde::Serialize;
use sqlx::SqliteConnection;

use super::{Refusal, RunName};
use crate::picture::Stored;

/// Runs kept in memory; beyond, all are forgotten and read again when needed.
const MOST_RUNS: usize = 10_000;
/// Stands for what is not known of a run whose beginning never arrived.
pub(crate) const UNKNOWN: &str = "unknown";

/// What the writer remembers of the small tables.
#[derive(Debug, Default)]
pub(super) struct Entities {
    hosts: HashMap<HostId, i64>,
    runs: HashMap<RunId, KnownRun>,
    /// Runs that came into `runs` since they were last asked for.
    met: Vec<(RunId, i64)>,
    /// Runs that were made without their beginning since they were last asked for.
    unknown: Vec<RunId>,
}

/// A run that exists in the store.
#[derive(Clone, Copy, Debug)]
pub(super) struct KnownRun {
    pub(super) number: i64,
    host: i64,
}

impl Entities {
    /// The row of a host, made when missing.
    pub(super) async fn host(
        &mut self,
        connection: &mut SqliteConnection,
        host: HostId,
        now: WallTime,
    ) -> Result<i64, Refusal> {
        if let Some(id) = self.hosts.get(&host) {
            return Ok(*id);
        }
        // The update changes nothing: it makes RETURNING answer for a row that was there.
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

    /// The row of a host, if there is one.
    pub(super) async fn known_host(
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

    /// Takes down how a host introduced itself.
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

    /// The run that rows of `host` refer to; one is made when its beginning never arrived.
    pub(super) async fn run_of(
        &mut self,
        connection: &mut SqliteConnection,
        host: i64,
        run: RunId,
        seen: WallTime,
    ) -> Result<KnownRun, Refusal> {
        let known = match self.known_run(connection, run).await? {
            Some(known) => known,
            None => {
                let pipeline = pipeline(connection, host, UNKNOWN).await?;
                let number = sqlx::query_scalar(
                    "INSERT INTO run (uuid, pipeline, started_ns, placement, model, facts, configuration, version) \
                     VALUES (?1, ?2, ?3, 'local', ?4, '[]', '', '') RETURNING number",
                )
                .bind(run.to_string())
                .bind(pipeline)
                .bind(seen.unix_nanos())
                .bind(UNKNOWN)
                .fetch_one(connection)
                .await?;
                self.unknown.push(run);
                self.remember(run, KnownRun { number, host })
            }
        };
        known.check(host, run)
    }

    /// The run, if it exists.
    pub(super) async fn known_run(
        &mut self,
        connection: &mut SqliteConnection,
        run: RunId,
    ) -> Result<Option<KnownRun>, Refusal> {
        if let Some(known) = self.runs.get(&run) {
            return Ok(Some(*known));
        }
        let row: Option<(i64, i64)> = sqlx::query_as(
            "SELECT run.number, pipeline.host FROM run JOIN pipeline ON pipeline.id = run.pipeline WHERE run.uuid = ?",
        )
        .bind(run.to_string())
        .fetch_optional(connection)
        .await?;
        Ok(row.map(|(number, host)| self.remember(run, KnownRun { number, host })))
    }

    /// A run began; or its description arrives after some of its iterations. Returns it and its pipeline.
    pub(super) async fn run_started(
        &mut self,
        connection: &mut SqliteConnection,
        host: i64,
        run: &RunDescription,
    ) -> Result<(KnownRun, i64), Refusal> {
        if let Some(known) = self.known_run(connection, run.run).await? {
            known.check(host, run.run)?;
        }
        let pipeline = pipeline(connection, host, run.pipeline.as_str()).await?;
        let facts = json(&run.facts)?;
        let experiment = run.experiment.as_ref().map(json).transpose()?;
        let conditions = (!run.conditions.is_empty()).then(|| json(&run.conditions)).transpose()?;
        let placement = &run.placement;
        let number = sqlx::query_scalar(
            "INSERT INTO run (uuid, pipeline, started_ns, placement, peer, network, address, model, device, facts, \
             configuration, version, experiment, conditions) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?) \
             ON CONFLICT (uuid) DO UPDATE SET pipeline = excluded.pipeline, started_ns = excluded.started_ns, \
             placement = excluded.placement, peer = excluded.peer, network = excluded.network, \
             address = excluded.address, model = excluded.model, device = excluded.device, facts = excluded.facts, \
             configuration = excluded.configuration, version = excluded.version, \
             experiment = excluded.experiment, conditions = excluded.conditions \
             RETURNING number",
        )
        .bind(run.run.to_string())
        .bind(pipeline)
        .bind(run.started.unix_nanos())
        .bind(placement_word(placement.kind))
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
        Ok((self.remember(run.run, KnownRun { number, host }), pipeline))
    }

    /// The live lane names a run. What its beginning told, or will tell, counts more.
    pub(super) async fn name_run(
        &mut self,
        connection: &mut SqliteConnection,
        name: &RunName,
        now: WallTime,
    ) -> Result<(), Refusal> {
        let host = self.host(connection, name.host, now).await?;
        let Some(known) = self.known_run(connection, name.run).await?.filter(|known| known.host == host)
        else {
            return Ok(());
        };
        let pipeline = pipeline(connection, host, name.pipeline.as_str()).await?;
        let placement = &name.placement;
        sqlx::query(
            "UPDATE run SET pipeline = ?, placement = ?, peer = ?, network = ?, address = ?, model = ?, device = ? \
             WHERE number = ? AND model = ? AND version = ''",
        )
        .bind(pipeline)
        .bind(placement_word(placement.kind))
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

    /// A run ended.
    pub(super) async fn run_ended(
        &mut self,
        connection: &mut SqliteConnection,
        host: i64,
        end: &RunEnded,
    ) -> Result<(), Refusal> {
        let run = self.run_of(connection, host, end.run, end.ended).await?;
        sqlx::query("UPDATE run SET ended_ns = ?, end_reason = ? WHERE number = ?")
            .bind(end.ended.unix_nanos())
            .bind(end.reason.as_str())
            .bind(run.number)
            .execute(connection)
            .await?;
        Ok(())
    }

    /// Forgets what is only in memory: the transaction did not end well.
    pub(super) fn forget(&mut self) {
        self.hosts.clear();
        self.runs.clear();
        self.met.clear();
        self.unknown.clear();
    }

    fn remember(&mut self, run: RunId, known: KnownRun) -> KnownRun {
        if self.runs.len() >= MOST_RUNS {
            self.runs.clear();
        }
        self.runs.insert(run, known);
        self.met.push((run, known.number));
        known
    }

    /// Runs that were met since the last time, with their numbers.
    pub(super) fn take_met(&mut self) -> Vec<(RunId, i64)> {
        std::mem::take(&mut self.met)
    }

    /// Runs that were made without their beginning since the last time.
    pub(super) fn take_unknown(&mut self) -> Vec<RunId> {
        std::mem::take(&mut self.unknown)
    }
}

impl KnownRun {
    /// Whether rows of that host may refer to it.
    pub(super) fn is_of(self, host: i64) -> bool {
        self.host == host
    }

    fn check(self, host: i64, run: RunId) -> Result<Self, Refusal> {
        if self.host == host {
            Ok(self)
        } else {
            Err(Refusal::Batch(format!("run {run} belongs to another host")))
        }
    }
}

/// As in the column `placement`.
pub(crate) const fn placement_word(kind: PlacementKind) -> &'static str {
    match kind {
        PlacementKind::Local => "local",
        PlacementKind::Remote => "remote",
        PlacementKind::None => "none",
    }
}

fn json<T: Serialize>(value: &T) -> Result<String, Refusal> {
    serde_json::to_string(value).map_err(|error| Refusal::Batch(error.to_string()))
}

async fn pipeline(connection: &mut SqliteConnection, host: i64, name: &str) -> Result<i64, Refusal> {
    let id = sqlx::query_scalar(
        "INSERT INTO pipeline (host, name) VALUES (?, ?) ON CONFLICT DO UPDATE SET name = name RETURNING id",
    )
    .bind(host)
    .bind(name)
    .fetch_one(connection)
    .await?;
    Ok(id)
}

/// The newest runs and their numbers.
pub(crate) async fn newest_runs(
    connection: &mut SqliteConnection,
    limit: u32,
) -> Result<Vec<(RunId, i64)>, sqlx::Error> {
    let rows: Vec<(String, i64)> =
        sqlx::query_as("SELECT uuid, number FROM run ORDER BY number DESC LIMIT ?")
            .bind(limit)
            .fetch_all(connection)
            .await?;
    rows.into_iter().map(|(uuid, number)| Ok((id(&uuid)?, number))).collect()
}

/// Open runs of which the store knows iterations only.
pub(crate) async fn unknown_runs(
    connection: &mut SqliteConnection,
    limit: u32,
) -> Result<Vec<RunId>, sqlx::Error> {
    let rows: Vec<String> = sqlx::query_scalar(
        "SELECT uuid FROM run WHERE ended_ns IS NULL AND model = ? AND version = '' ORDER BY number DESC LIMIT ?",
    )
    .bind(UNKNOWN)
    .bind(limit)
    .fetch_all(connection)
    .await?;
    rows.iter().map(|uuid| id(uuid)).collect()
}

/// What is stored of the hosts that were seen last.
pub(crate) async fn stored_hosts(
    connection: &mut SqliteConnection,
    limit: u32,
) -> Result<Vec<(HostId, Stored)>, sqlx::Error> {
    let rows: Vec<(String, i64, i64, i64, i64, i64)> = sqlx::query_as(
        "SELECT uuid, events, nodes, gaps, missing, quarantined FROM host ORDER BY last_seen_ns DESC LIMIT ?",
    )
    .bind(limit)
    .fetch_all(connection)
    .await?;
    rows.into_iter()
        .map(|(uuid, events, nodes, gaps, missing, quarantined)| {
            Ok((id(&uuid)?, Stored::of_columns((events, nodes, gaps, missing, quarantined))))
        })
        .collect()
}

pub(super) fn id<T: FromStr<Err = uuid::Error>>(text: &str) -> Result<T, sqlx::Error> {
    text.parse().map_err(|error: uuid::Error| sqlx::Error::Decode(error.into()))
}
