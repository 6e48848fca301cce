//! Network interfaces that a node uses, and the buffers of its sockets.

use std::io;
use std::net::{IpAddr, Ipv4Addr};

use nix::ifaddrs::{InterfaceAddress, getifaddrs};
use socket2::{Domain, Socket, Type};

use crate::ros2::interfaces::{UnknownInterface, find_interfaces, format_interfaces, ipv4_interfaces};
use crate::ros2::{Ros2Error, SocketBufferWarning};

/// IPv4 addresses of chosen network interfaces.
#[derive(Clone, Debug)]
pub(super) struct Interfaces {
    /// The addresses; empty for all interfaces.
    pub(super) addresses: Vec<IpAddr>,
    /// Description of the choice, such as `lo (127.0.0.1)`.
    pub(super) description: String,
}

impl Interfaces {
    /// Looks up interfaces by names or addresses.
    ///
    /// # Errors
    ///
    /// [`Ros2Error::UnknownInterface`] if an interface does not exist, [`Ros2Error::Interfaces`] if the kernel does not
    /// list the interfaces.
    pub(super) fn find(names: &[String]) -> Result<Self, Ros2Error> {
        Ok(Self::find_among(names, &ipv4_interfaces().map_err(Ros2Error::Interfaces)?)?)
    }

    fn find_among(names: &[String], existing: &[(String, Ipv4Addr)]) -> Result<Self, UnknownInterface> {
        if names.is_empty() {
            return Ok(Self { addresses: Vec::new(), description: "all interfaces".to_owned() });
        }
        let chosen = find_interfaces(names, existing)?;
        let addresses = chosen.iter().map(|(_, address)| IpAddr::V4(*address)).collect();
        Ok(Self { addresses, description: format_interfaces(&chosen) })
    }

    /// Returns whether participants of the same host are found over the loopback interface.
    pub(super) fn include_loopback(&self) -> bool {
        self.addresses.is_empty() || self.addresses.iter().any(IpAddr::is_loopback)
    }
}

/// Returns the addresses of all network interfaces of this host.
///
/// # Errors
///
/// If the kernel does not list the interfaces.
pub(super) fn own_addresses() -> io::Result<Vec<IpAddr>> {
    let address = |interface: InterfaceAddress| {
        let address = interface.address?;
        let v4 = address.as_sockaddr_in().map(|address| IpAddr::V4(address.ip()));
        v4.or_else(|| address.as_sockaddr_in6().map(|address| IpAddr::V6(address.ip())))
    };
    Ok(getifaddrs()?.filter_map(address).collect())
}

/// Returns a warning for each kind of socket buffer for which the kernel grants less than the requested size.
///
/// The sizes are read from a socket and not from `/proc/sys/net/core`, which network namespaces of older kernels do not
/// show.
///
/// # Errors
///
/// If no UDP socket can be created.
pub(super) fn check_socket_buffers(requested: usize) -> io::Result<Vec<SocketBufferWarning>> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, None)?;
    socket.set_recv_buffer_size(requested)?;
    socket.set_send_buffer_size(requested)?;
    // Linux reports twice the granted size, because it counts its own overhead.
    let granted = [
        (SocketBufferWarning::RECEIVE_SYSCTL, socket.recv_buffer_size()? / 2),
        ("net.core.wmem_max", socket.send_buffer_size()? / 2),
    ];
    let warning_if_too_small = |(sysctl, granted): (&'static str, usize)| {
        (granted < requested).then_some(SocketBufferWarning { sysctl, granted, requested })
    };
    Ok(granted.into_iter().filter_map(warning_if_too_small).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loopback_is_included_if_interfaces_include_it() {
        let existing =
            [("lo".to_owned(), Ipv4Addr::LOCALHOST), ("eth0".to_owned(), Ipv4Addr::new(10, 0, 0, 1))];
        let find = |name: &str| Interfaces::find_among(&[name.to_owned()], &existing);
        let by_name = find("eth0").expect("exists");
        assert_eq!((by_name.addresses.len(), by_name.description.as_str()), (1, "eth0 (10.0.0.1)"));
        assert!(!by_name.include_loopback());
        assert!(find("127.0.0.1").expect("exists").include_loopback());
        assert!(Interfaces::find_among(&[], &existing).expect("all").include_loopback());
    }

    #[test]
    fn too_small_buffers_are_reported_with_advice() {
        assert_eq!(check_socket_buffers(16 << 10).expect("a socket"), []);
        let warnings = check_socket_buffers(1 << 30).expect("a socket");
        let text = warnings[0].to_string();
        assert!(text.contains("sysctl -w net.core.rmem_max=1073741824"), "{text}");
    }
}
