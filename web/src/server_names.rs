//! The host names of this server, and the syntax of a host name.

use std::net::IpAddr;

/// Returns a description of the problem of a configured name; `None` for a valid name.
pub(crate) fn name_problem(name: &str) -> Option<String> {
    (!has_host_name_syntax(name))
        .then(|| format!("{name:?} is not a host name: write it like robot.example.org, without a port"))
}

/// Returns whether a text has the syntax of a host name or an IPv4 address.
pub(crate) fn has_host_name_syntax(text: &str) -> bool {
    let is_name_byte = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'-' | b'_');
    !text.is_empty() && text.bytes().all(is_name_byte)
}

/// The host names that a request may address, in addition to IP addresses and `localhost`. All other names are rejected.
///
/// The rejection prevents DNS rebinding: a page of another site whose name resolves to this machine could otherwise read and change all data
/// through the browser of a user who opens it. IP addresses are safe, because a browser resolves no name for them.
#[derive(Clone, Debug)]
pub(crate) struct ServerNames(Vec<String>);

impl ServerNames {
    /// Collects the configured names, and the machine's host name with and without `.local` (multicast DNS).
    pub(crate) fn new(configured: &[String]) -> Self {
        let machine = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
        let machine = machine.trim();
        let machine_names =
            [machine.to_owned(), format!("{machine}.local")].into_iter().filter(|_| !machine.is_empty());
        Self(configured.iter().cloned().chain(machine_names).collect())
    }

    /// Returns whether requests that address `host` are answered.
    pub(crate) fn contains(&self, host: &str) -> bool {
        // A dot at the end marks a complete name; the name means the same host without the dot.
        let name = host.strip_suffix('.').unwrap_or(host).to_ascii_lowercase();
        let address = name.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(&name);
        address.parse::<IpAddr>().is_ok()
            || name == "localhost"
            // Such names mean this machine (RFC 6761, section 6.3).
            || name.ends_with(".localhost")
            || self.0.iter().any(|own_name| own_name.eq_ignore_ascii_case(&name))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_ip_addresses_and_own_names_are_accepted() {
        let names = ServerNames::new(&["Dash.example.org".to_owned()]);
        for host in [
            "127.0.0.1",
            "192.0.2.7",
            "[2001:db8::1]",
            "localhost",
            "LOCALHOST.",
            "demo.localhost",
            "dash.example.org",
        ] {
            assert!(names.contains(host), "{host}");
        }
        for host in
            ["evil.example", "localhost.evil.example", "example.org", "127.0.0.1.evil.example", "[x]", ""]
        {
            assert!(!names.contains(host), "{host}");
        }
    }
}
