//! Names of kinds of networks.

use std::fmt;
use std::str::FromStr;

use peernet_logger::{InvalidName, Slug};
use serde::{Deserialize, Serialize};

/// Name of a kind of network, such as `zmq-tcp`.
///
/// The default is `zmq-tcp`, the only network up to PEERNet 0.2.0, whose agents send no name. Messages omit the
/// default, so that messages about `zmq-tcp` have the form of these releases.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct NetworkName(Slug);

impl NetworkName {
    /// Network of agents that send no name.
    const UNNAMED: &'static str = "zmq-tcp";

    /// Returns the name as text.
    pub fn as_str(&self) -> &str {
        self.0.as_str()
    }

    /// Returns whether this is the network of agents that send no name.
    pub fn is_default(&self) -> bool {
        self.as_str() == Self::UNNAMED
    }
}

impl Default for NetworkName {
    fn default() -> Self {
        Self(Self::UNNAMED.parse().expect("a valid name"))
    }
}

impl FromStr for NetworkName {
    type Err = InvalidName;
    fn from_str(name: &str) -> Result<Self, InvalidName> {
        name.parse().map(Self)
    }
}

impl fmt::Display for NetworkName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unnamed_network_is_zmq_tcp() {
        assert_eq!(NetworkName::default().to_string(), "zmq-tcp");
        let zmq_udp: NetworkName = "zmq-udp".parse().expect("a name");
        assert!(NetworkName::default().is_default() && !zmq_udp.is_default());
        assert!("zmq udp".parse::<NetworkName>().is_err());
    }
}
