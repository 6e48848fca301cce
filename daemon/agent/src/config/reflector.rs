//! The address of a STAMP reflector in `[probes] reflectors`.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Address of a STAMP reflector: `udp://HOST` or `udp://HOST:PORT`. The default port is 862 (RFC 8762, section 4.1).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct ReflectorAddress {
    /// Host name or IP address; IPv6 without brackets.
    pub host: String,
    /// UDP port, not 0.
    pub port: u16,
}

/// Error for a text that is not the address of a reflector.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is not the address of a reflector; write udp://HOST or udp://HOST:PORT, with an IPv6 address in brackets and a \
     port from 1 to 65535"
)]
pub struct ReflectorAddressError(String);

impl ReflectorAddress {
    /// The standard port of STAMP (RFC 8762, section 4.1).
    pub const DEFAULT_PORT: u16 = 862;
}

impl FromStr for ReflectorAddress {
    type Err = ReflectorAddressError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        parse(text).ok_or_else(|| ReflectorAddressError(text.to_owned()))
    }
}

fn parse(text: &str) -> Option<ReflectorAddress> {
    let rest = text.strip_prefix("udp://")?;
    let (host, port_suffix) = match rest.strip_prefix('[') {
        Some(bracketed) => {
            let (host, port_suffix) = bracketed.split_once(']')?;
            host.parse::<std::net::Ipv6Addr>().ok()?;
            (host, port_suffix)
        }
        None => rest.split_at(rest.find(':').unwrap_or(rest.len())),
    };
    let is_host_char = |char: char| char.is_ascii_alphanumeric() || matches!(char, '.' | '-' | '_' | ':');
    let port = match port_suffix.strip_prefix(':') {
        Some(port) => port.parse().ok().filter(|port| *port != 0)?,
        None if port_suffix.is_empty() => ReflectorAddress::DEFAULT_PORT,
        None => return None,
    };
    (!host.is_empty() && host.chars().all(is_host_char))
        .then(|| ReflectorAddress { host: host.to_owned(), port })
}

impl fmt::Display for ReflectorAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { host, port } = self;
        if host.contains(':') { write!(f, "udp://[{host}]:{port}") } else { write!(f, "udp://{host}:{port}") }
    }
}

impl TryFrom<String> for ReflectorAddress {
    type Error = ReflectorAddressError;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl From<ReflectorAddress> for String {
    fn from(address: ReflectorAddress) -> Self {
        address.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_read_back_with_their_port() {
        for (written, read) in [
            ("udp://10.0.0.7", "udp://10.0.0.7:862"),
            ("udp://clock-1.local:8620", "udp://clock-1.local:8620"),
            ("udp://[fd00::7]", "udp://[fd00::7]:862"),
            ("udp://[::1]:1", "udp://[::1]:1"),
        ] {
            let address: ReflectorAddress = written.parse().expect(written);
            assert_eq!(address.to_string(), read);
            assert_eq!(read.parse(), Ok(address));
        }
    }

    #[test]
    fn invalid_address_is_refused_with_valid_form() {
        for text in [
            "10.0.0.7:862",
            "tcp://10.0.0.7:862",
            "udp://",
            "udp://:862",
            "udp://host:0",
            "udp://host:65536",
            "udp://host:",
            "udp://fd00::7",
            "udp://[host]:1",
            "udp://[::1",
            "udp://[::1]862",
            "udp://a host",
        ] {
            let error = text.parse::<ReflectorAddress>().expect_err(text).to_string();
            assert!(error.contains("write udp://HOST"), "{error}");
        }
    }
}
