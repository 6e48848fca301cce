//! The `[web]` table of the configuration file, and the checks before the server starts.

mod warn;

use std::net::SocketAddr;

use serde::{Deserialize, Serialize};

pub use self::warn::WarnConfig;

use crate::server_names;
use crate::zone::Zone;

/// Configuration of the dashboard and the REST API.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WebConfig {
    /// Address and port, such as `127.0.0.1:8040` or `[::]:8040`. With port 0, the operating system chooses a
    /// free port.
    pub listen: String,
    /// Permits addresses other than loopback. There is no login, so everyone who reaches the address can see all data.
    pub allow_unauthenticated: bool,
    /// Names under which browsers reach the dashboard, in addition to IP addresses, `localhost` and the machine's own host name.
    pub server_names: Vec<String>,
    /// Zone of the times on the pages: `local`, `utc` or an offset such as `+01:00`. The API always uses UTC.
    pub time_zone: Zone,
    /// Limits beyond which the overview warns.
    pub warn: WarnConfig,
}

/// An invalid value of the configuration.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{key}: {message}")]
pub struct ConfigProblem {
    /// The key within the `[web]` table.
    pub key: &'static str,
    /// Description of the problem, and what to do about it.
    pub message: String,
}

impl Default for WebConfig {
    fn default() -> Self {
        Self {
            listen: "127.0.0.1:8040".to_owned(),
            allow_unauthenticated: false,
            server_names: Vec::new(),
            time_zone: Zone::default(),
            warn: WarnConfig::default(),
        }
    }
}

impl WebConfig {
    /// Returns all problems of the configuration that can be found without starting the server.
    pub fn check(&self) -> Vec<ConfigProblem> {
        let messages = self.server_names.iter().filter_map(|name| server_names::name_problem(name));
        let name_problems = messages.map(|message| ConfigProblem { key: "server_names", message });
        self.listen_address().err().into_iter().chain(name_problems).chain(self.warn.check()).collect()
    }

    /// Returns the address to listen on, if the configuration allows it.
    pub(crate) fn listen_address(&self) -> Result<SocketAddr, ConfigProblem> {
        let new_problem = |message| ConfigProblem { key: "listen", message };
        let address: SocketAddr = self.listen.parse().map_err(|_| {
            new_problem(format!(
                "{:?} is not an address with a port: write it like 127.0.0.1:8040 or [::1]:8040",
                self.listen
            ))
        })?;
        if address.ip().is_loopback() || self.allow_unauthenticated {
            return Ok(address);
        }
        Err(new_problem(format!(
            "{address} can be reached from other machines, and the dashboard has no login: everyone who reaches the \
             address can read all hosts, configurations and measurements; listen on 127.0.0.1, or set \
             allow_unauthenticated = true if that is intended"
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problems_of_address(listen: &str) -> Vec<ConfigProblem> {
        WebConfig { listen: listen.to_owned(), ..WebConfig::default() }.check()
    }

    /// Returns the problems of an address with `allow_unauthenticated = true`.
    fn problems_of_unauthenticated_address(listen: &str) -> Vec<ConfigProblem> {
        WebConfig { listen: listen.to_owned(), allow_unauthenticated: true, ..WebConfig::default() }.check()
    }

    #[test]
    fn default_listens_on_loopback_only() {
        assert_eq!(WebConfig::default().check(), []);
        assert_eq!(problems_of_address("[::1]:0"), []);
    }

    #[test]
    fn non_loopback_address_needs_allow_unauthenticated() {
        for address in ["0.0.0.0:8040", "[::]:8040", "192.0.2.7:8040"] {
            let problems = problems_of_address(address);
            assert_eq!(problems.len(), 1, "{address}");
            assert!(problems[0].message.contains("allow_unauthenticated = true"), "{}", problems[0]);
            assert!(problems[0].message.contains("everyone"), "{}", problems[0]);
            assert_eq!(problems_of_unauthenticated_address(address), []);
        }
    }

    #[test]
    fn address_without_port_is_refused() {
        assert_eq!(problems_of_address("127.0.0.1")[0].key, "listen");
        assert_eq!(problems_of_unauthenticated_address("example")[0].key, "listen");
    }

    #[test]
    fn server_name_with_port_or_scheme_is_refused() {
        let problems_of_name =
            |name: &str| WebConfig { server_names: vec![name.to_owned()], ..WebConfig::default() }.check();
        for name in ["robot", "robot.example.org", "Robot.local"] {
            assert_eq!(problems_of_name(name), [], "{name}");
        }
        for name in ["", "robot:8040", "http://robot", "robot/x", "a b", "*.example.org", "user@robot"] {
            assert_eq!(problems_of_name(name)[0].key, "server_names", "{name}");
        }
    }

    #[test]
    fn unknown_key_is_an_error() {
        let error = serde_json::from_str::<WebConfig>(r#"{"port": 8040}"#).expect_err("there is no such key");
        assert!(error.to_string().contains("port"), "{error}");
    }
}
