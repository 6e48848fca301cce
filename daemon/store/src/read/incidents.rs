//! Incidents and hosts.

use sqlx::FromRow;

use super::{corrupt_data, parse, sql, wall};
use crate::error::StoreError;
use crate::readers::Readers;
use crate::stored::{CountColumns, StoredCounts};
use crate::types::{HostRow, IncidentFilter, IncidentRow};
use crate::write::UNKNOWN;

#[derive(FromRow)]
struct Incident {
    id: i64,
    at_ns: i64,
    kind: String,
    host: Option<String>,
    host_name: Option<String>,
    pipeline: Option<String>,
    run: Option<i64>,
    peer: Option<String>,
    text: String,
}

/// A row of the table `host`, of a host that has introduced itself.
#[derive(FromRow)]
struct Host {
    uuid: String,
    name: String,
    description: String,
    first_seen_ns: i64,
    last_seen_ns: i64,
    #[sqlx(flatten)]
    counts: CountColumns,
}

pub(crate) async fn incidents(
    readers: &Readers,
    filter: &IncidentFilter,
) -> Result<Vec<IncidentRow>, StoreError> {
    const WHAT: &str = "incidents";
    let rows: Vec<Incident> = sqlx::query_as(sql::INCIDENTS)
        .bind(filter.limit.clamp(1, 1_000))
        .bind(filter.before)
        .bind(filter.kind.as_deref())
        .bind(filter.host.as_deref())
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    rows.into_iter()
        .map(|row| {
            Ok(IncidentRow {
                id: row.id,
                at: wall(row.at_ns),
                kind: row.kind,
                // A host that never introduced itself has no name.
                host_name: match row.host {
                    Some(_) => Some(parse(WHAT, row.host_name.as_deref().unwrap_or(UNKNOWN))?),
                    None => None,
                },
                host: row.host.map(|host| parse(WHAT, &host)).transpose()?,
                pipeline: row.pipeline,
                run: row.run,
                peer: row.peer,
                text: row.text,
            })
        })
        .collect()
}

pub(crate) async fn hosts(readers: &Readers) -> Result<Vec<HostRow>, StoreError> {
    const WHAT: &str = "hosts";
    let rows: Vec<Host> =
        sqlx::query_as(sql::HOSTS).fetch_all(&readers.pool()).await.map_err(readers.error_for(WHAT))?;
    rows.into_iter()
        .map(|row| {
            Ok(HostRow {
                id: parse(WHAT, &row.uuid)?,
                name: parse(WHAT, &row.name)?,
                description: serde_json::from_str(&row.description)
                    .map_err(|error| corrupt_data(WHAT, error))?,
                first_seen: wall(row.first_seen_ns),
                last_seen: wall(row.last_seen_ns),
                stored: StoredCounts::from(row.counts),
            })
        })
        .collect()
}
