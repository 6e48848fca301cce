//! The port at which peers' probes are answered.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;

use peernet_clock::SharedClock;
use peernet_networks::Address;
use peernet_probes::{Reflector, ReflectorConfig};

use crate::config::ProbesConfig;
use crate::error::ReflectorError;
use crate::link::ProbeSettings;

/// Binds to the address at which peers are awaited. The standard port may be another program's, as long as nobody
/// insists on it: peers are told which one it is.
pub(super) async fn bind(
    listen: &Address,
    config: &ProbesConfig,
    settings: &ProbeSettings,
    instance: u64,
    clock: &SharedClock,
) -> Result<Reflector, ReflectorError> {
    let port = config.port.unwrap_or(ProbesConfig::DEFAULT_PORT);
    let at = resolve(listen, port)
        .await
        .map_err(|error| ReflectorError::Address { listen: listen.clone(), reason: error.to_string() })?;
    let bind = |at: SocketAddr| {
        let config = ReflectorConfig {
            listen: at,
            key: settings.key.clone(),
            instance,
            max_per_source_hz: config.max_per_source_hz,
            stamps: settings.stamps,
            stateful: true,
        };
        Reflector::bind(config, Arc::clone(clock))
    };
    let reflector = match bind(at) {
        Err(peernet_probes::BindError::InUse(_)) if config.port.is_none() => {
            let any = bind(SocketAddr::new(at.ip(), 0))?;
            tracing::info!(taken = %at, instead = %any.address(), "the usual port for probes is taken");
            any
        }
        other => other?,
    };
    Ok(reflector)
}

async fn resolve(listen: &Address, port: u16) -> io::Result<SocketAddr> {
    let host = listen.host();
    let mut found = tokio::net::lookup_host((host.as_str(), port)).await?;
    found.next().ok_or_else(|| io::Error::new(io::ErrorKind::NotFound, format!("{host} has no address")))
}
