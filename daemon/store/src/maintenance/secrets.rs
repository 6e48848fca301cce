//! Clearing of host secrets by an operator.

use std::path::{Path, PathBuf};

use peernet_logger::HostId;
use sqlx::{ConnectOptions, Connection};

use super::BUSY_TIMEOUT;
use crate::database;
use crate::database_error::DatabaseError;
use crate::file_kind::FileKind;
use crate::foreign_log::{ForeignLog, refuse_foreign_log_at};

/// Reason why a host's secret was not cleared.
#[derive(Debug, thiserror::Error)]
pub enum ClearSecretError {
    /// The database does not exist.
    #[error("there is no database {}; give the file that the key `database` of [aggregator] names", .0.display())]
    Missing(PathBuf),
    /// The file is of another kind.
    #[error("cannot clear a host's secret in {}: the file is {what}", .path.display())]
    NotADatabase {
        /// The file.
        path: PathBuf,
        /// Kind of the file.
        what: &'static str,
    },
    /// The write-ahead log of another database lies beside the file.
    #[error(transparent)]
    ForeignLog(#[from] ForeignLog),
    /// No host has this id or name.
    #[error("the database {} has no host {host}; /api/v1/hosts lists names and ids", .path.display())]
    NoHost {
        /// The database.
        path: PathBuf,
        /// The given id or name.
        host: String,
    },
    /// Several hosts have this name.
    #[error("{} hosts have had the name {name}; give the id of one of them: {}", .ids.len(), .ids.join(", "))]
    SeveralHosts {
        /// The name.
        name: String,
        /// The ids of these hosts.
        ids: Vec<String>,
    },
    /// SQLite reported an error.
    #[error("cannot clear a host's secret in the database {}: {source}", .path.display())]
    Database {
        /// The database.
        path: PathBuf,
        /// SQLite's error.
        source: DatabaseError,
    },
}

/// Result of clearing the secret of a host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClearedSecret {
    /// Id of the host.
    pub host: String,
    /// Name of the host.
    pub name: String,
    /// `true` if the host had a secret.
    pub existed: bool,
}

/// Clears the secret of the host with this id or name, so that the secret of the next agent with this host id is
/// stored.
///
/// A running aggregator notices the change when the host proves a secret that the aggregator does not know: it then
/// reads the secret again.
///
/// # Errors
/// When there is no such database or host, or the database cannot be written.
pub async fn clear_host_secret(path: &Path, host: &str) -> Result<ClearedSecret, ClearSecretError> {
    if !path.is_file() {
        return Err(ClearSecretError::Missing(path.to_owned()));
    }
    refuse_foreign_log_at(path)?;
    let failed = |error: sqlx::Error| ClearSecretError::Database {
        path: path.to_owned(),
        source: DatabaseError::new(error),
    };
    let options = database::write_options(path).create_if_missing(false).busy_timeout(BUSY_TIMEOUT);
    let mut connection = options.connect().await.map_err(failed)?;
    let kind = FileKind::detect(&mut connection).await.map_err(failed)?;
    if let Some(what) = kind.other_kind() {
        return Err(ClearSecretError::NotADatabase { path: path.to_owned(), what });
    }
    let id = host.parse::<HostId>().ok().map(|id| id.to_string());
    let hosts: Vec<(i64, String, String)> = sqlx::query_as(
        "SELECT id, uuid, coalesce(name, uuid) FROM host WHERE uuid = coalesce(?1, '') OR (?1 IS NULL AND name = ?2)",
    )
    .bind(id)
    .bind(host)
    .fetch_all(&mut connection)
    .await
    .map_err(failed)?;
    let (row, uuid, name) = match <[_; 1]>::try_from(hosts) {
        Ok([host]) => host,
        Err(hosts) if hosts.is_empty() => {
            return Err(ClearSecretError::NoHost { path: path.to_owned(), host: host.to_owned() });
        }
        Err(hosts) => {
            let ids = hosts.into_iter().map(|(_, uuid, _)| uuid).collect();
            return Err(ClearSecretError::SeveralHosts { name: host.to_owned(), ids });
        }
    };
    let deletion = sqlx::query("DELETE FROM host_secret WHERE host = ?").bind(row);
    let result = deletion.execute(&mut connection).await.map_err(failed)?;
    connection.close().await.map_err(failed)?;
    Ok(ClearedSecret { host: uuid, name, existed: result.rows_affected() > 0 })
}
