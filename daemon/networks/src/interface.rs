//! Network interfaces of this host.

use std::fs;
use std::io;
use std::net::IpAddr;
use std::path::Path;

use nix::ifaddrs::getifaddrs;
use nix::net::if_::InterfaceFlags;
use peernet_stream::NetworkInterface;

use crate::ConnectionAddresses;

/// Directory in which Linux describes the interfaces.
const SYSFS: &str = "/sys/class/net";

/// Hardware types of Linux (`ARPHRD_*` in `linux/if_arp.h`).
const ETHERNET: u32 = 1;
const LOOPBACK: u32 = 772;
const TUNNELS: [u32; 5] = [
    512,    // PPP
    768,    // IPv4 in IPv4
    769,    // IPv6 in IPv6
    776,    // IPv6 in IPv4
    65_534, // neither hardware nor address: TUN, WireGuard
];

/// Returns the interface over which the packets of a connection leave the host: the interface that has the connection's
/// local address, or the loopback interface if the remote address belongs to this host. `None` if there is no such
/// interface any more.
///
/// # Errors
/// If the system cannot list its interfaces.
pub fn outgoing_interface(addresses: &ConnectionAddresses) -> io::Result<Option<NetworkInterface>> {
    // A socket for IPv4 and IPv6 shows IPv4 addresses as IPv6 addresses (`::ffff:…`). Interfaces have IPv4 addresses.
    let (local, remote) = (addresses.local.ip().to_canonical(), addresses.remote.ip().to_canonical());
    let mut interface_with_local_address = None;
    let mut loopback = None;
    let mut remote_is_this_host = remote.is_loopback();
    for entry in getifaddrs()? {
        if entry.flags.contains(InterfaceFlags::IFF_LOOPBACK) {
            loopback.get_or_insert_with(|| entry.interface_name.clone());
        }
        let Some(address) = entry.address.as_ref().and_then(to_ip) else { continue };
        remote_is_this_host |= address == remote;
        if address == local {
            interface_with_local_address.get_or_insert(entry.interface_name);
        }
    }
    // Linux sends packets to the host's own addresses over the loopback interface, even if another interface has the
    // address.
    let name = if remote_is_this_host { loopback } else { interface_with_local_address };
    Ok(name.map(|name| describe_interface(Path::new(SYSFS), name)))
}

/// Returns whether an interface is wireless. `folder` is its directory in sysfs.
pub fn is_wireless(folder: &Path) -> bool {
    // `wireless` is the entry of the kernel's older wireless extensions. Some drivers still have it instead of
    // `phy80211`.
    ["phy80211", "wireless"].iter().any(|entry| folder.join(entry).exists())
}

fn to_ip(address: &nix::sys::socket::SockaddrStorage) -> Option<IpAddr> {
    let v4 = address.as_sockaddr_in().map(|address| IpAddr::V4(address.ip()));
    v4.or_else(|| address.as_sockaddr_in6().map(|address| IpAddr::V6(address.ip())))
}

fn describe_interface(sysfs: &Path, name: String) -> NetworkInterface {
    let folder = sysfs.join(&name);
    let read_number = |file: &str| fs::read_to_string(folder.join(file)).ok()?.trim().parse::<u32>().ok();
    let is_wireless = is_wireless(&folder);
    let kind = read_number("type").map(|hardware| match hardware {
        _ if is_wireless => "wireless".to_owned(),
        ETHERNET => "ethernet".to_owned(),
        LOOPBACK => "loopback".to_owned(),
        hardware if TUNNELS.contains(&hardware) => "tunnel".to_owned(),
        other => format!("type {other}"),
    });
    NetworkInterface { name, kind, mtu_bytes: read_number("mtu") }
}

#[cfg(test)]
mod tests {
    use std::net::{SocketAddr, UdpSocket};

    use super::*;

    #[test]
    fn connection_to_loopback_address_leaves_by_loopback() {
        let address_from = |text: &str| text.parse::<SocketAddr>().expect("an address");
        for (local, remote) in [
            ("127.0.0.1:40000", "127.0.0.1:5551"),
            ("127.0.0.1:40000", "127.0.0.2:5551"),
            ("[::ffff:127.0.0.1]:40000", "[::ffff:127.0.0.1]:5551"),
        ] {
            let addresses = ConnectionAddresses { local: address_from(local), remote: address_from(remote) };
            let interface = outgoing_interface(&addresses).expect("interfaces are listed").expect(local);
            assert_eq!(
                (interface.name.as_str(), interface.kind.as_deref()),
                ("lo", Some("loopback")),
                "{local}"
            );
            assert!(interface.mtu_bytes.is_some_and(|mtu| mtu >= 1_280), "{interface:?}");
        }
    }

    #[test]
    fn address_without_interface_gives_none() {
        let address_from = |text: &str| text.parse::<SocketAddr>().expect("an address");
        // TEST-NET-1 and TEST-NET-2 (RFC 5737).
        let addresses = ConnectionAddresses {
            local: address_from("192.0.2.1:1"),
            remote: address_from("198.51.100.1:2"),
        };
        assert_eq!(outgoing_interface(&addresses).expect("interfaces are listed"), None);
    }

    #[test]
    fn connection_to_own_address_leaves_by_loopback() {
        // A connected datagram socket knows its local address without sending anything.
        let socket = UdpSocket::bind("0.0.0.0:0").expect("a socket");
        if socket.connect("192.0.2.1:9").is_err() {
            // A host without a route has no address that could be tested.
            return;
        }
        let own_address = socket.local_addr().expect("connected");
        let interface = outgoing_interface(&ConnectionAddresses { local: own_address, remote: own_address });
        let interface = interface.expect("interfaces are listed").expect("the address is of this host");
        assert_eq!(interface.name, "lo");
    }

    #[test]
    fn kind_is_read_from_hardware_type() {
        let sysfs = tempfile::tempdir().expect("a folder");
        for (name, hardware, wireless_entry, kind) in [
            ("eth0", "1\n", "", "ethernet"),
            ("wlan0", "1\n", "phy80211", "wireless"),
            ("wlp1s0", "1\n", "wireless", "wireless"),
            ("wg0", "65534\n", "", "tunnel"),
            ("can0", "280\n", "", "type 280"),
        ] {
            let folder = sysfs.path().join(name);
            fs::create_dir_all(folder.join(wireless_entry)).expect("a folder");
            fs::write(folder.join("type"), hardware).expect("a file");
            fs::write(folder.join("mtu"), "1280\n").expect("a file");
            let expected =
                NetworkInterface { name: name.into(), kind: Some(kind.into()), mtu_bytes: Some(1_280) };
            assert_eq!(describe_interface(sysfs.path(), name.into()), expected);
        }
        let missing_interface = NetworkInterface { name: "usb0".into(), kind: None, mtu_bytes: None };
        assert_eq!(describe_interface(sysfs.path(), "usb0".into()), missing_interface);
    }
}
