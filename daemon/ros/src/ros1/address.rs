//! The own address that other nodes connect to, where no variable names it.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use tokio::net::{UdpSocket, lookup_host};

use super::environment::RpcUri;

/// Returns the address from which the master is reached: whoever reaches the master usually reaches it. With a master on
/// this host it is the host's name, if that leads to an address others can use.
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

/// Returns the source address of packets to the master. Connecting a datagram socket sends nothing.
async fn address_towards(master: &RpcUri) -> std::io::Result<IpAddr> {
    let mut last_error = std::io::ErrorKind::NotFound.into();
    let mut addresses: Vec<SocketAddr> = lookup_host((master.host(), master.port())).await?.collect();
    // Most programs of ROS 1 speak IPv4 only, and `localhost` is both.
    addresses.sort_by_key(SocketAddr::is_ipv6);
    for address in addresses {
        let any: SocketAddr =
            if address.is_ipv4() { (Ipv4Addr::UNSPECIFIED, 0).into() } else { ([0_u16; 8], 0).into() };
        let socket = UdpSocket::bind(any).await?;
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

    #[tokio::test]
    async fn master_on_this_host_gives_an_ipv4_address_of_this_host() {
        for uri in ["http://localhost:11311", "http://127.0.0.1:11311"] {
            let host = advertised_host(&RpcUri::parse(uri).unwrap()).await;
            let addresses: Vec<SocketAddr> = lookup_host((host.as_str(), 0)).await.unwrap().collect();
            assert!(addresses.iter().any(SocketAddr::is_ipv4), "{host}: {addresses:?}");
            tokio::net::TcpListener::bind((host.as_str(), 0)).await.unwrap();
        }
    }

    #[tokio::test]
    async fn unknown_master_gives_a_host() {
        assert!(!advertised_host(&RpcUri::parse("http://no-such-host.invalid").unwrap()).await.is_empty());
    }
}
