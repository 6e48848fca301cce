//! Address of a controller.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Address of a controller: `udp://host:port` or `tcp://host:port`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct SocketAddress {
    pub(super) protocol: Protocol,
    /// Host and port; an IPv6 address is in brackets.
    pub(super) host_and_port: String,
}

/// Transport protocol of the lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Protocol {
    Udp,
    Tcp,
}

impl Protocol {
    const fn scheme(self) -> &'static str {
        match self {
            Self::Udp => "udp",
            Self::Tcp => "tcp",
        }
    }
}

impl fmt::Display for SocketAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}://{}", self.protocol.scheme(), self.host_and_port)
    }
}

/// Text that is not an address of a controller.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not the address of a controller; write udp://host:port or tcp://host:port")]
pub struct InvalidSocketAddress(String);

impl TryFrom<String> for SocketAddress {
    type Error = InvalidSocketAddress;

    fn try_from(text: String) -> Result<Self, InvalidSocketAddress> {
        let parse = || {
            let (scheme, host_and_port) = text.split_once("://")?;
            let protocol =
                [Protocol::Udp, Protocol::Tcp].into_iter().find(|protocol| protocol.scheme() == scheme)?;
            let (host, port) = host_and_port.rsplit_once(':')?;
            let is_port = port.parse::<u16>().is_ok_and(|port| port > 0);
            let is_bracketed = host.starts_with('[') && host.ends_with(']');
            let is_host = !host.is_empty() && (is_bracketed || !host.contains(':'));
            // A path, a query or a user name would have no effect.
            let is_plain = !host.chars().any(|c| c.is_whitespace() || c.is_control() || "/?#@".contains(c));
            (is_port && is_host && is_plain)
                .then(|| Self { protocol, host_and_port: host_and_port.to_owned() })
        };
        let parsed = parse();
        parsed.ok_or(InvalidSocketAddress(text))
    }
}

impl From<SocketAddress> for String {
    fn from(address: SocketAddress) -> Self {
        address.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_have_scheme_host_and_port() {
        for right in ["udp://10.0.0.5:9000", "tcp://arm:1", "tcp://[fe80::1]:65535"] {
            let address = SocketAddress::try_from(right.to_owned()).expect(right);
            assert_eq!(address.to_string(), right);
        }
        for wrong in [
            "",
            "10.0.0.5:9000",
            "udp://arm",
            "udp://arm:0",
            "udp://arm:65536",
            "udp://:9000",
            "quic://arm:9000",
            "tcp://::1:9000",
            "tcp://a b:1",
            "tcp://arm:9000/x",
        ] {
            let error = SocketAddress::try_from(wrong.to_owned()).expect_err(wrong).to_string();
            assert!(error.contains("udp://host:port"), "{error}");
        }
    }
}
