//! Environment variables of ROS 1.

use std::ffi::OsString;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

use hyper::Uri;
use thiserror::Error;

/// Default port of the master.
const MASTER_PORT: u16 = 11311;

/// Error: an environment variable has a value that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum EnvironmentError {
    /// The value is not UTF-8.
    #[error("the environment variable {variable} is not UTF-8; set it again")]
    NotUtf8 {
        /// Name of the variable.
        variable: &'static str,
    },
    /// The URI of the master is invalid.
    #[error("{uri:?} is not the URI of a ROS master; write it like http://robot:11311 (ROS_MASTER_URI)")]
    MasterUri {
        /// The text.
        uri: String,
    },
}

/// URI of a master or of a node's XML-RPC server.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct RpcUri {
    text: String,
    host: String,
    port: u16,
    path: String,
}

impl RpcUri {
    /// Parses `http://HOST:PORT/`; the default port is 11311.
    ///
    /// # Errors
    /// If the text is not such a URI.
    pub fn parse(text: &str) -> Result<Self, EnvironmentError> {
        let error = || EnvironmentError::MasterUri { uri: text.to_owned() };
        let uri: Uri = text.trim().parse().map_err(|_| error())?;
        if uri.scheme_str() != Some("http") {
            return Err(error());
        }
        let host = uri.host().filter(|host| !host.is_empty()).ok_or_else(error)?;
        let host = host.trim_start_matches('[').trim_end_matches(']').to_owned();
        let path = if uri.path().is_empty() { "/" } else { uri.path() }.to_owned();
        let port = uri.port_u16().unwrap_or(MASTER_PORT);
        Ok(Self { text: text.trim().to_owned(), host, port, path })
    }

    /// Returns the URI as it was written.
    pub fn as_str(&self) -> &str {
        &self.text
    }

    /// Returns the host name or address, without brackets.
    pub fn host(&self) -> &str {
        &self.host
    }

    /// Returns the port.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Returns the path.
    pub fn path(&self) -> &str {
        &self.path
    }
}

impl std::fmt::Display for RpcUri {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(&self.text)
    }
}

/// Settings that ROS 1 programs take from environment variables.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Environment {
    /// `ROS_MASTER_URI`; by default `http://localhost:11311`.
    pub master: RpcUri,
    /// `ROS_HOSTNAME`, or else `ROS_IP`: the host that other nodes connect to. Empty values count as unset.
    pub advertised_host: Option<String>,
    /// `ROS_NAMESPACE`; by default `/`.
    pub namespace: String,
}

impl Environment {
    /// Reads the environment variables of this process.
    ///
    /// # Errors
    /// If a variable has a value that cannot be used.
    pub fn from_process() -> Result<Self, EnvironmentError> {
        Self::from_variables(|name| std::env::var_os(name))
    }

    /// Reads the environment variables that `look_up` returns.
    ///
    /// # Errors
    /// If a variable has a value that cannot be used.
    pub fn from_variables(look_up: impl Fn(&str) -> Option<OsString>) -> Result<Self, EnvironmentError> {
        let read_variable = |variable: &'static str| match look_up(variable).map(OsString::into_string) {
            Some(Ok(value)) => Ok(Some(value.trim().to_owned()).filter(|value| !value.is_empty())),
            Some(Err(_)) => Err(EnvironmentError::NotUtf8 { variable }),
            None => Ok(None),
        };
        let master = read_variable("ROS_MASTER_URI")?;
        let (hostname, address) = (read_variable("ROS_HOSTNAME")?, read_variable("ROS_IP")?);
        Ok(Self {
            master: RpcUri::parse(master.as_deref().unwrap_or("http://localhost:11311"))?,
            advertised_host: hostname.or(address),
            namespace: read_variable("ROS_NAMESPACE")?.unwrap_or_else(|| "/".to_owned()),
        })
    }
}

/// Returns the address to listen on for peers that connect to `advertised`: the loopback address if `advertised` is a
/// loopback address or `localhost`, as in the clients of ROS, else the unspecified address.
pub(super) fn listen_address(advertised: &str) -> IpAddr {
    match advertised.parse::<IpAddr>() {
        Ok(address) if address.is_loopback() => address,
        Ok(IpAddr::V6(_)) => Ipv6Addr::UNSPECIFIED.into(),
        Ok(IpAddr::V4(_)) => Ipv4Addr::UNSPECIFIED.into(),
        Err(_) if advertised == "localhost" => Ipv4Addr::LOCALHOST.into(),
        Err(_) => Ipv4Addr::UNSPECIFIED.into(),
    }
}

/// Returns a host in the form that a URI needs: an IPv6 address in brackets.
pub(super) fn uri_host(host: &str) -> String {
    if host.contains(':') { format!("[{host}]") } else { host.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn environment(variables: &[(&str, &str)]) -> Result<Environment, EnvironmentError> {
        Environment::from_variables(|name| {
            variables.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).into())
        })
    }

    #[test]
    fn missing_variables_get_defaults() {
        for variables in [&[][..], &[("ROS_MASTER_URI", ""), ("ROS_IP", " "), ("ROS_NAMESPACE", "")]] {
            let environment = environment(variables).unwrap();
            assert_eq!(environment.master.as_str(), "http://localhost:11311");
            assert_eq!(environment.advertised_host, None);
            assert_eq!(environment.namespace, "/");
        }
    }

    #[test]
    fn hostname_precedes_address() {
        let variables = [("ROS_IP", "10.0.0.1"), ("ROS_HOSTNAME", "robot")];
        assert_eq!(environment(&variables).unwrap().advertised_host.as_deref(), Some("robot"));
        assert_eq!(environment(&variables[..1]).unwrap().advertised_host.as_deref(), Some("10.0.0.1"));
    }

    #[test]
    fn uri_is_split_into_host_port_and_path() {
        let uri = RpcUri::parse("http://robot:1234/RPC2").unwrap();
        assert_eq!((uri.host(), uri.port(), uri.path()), ("robot", 1234, "/RPC2"));
        let uri = RpcUri::parse("http://[::1]").unwrap();
        assert_eq!((uri.host(), uri.port(), uri.path()), ("::1", 11311, "/"));
        for wrong in ["", "robot:11311", "https://robot", "http://", "http://:1"] {
            assert!(RpcUri::parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn loopback_host_listens_on_loopback_only() {
        assert_eq!(listen_address("localhost").to_string(), "127.0.0.1");
        assert_eq!(listen_address("127.0.0.1").to_string(), "127.0.0.1");
        assert_eq!(listen_address("robot").to_string(), "0.0.0.0");
        assert_eq!(listen_address("::1").to_string(), "::1");
        assert_eq!(uri_host("fe80::1"), "[fe80::1]");
    }
}
