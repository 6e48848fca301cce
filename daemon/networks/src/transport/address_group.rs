//! Groups of addresses for limits per address.

use std::net::{IpAddr, Ipv6Addr, SocketAddr};

/// Addresses that limits treat as one: an IPv4 address, or the /64 network of an IPv6 address. One machine can use all
/// addresses of such a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct AddressGroup(IpAddr);

impl AddressGroup {
    /// Returns the group of a peer's address.
    pub fn from_address(address: SocketAddr) -> Self {
        // An IPv4 peer of an IPv6 socket has a mapped IPv6 address (RFC 4291, section 2.5.5.2).
        match address.ip().to_canonical() {
            // The loopback address stays whole, so that `is_loopback` recognises it.
            IpAddr::V6(ip) if !ip.is_loopback() => {
                Self(IpAddr::V6(Ipv6Addr::from_bits(ip.to_bits() & !u128::from(u64::MAX))))
            }
            ip => Self(ip),
        }
    }

    /// Returns whether the group is this machine's loopback address. Limits make an exception for this address, because
    /// a local process can do worse things than open connections.
    pub fn is_loopback(self) -> bool {
        self.0.is_loopback()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ipv6_network_counts_as_one_address() {
        let group = |text: &str| AddressGroup::from_address(text.parse().expect("an address"));
        assert_eq!(group("[2001:db8::1]:1"), group("[2001:db8::ffff:1]:2"));
        assert_ne!(group("[2001:db8:0:1::1]:1"), group("[2001:db8::1]:1"));
        assert_eq!(group("[::ffff:192.0.2.7]:1"), group("192.0.2.7:2"));
        assert_ne!(group("192.0.2.7:1"), group("192.0.2.8:1"));
        assert!(group("[::1]:1").is_loopback() && group("127.0.0.1:1").is_loopback());
    }
}
