//! The address at which other nodes reach a node.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use tokio::net::{TcpListener, UdpSocket, lookup_host};

use super::environment::{RpcUri, listen_address, uri_host};
use super::error::NodeError;

/// Address that a node gives to the master and to other nodes: a host, and a port for each protocol.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct NodeAddress {
    host: String,
    uri: String,
    tcpros_port: u16,
}

/// Open ports of a node.
#[derive(Debug)]
pub(super) struct NodeListeners {
    /// Port of the XML-RPC server.
    pub(super) rpc: TcpListener,
    /// Port for subscribers.
    pub(super) tcpros: TcpListener,
}

impl NodeAddress {
    /// Opens the ports of a node on a host, which is a name or an address of this machine.
    ///
    /// # Errors
    /// If no port can be opened.
    pub(super) async fn listen(host: String) -> Result<(Self, NodeListeners), NodeError> {
        let listeners = NodeListeners { rpc: listen(&host).await?, tcpros: listen(&host).await? };
        let address = Self::new(host, port(&listeners.rpc)?, port(&listeners.tcpros)?);
        Ok((address, listeners))
    }

    fn new(host: String, rpc_port: u16, tcpros_port: u16) -> Self {
        let uri = format!("http://{}:{rpc_port}/", uri_host(&host));
        Self { host, uri, tcpros_port }
    }

    /// Returns the URI of the XML-RPC server.
    pub(super) fn uri(&self) -> &str {
        &self.uri
    }

    /// Returns the host name or address that other nodes connect to.
    pub(super) fn host(&self) -> &str {
        &self.host
    }

    /// Returns the port on which subscribers are accepted.
    pub(super) fn tcpros_port(&self) -> u16 {
        self.tcpros_port
    }
}

async fn listen(host: &str) -> Result<TcpListener, NodeError> {
    let address = SocketAddr::new(listen_address(host), 0);
    TcpListener::bind(address).await.map_err(|source| NodeError::Listen { address, source })
}

fn port(listener: &TcpListener) -> Result<u16, NodeError> {
    // The error needs an address. The actual address is not known if `local_addr` fails.
    let address = SocketAddr::from(([0; 4], 0));
    let local = listener.local_addr().map_err(|source| NodeError::Listen { address, source })?;
    Ok(local.port())
}

/// Returns the host that a node gives to others if no environment variable sets it.
///
/// - Usually the address from which this host reaches the master. Other hosts that reach the master usually reach this
///   address as well.
/// - If the master is on this host or cannot be resolved: the name of this host, if none of its addresses is a loopback
///   address.
/// - Otherwise the loopback address.
pub(super) async fn advertised_host(master: &RpcUri) -> String {
    let local = address_towards(master).await.unwrap_or_else(|_| Ipv4Addr::LOCALHOST.into());
    if !local.is_loopback() {
        return local.to_string();
    }
    let name = rustix::system::uname().nodename().to_string_lossy().into_owned();
    let is_reachable = match lookup_host((name.as_str(), 0)).await {
        Ok(addresses) => addresses.map(|address| address.ip()).all(|address| !address.is_loopback()),
        Err(_) => false,
    };
    if is_reachable { name } else { local.to_string() }
}

/// Returns the source address of packets to the master.
// Connecting a datagram socket selects the source address and sends nothing.
async fn address_towards(master: &RpcUri) -> std::io::Result<IpAddr> {
    let mut last_error = std::io::ErrorKind::NotFound.into();
    let mut addresses: Vec<SocketAddr> = lookup_host((master.host(), master.port())).await?.collect();
    // Most programs of ROS 1 only support IPv4, and `localhost` has addresses of both kinds.
    addresses.sort_by_key(SocketAddr::is_ipv6);
    for address in addresses {
        let unspecified: SocketAddr =
            if address.is_ipv4() { (Ipv4Addr::UNSPECIFIED, 0).into() } else { ([0_u16; 8], 0).into() };
        let socket = UdpSocket::bind(unspecified).await?;
        match socket.connect(address).await {
            Ok(()) => return Ok(socket.local_addr()?.ip()),
            Err(error) => last_error = error,
        }
    }
    Err(last_error)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uri_has_ipv6_host_in_brackets() {
        let address = NodeAddress::new("::1".into(), 7, 8);
        assert_eq!((address.uri(), address.host(), address.tcpros_port()), ("http://[::1]:7/", "::1", 8));
        assert_eq!(NodeAddress::new("robot".into(), 7, 8).uri(), "http://robot:7/");
    }

    #[tokio::test]
    async fn host_has_ipv4_address_if_master_is_local() {
        for uri in ["http://localhost:11311", "http://127.0.0.1:11311"] {
            let host = advertised_host(&RpcUri::parse(uri).unwrap()).await;
            let addresses: Vec<SocketAddr> = lookup_host((host.as_str(), 0)).await.unwrap().collect();
            assert!(addresses.iter().any(SocketAddr::is_ipv4), "{host}: {addresses:?}");
            tokio::net::TcpListener::bind((host.as_str(), 0)).await.unwrap();
        }
    }

    #[tokio::test]
    async fn host_is_found_if_master_cannot_be_resolved() {
        assert!(!advertised_host(&RpcUri::parse("http://no-such-host.invalid").unwrap()).await.is_empty());
    }
}
