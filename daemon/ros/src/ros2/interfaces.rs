//! The network interfaces of this host, by name or IPv4 address.

use std::io;
use std::net::Ipv4Addr;

use nix::ifaddrs::{InterfaceAddress, getifaddrs};

/// Error: this host has no network interface with a requested name or address.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("this host has no network interface {name:?} with an IPv4 address; existing interfaces: {}", format_interfaces(.known))]
pub struct UnknownInterface {
    /// Name or address of the interface.
    pub name: String,
    /// Existing interfaces with their addresses.
    pub known: Vec<(String, Ipv4Addr)>,
}

/// Checks that this host has network interfaces with these names or IPv4 addresses.
///
/// # Errors
/// The first interface that does not exist.
pub fn check_interfaces(names: &[String]) -> Result<(), UnknownInterface> {
    // If the system does not list its interfaces, joining a domain will report it.
    ipv4_interfaces().map_or(Ok(()), |existing| find_interfaces(names, &existing).map(drop))
}

/// Returns the existing interfaces with one of the names or addresses, in the order of `names`.
pub(super) fn find_interfaces(
    names: &[String],
    existing: &[(String, Ipv4Addr)],
) -> Result<Vec<(String, Ipv4Addr)>, UnknownInterface> {
    let mut chosen: Vec<(String, Ipv4Addr)> = Vec::new();
    for requested_name in names {
        let is_requested = |(name, address): &&(String, Ipv4Addr)| {
            name == requested_name || address.to_string() == *requested_name
        };
        let count_before = chosen.len();
        chosen.extend(existing.iter().filter(is_requested).cloned());
        if chosen.len() == count_before {
            return Err(UnknownInterface { name: requested_name.clone(), known: existing.to_vec() });
        }
    }
    Ok(chosen)
}

/// Returns the interfaces with an IPv4 address.
pub(super) fn ipv4_interfaces() -> io::Result<Vec<(String, Ipv4Addr)>> {
    let with_address = |interface: InterfaceAddress| {
        let address = interface.address.as_ref()?.as_sockaddr_in()?.ip();
        Some((interface.interface_name, address))
    };
    Ok(getifaddrs()?.filter_map(with_address).collect())
}

/// Returns a text such as `lo (127.0.0.1), eth0 (10.0.0.1)`.
pub(super) fn format_interfaces(interfaces: &[(String, Ipv4Addr)]) -> String {
    let descriptions: Vec<String> =
        interfaces.iter().map(|(name, address)| format!("{name} ({address})")).collect();
    if descriptions.is_empty() { "none".to_owned() } else { descriptions.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interface_is_found_by_name_and_by_address() {
        let existing =
            [("lo".to_owned(), Ipv4Addr::LOCALHOST), ("eth0".to_owned(), Ipv4Addr::new(10, 0, 0, 1))];
        let find = |names: &[&str]| {
            find_interfaces(&names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>(), &existing)
        };
        assert_eq!(find(&["eth0", "127.0.0.1"]), Ok(vec![existing[1].clone(), existing[0].clone()]));
        assert_eq!(find(&[]), Ok(Vec::new()));
        let error = find(&["lo", "eth1"]).expect_err("does not exist").to_string();
        assert!(error.contains("\"eth1\"") && error.contains("eth0 (10.0.0.1)"), "{error}");
    }

    #[test]
    fn loopback_is_found_and_unknown_interface_is_not() {
        assert_eq!(check_interfaces(&["lo".into(), "127.0.0.1".into()]), Ok(()));
        let error = check_interfaces(&["eth99".into()]).expect_err("no such interface").to_string();
        assert!(error.contains("\"eth99\"") && error.contains("lo (127.0.0.1)"), "{error}");
    }
}
