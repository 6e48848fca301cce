//! Addresses of peers, as people write them.

use std::net::{IpAddr, Ipv6Addr};

use peernet_networks::{Address, InvalidAddress, NetworkKind};

/// Port on which agents listen unless another is given.
pub(crate) const DEFAULT_PORT: u16 = 5551;

/// Reason why a text is not the address of a peer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum AddressError {
    /// The address is valid on one network interface only.
    #[error("a zone such as %eth0 is not supported; use an address that is not link-local, or a host name")]
    Zone,
    /// The text is no address. The caller's message contains the text, so this message has only the problem.
    #[error("{}", .0.problem)]
    Invalid(InvalidAddress),
}

/// Reads an address, or a host with or without a port. A text without a scheme gets the scheme of `network`, and a text
/// without a port gets `port`.
///
/// # Errors
/// When the text is neither an address nor a host.
pub(crate) fn address(text: &str, port: u16, network: NetworkKind) -> Result<Address, AddressError> {
    let (scheme, rest) = text.split_once("://").unwrap_or((network.schemes()[0], text));
    let has_named_listener =
        |kind: &NetworkKind| kind.schemes().contains(&scheme) && kind.has_named_listeners();
    if NetworkKind::ALL.iter().any(has_named_listener) {
        // Such an address names a listener. Another program, such as a ROS master, knows where the listener is. A port
        // in the address is the port of that program and has another default, so `port` is not added.
        return format!("{scheme}://{rest}").parse().map_err(AddressError::Invalid);
    }
    let has_zone =
        rest.split_once('%').is_some_and(|(ip, _)| ip.trim_start_matches('[').parse::<Ipv6Addr>().is_ok());
    if has_zone {
        return Err(AddressError::Zone);
    }
    let rest = match rest.parse() {
        Ok(IpAddr::V6(ip)) => format!("[{ip}]"),
        _ => rest.to_owned(),
    };
    // A last colon inside the brackets of an IPv6 address does not precede a port.
    let has_port = rest.rsplit_once(':').is_some_and(|(_, port)| !port.contains(']'));
    let port = if has_port { String::new() } else { format!(":{port}") };
    format!("{scheme}://{rest}{port}").parse().map_err(AddressError::Invalid)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peer_is_address_or_host() {
        let read = |text| address(text, DEFAULT_PORT, NetworkKind::default());
        for (text, address) in [
            ("cloud", "tcp://cloud:5551"),
            ("cloud:6000", "tcp://cloud:6000"),
            ("10.0.0.2", "tcp://10.0.0.2:5551"),
            ("tcp://cloud", "tcp://cloud:5551"),
            ("tcp://cloud:7", "tcp://cloud:7"),
            ("::1", "tcp://[::1]:5551"),
            ("[fe80::1]:8", "tcp://[fe80::1]:8"),
            ("ros1://robot/gpu", "ros1://robot:11311/gpu"),
        ] {
            assert_eq!(read(text).map(|peer| peer.to_string()).as_deref(), Ok(address));
        }
        for zoned in ["fe80::1%lo", "[fe80::1%lo]:8", "tcp://fe80::1%eth0"] {
            assert_eq!(read(zoned), Err(AddressError::Zone), "{zoned}");
        }
        assert!(read("pgm://cloud").is_err() && read("a b").is_err() && read("").is_err());
    }
}
