//! Secrets of hosts. A secret is stored with the host's first events (trust on first use). The
//! aggregator reads all secrets when it starts, and the secret of one host after a wrong proof.

use std::collections::HashMap;

use peernet_clock::WallTime;
use peernet_logger::HostId;
use peernet_stream::HostSecret;
use sqlx::SqliteConnection;

use super::entities::id;

/// Stores the secret of a host unless the host has a stored secret.
pub(super) async fn enrol(
    connection: &mut SqliteConnection,
    host: i64,
    secret: &HostSecret,
    now: WallTime,
) -> Result<(), sqlx::Error> {
    sqlx::query(
        "INSERT INTO host_secret (host, secret, enrolled_ns) VALUES (?, ?, ?) ON CONFLICT (host) DO NOTHING",
    )
    .bind(host)
    .bind(secret.expose_bytes().as_slice())
    .bind(now.unix_nanos())
    .execute(connection)
    .await?;
    Ok(())
}

/// Reads the secret of one host again, because an operator may have cleared it.
pub(super) async fn read_host_secret(
    connection: &mut SqliteConnection,
    host: HostId,
) -> Result<Option<HostSecret>, sqlx::Error> {
    let row: Option<Vec<u8>> = sqlx::query_scalar(
        "SELECT host_secret.secret FROM host_secret JOIN host ON host.id = host_secret.host WHERE host.uuid = ?",
    )
    .bind(host.to_string())
    .fetch_optional(connection)
    .await?;
    row.map(decode_secret).transpose()
}

/// Returns the hosts that have introduced themselves and have stored events, gaps or quarantined batches, by ascending
/// row id, with their secrets. Hosts that are only named in events of other hosts are left out.
pub(crate) async fn read_host_secrets(
    connection: &mut SqliteConnection,
) -> Result<Vec<(HostId, Option<HostSecret>)>, sqlx::Error> {
    let secrets: Vec<(i64, Vec<u8>)> =
        sqlx::query_as("SELECT host, secret FROM host_secret").fetch_all(&mut *connection).await?;
    let secrets: Result<HashMap<i64, HostSecret>, sqlx::Error> =
        secrets.into_iter().map(|(host, bytes)| Ok((host, decode_secret(bytes)?))).collect();
    let mut secrets = secrets?;
    let hosts: Vec<(i64, String)> = sqlx::query_as(
        "SELECT id, uuid FROM host WHERE name IS NOT NULL AND (events > 0 OR gaps > 0 OR quarantined > 0) ORDER BY id",
    )
    .fetch_all(connection)
    .await?;
    hosts.into_iter().map(|(row, uuid)| Ok((id(&uuid)?, secrets.remove(&row)))).collect()
}

/// Decodes a stored secret.
fn decode_secret(bytes: Vec<u8>) -> Result<HostSecret, sqlx::Error> {
    let bytes = bytes
        .try_into()
        .map_err(|_| sqlx::Error::Decode("a host secret that is not 32 bytes long".into()))?;
    Ok(HostSecret::from_bytes(bytes))
}
