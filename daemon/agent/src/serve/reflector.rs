//! Opens the reflectors that answer peers' probes.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;

use peernet_clock::SharedClock;
use peernet_networks::{Address, ProbeKey};
use peernet_probes::{Key, Reflector, ReflectorConfig};

use crate::config::ProbesConfig;
use crate::error::ReflectorError;
use crate::link::ProbeSettings;

/// Settings of the reflectors.
#[derive(Clone, Copy, Debug)]
pub(super) struct ReflectorSettings<'a> {
    pub(super) probe_settings: &'a ProbeSettings,
    pub(super) instance: u64,
    /// Key that is sent to peers with a session.
    pub(super) session_key: Option<ProbeKey>,
}

/// Binds reflectors to the addresses at which peers connect. Returns one reflector for each IP address, and the port of
/// the reflector for each address in `listen`.
pub(super) async fn bind_all(
    listen: &[Address],
    config: &ProbesConfig,
    reflector_settings: ReflectorSettings<'_>,
    clock: &SharedClock,
) -> Result<(Vec<Reflector>, Vec<Option<u16>>), ReflectorError> {
    let port = config.port.unwrap_or(ProbesConfig::DEFAULT_PORT);
    let mut probe_addresses = Vec::with_capacity(listen.len());
    for address in listen {
        let at = resolve(address, port)
            .await
            .map_err(|error| ReflectorError::Address { listen: address.clone(), source: error })?;
        probe_addresses.push(at);
    }
    let mut addresses_by_reach = probe_addresses.clone();
    // Addresses of all interfaces come first, because their reflectors also answer for each single address.
    addresses_by_reach.sort_by_key(|at| !at.ip().is_unspecified());
    let mut reflectors: Vec<Reflector> = Vec::new();
    for at in addresses_by_reach {
        if find_port(&reflectors, at.ip()).is_none() {
            reflectors.push(bind(at, config, reflector_settings, clock)?);
        }
    }
    let ports = probe_addresses.iter().map(|at| find_port(&reflectors, at.ip())).collect();
    Ok((reflectors, ports))
}

/// Returns the port of the reflector that answers at an IP address.
fn find_port(reflectors: &[Reflector], ip: IpAddr) -> Option<u16> {
    let is_answered_by =
        |at: &SocketAddr| at.ip() == ip || (at.ip().is_unspecified() && at.ip().is_ipv4() == ip.is_ipv4());
    reflectors.iter().map(Reflector::address).find(is_answered_by).map(|at| at.port())
}

/// Binds to one address. If the default port is taken and no port is configured, any free port is used. Peers get the
/// real port with their session.
fn bind(
    at: SocketAddr,
    config: &ProbesConfig,
    ReflectorSettings { probe_settings, instance, session_key }: ReflectorSettings<'_>,
    clock: &SharedClock,
) -> Result<Reflector, ReflectorError> {
    let bind = |at: SocketAddr| {
        let config = ReflectorConfig {
            listen: at,
            key: probe_settings.key.clone(),
            session_key: session_key.map(|key| Key::from_bytes(key.as_bytes())),
            instance,
            max_per_source_hz: config.max_per_source_hz,
            stamps: probe_settings.stamps,
            // The reflector numbers its replies, so that the sender knows in which direction a probe was lost (RFC
            // 8762, section 4).
            stateful: true,
        };
        Reflector::bind(config, Arc::clone(clock))
    };
    let reflector = match bind(at) {
        Err(peernet_probes::BindError::InUse(_)) if config.port.is_none() => {
            let reflector = bind(SocketAddr::new(at.ip(), 0))?;
            tracing::info!(taken = %at, instead = %reflector.address(), "the default port for probes is in use; probes use another port");
            reflector
        }
        other => other?,
    };
    Ok(reflector)
}

/// Returns the UDP address at which the probes of the peers of `listen` are answered.
async fn resolve(listen: &Address, port: u16) -> io::Result<SocketAddr> {
    if listen.listener_name().is_some() {
        // A name identifies the listener. The host of the address does not belong to the listener: peers may connect on
        // any interface.
        return Ok(SocketAddr::new(Ipv4Addr::UNSPECIFIED.into(), port));
    }
    let host = listen.host();
    let mut addresses = tokio::net::lookup_host((host.as_str(), port)).await?;
    addresses.next().ok_or_else(|| io::Error::new(io::ErrorKind::NotFound, format!("{host} has no address")))
}
