//! The names of this server, and the form of a name.

use std::net::IpAddr;

/// Returns the problem of a configured name, if there is one.
pub(crate) fn wrong_name(name: &str) -> Option<String> {
    (!is_name(name))
        .then(|| format!("{name:?} is not a host name: write it like robot.example.org, without a port"))
}

/// Returns whether a text has the form of a host name or an IPv4 address.
pub(crate) fn is_name(text: &str) -> bool {
    let letter = |letter: u8| letter.is_ascii_alphanumeric() || matches!(letter, b'.' | b'-' | b'_');
    !text.is_empty() && text.bytes().all(letter)
}

/// The names under which requests are answered, in addition to IP addresses and `localhost`.
///
/// A page of another site whose name resolves to this machine (DNS rebinding) could otherwise read and change everything through the
/// browser of a user who opens it. It cannot do so under an IP address, because the browser then needs no name server.
#[derive(Clone, Debug)]
pub(crate) struct ServerNames(Vec<String>);

impl ServerNames {
    /// Returns the configured names, and the machine's own with and without `.local` (multicast DNS).
    pub(crate) fn new(configured: &[String]) -> Self {
        let machine = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
        let machine = machine.trim();
        let own =
            [machine.to_owned(), format!("{machine}.local")].into_iter().filter(|_| !machine.is_empty());
        Self(configured.iter().cloned().chain(own).collect())
    }

    /// Returns whether requests to a host are answered.
    pub(crate) fn contains(&self, host: &str) -> bool {
        let name = host.strip_suffix('.').unwrap_or(host).to_ascii_lowercase();
        let address = name.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(&name);
        address.parse::<IpAddr>().is_ok()
            || name == "localhost"
            || name.ends_with(".localhost")
            || self.0.iter().any(|known| known.eq_ignore_ascii_case(&name))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_and_known_names_pass_others_do_not() {
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
