//! Settings of a ROS 2 node.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::Ros2Error;
use super::names::check_node;

/// Settings of a ROS 2 node. The environment variables of ROS 2 provide defaults.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ros2Settings {
    /// DDS domain, from 0 to 232. The default is `ROS_DOMAIN_ID`, or else 0.
    pub domain_id: Option<u16>,
    /// Names (`eth0`) or IPv4 addresses of the network interfaces to use. If empty, all interfaces are used, or only
    /// the loopback interface if `ROS_LOCALHOST_ONLY` is 1 or `ROS_AUTOMATIC_DISCOVERY_RANGE` is `LOCALHOST`.
    pub interfaces: Vec<String>,
    /// Name of the node in the node list of ROS 2.
    pub node_name: String,
    /// Namespace of the node, which is the prefix of relative topic names.
    pub namespace: String,
    /// Requested size of the kernel's receive and send buffers, bytes.
    pub socket_buffer_bytes: usize,
    /// Distribution of ROS 2 that the peers use, such as `humble`. The default is `ROS_DISTRO`. Only the node list
    /// depends on the distribution, because the form of its identifiers changed with Iron.
    pub distribution: Option<String>,
}

impl Default for Ros2Settings {
    fn default() -> Self {
        Self {
            domain_id: None,
            interfaces: Vec::new(),
            node_name: "peernet".to_owned(),
            namespace: "/".to_owned(),
            socket_buffer_bytes: 8 << 20,
            distribution: None,
        }
    }
}

impl Ros2Settings {
    /// Highest domain. The UDP ports of higher domains would exceed 65,535.
    pub const MAX_DOMAIN_ID: u16 = 232;

    /// Distributions before Iron, whose identifiers in the node list have 24 bytes instead of 16.
    #[cfg(any(feature = "ros2", test))]
    const LONG_IDENTIFIER_DISTRIBUTIONS: [&str; 3] = ["foxy", "galactic", "humble"];

    /// Checks the settings and completes them from environment variables.
    ///
    /// # Errors
    ///
    /// If a name or domain is not allowed, or a variable has an unsupported value.
    pub fn with_environment(mut self, variable: impl Fn(&str) -> Option<String>) -> Result<Self, Ros2Error> {
        let read_variable = |name: &str| variable(name).filter(|value| !value.is_empty());
        check_node(&self.namespace, &self.node_name)?;
        if self.domain_id.is_none() {
            self.domain_id = match read_variable("ROS_DOMAIN_ID") {
                None => Some(0),
                Some(value) => Some(value.trim().parse().map_err(|_| Ros2Error::InvalidVariable {
                    name: "ROS_DOMAIN_ID",
                    value,
                    expected: "a number from 0 to 232",
                })?),
            };
        }
        if let Some(domain_id) = self.domain_id.filter(|id| *id > Self::MAX_DOMAIN_ID) {
            return Err(Ros2Error::InvalidDomain { domain_id });
        }
        if self.interfaces.is_empty() && is_localhost_only(&read_variable)? {
            self.interfaces.push("127.0.0.1".to_owned());
        }
        if self.distribution.is_none() {
            self.distribution = read_variable("ROS_DISTRO");
        }
        Ok(self)
    }

    /// Returns the length of an identifier in the node list, bytes.
    #[cfg(any(feature = "ros2", test))]
    pub(super) fn identifier_length(&self) -> usize {
        match self.distribution.as_deref() {
            Some(distribution) if Self::LONG_IDENTIFIER_DISTRIBUTIONS.contains(&distribution) => 24,
            _ => 16,
        }
    }
}

fn is_localhost_only(read_variable: &impl Fn(&str) -> Option<String>) -> Result<bool, Ros2Error> {
    // As in ROS 2, the older variable takes precedence.
    if read_variable("ROS_LOCALHOST_ONLY").is_some_and(|value| value == "1") {
        return Ok(true);
    }
    match read_variable("ROS_AUTOMATIC_DISCOVERY_RANGE").as_deref() {
        None | Some("SUBNET" | "SYSTEM_DEFAULT") => Ok(false),
        Some("LOCALHOST") => Ok(true),
        // With OFF only static peers are found, which rustdds does not support.
        Some(value) => Err(Ros2Error::InvalidVariable {
            name: "ROS_AUTOMATIC_DISCOVERY_RANGE",
            value: value.to_owned(),
            expected: "SUBNET, LOCALHOST or SYSTEM_DEFAULT",
        }),
    }
}

/// A limit of the kernel that is below the requested size of socket buffers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SocketBufferWarning {
    /// Setting of the kernel that limits the size.
    pub sysctl: &'static str,
    /// Granted size, bytes.
    pub granted: usize,
    /// Requested size, bytes.
    pub requested: usize,
}

impl SocketBufferWarning {
    /// Returns whether the receive buffer is limited.
    #[cfg(feature = "ros2")]
    pub(super) fn limits_receive_buffer(&self) -> bool {
        self.sysctl == Self::RECEIVE_SYSCTL
    }

    /// Setting of the kernel for receive buffers.
    #[cfg(feature = "ros2")]
    pub(super) const RECEIVE_SYSCTL: &'static str = "net.core.rmem_max";
}

impl fmt::Display for SocketBufferWarning {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { sysctl, granted, requested } = self;
        write!(
            formatter,
            "the kernel limits socket buffers to {granted} bytes instead of the requested {requested} ({sysctl}); ROS 2 \
             messages of more than about {granted} bytes are lost or late; run `sysctl -w {sysctl}={requested}`"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolve(settings: Ros2Settings, variables: &[(&str, &str)]) -> Result<Ros2Settings, Ros2Error> {
        settings.with_environment(|name| {
            variables.iter().find(|(variable, _)| *variable == name).map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn environment_supplies_missing_settings() {
        let settings = resolve(Ros2Settings::default(), &[]).expect("valid");
        assert_eq!((settings.domain_id, settings.interfaces.len()), (Some(0), 0));
        let all = [("ROS_DOMAIN_ID", "7"), ("ROS_LOCALHOST_ONLY", "1"), ("ROS_DISTRO", "humble")];
        let settings = resolve(Ros2Settings::default(), &all).expect("valid");
        assert_eq!((settings.domain_id, settings.identifier_length()), (Some(7), 24));
        assert_eq!(settings.interfaces, ["127.0.0.1"]);
        let configured =
            Ros2Settings { domain_id: Some(3), interfaces: vec!["eth0".into()], ..Ros2Settings::default() };
        let settings = resolve(configured, &all).expect("valid");
        assert_eq!((settings.domain_id, settings.interfaces), (Some(3), vec!["eth0".to_owned()]));
    }

    #[test]
    fn unsupported_value_is_an_error() {
        for variable in
            [("ROS_DOMAIN_ID", "x"), ("ROS_DOMAIN_ID", "233"), ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")]
        {
            assert!(resolve(Ros2Settings::default(), &[variable]).is_err(), "{variable:?}");
        }
        let range = [("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")];
        let settings = resolve(Ros2Settings::default(), &range).expect("valid");
        assert_eq!(settings.interfaces, ["127.0.0.1"]);
    }
}
