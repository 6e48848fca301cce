//! Addresses of peers and listeners.
//!
//! The scheme of an address alone selects the network. A network that a configuration names next to an address selects
//! nothing; it is only checked for agreement with the scheme.

use std::collections::BTreeSet;
use std::fmt;
use std::net::{IpAddr, Ipv6Addr};
use std::str::FromStr;

use peernet_ros::ros2::Ros2Settings;
use serde::{Deserialize, Serialize};

use super::NetworkKind;

/// Address of a peer or of a listener, such as `tcp://host:port`. Its scheme selects the network.
///
/// The host is a name, an IPv4 address, or an IPv6 address in brackets. `0.0.0.0` and `[::]` listen on all interfaces.
/// With port 0 the system chooses a port. In networks where a third program lets peers find each other, as in
/// `ros1://master:11311/name`, host and port belong to that program and the name identifies the listener. In a
/// ROS 2 domain, as in `ros2://7/name`, there is no such program.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Address {
    scheme: Scheme,
    host: Host,
    port: u16,
    /// Name of the listener, if the network's [`AddressForm`] has one.
    name: Option<String>,
}

/// Form of the addresses of a network after `scheme://`.
#[derive(Clone, Copy, Debug)]
pub(crate) enum AddressForm {
    /// `host:port` of the listener.
    HostPort,
    /// `host:port/name`: the program that knows the listener, and the listener's name.
    Named {
        /// Default port.
        port: u16,
        /// Default name.
        name: &'static str,
        /// Scheme of addresses that have a domain in place of host and port.
        domain_scheme: &'static str,
        /// Function that reads the environment variables of this process and returns the address of a listener. Its
        /// arguments are the name of the listener and the configured version of ROS.
        find: fn(&str, Option<u64>) -> Result<String, ListenerLookupError>,
    },
}

/// Error: a listener cannot be looked up by its name, because a setting in the environment is missing or invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ListenerLookupError(pub(crate) String);

impl AddressForm {
    /// Returns the form as it is shown in error texts, such as `host:port`.
    fn placeholder(self, scheme: &str) -> &'static str {
        match self {
            Self::HostPort => "host:port",
            Self::Named { domain_scheme, .. } if domain_scheme == scheme => "domain/name",
            Self::Named { .. } => "host:port/name",
        }
    }
}

/// The scheme of an address (the text before `://`), and the network that it selects.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Scheme {
    network: NetworkKind,
    text: &'static str,
}

impl Scheme {
    /// Returns the first scheme of a network.
    const fn from_network(network: NetworkKind) -> Self {
        Self { network, text: network.schemes()[0] }
    }

    fn find(text: &str) -> Option<Self> {
        NetworkKind::ALL.iter().find_map(|network| {
            let text = network.schemes().iter().copied().find(|scheme| *scheme == text)?;
            Some(Self { network: *network, text })
        })
    }
}

/// Host of an address, or the domain in its place.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Host {
    Ip(IpAddr),
    Name(String),
    /// Number of a ROS 2 domain.
    Domain(u16),
}

/// Error: the text is not an address.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} is not an address: {problem}; write {}", suggested_forms(text, NetworkKind::ALL))]
pub struct InvalidAddress {
    /// The text.
    pub text: String,
    /// The reason.
    pub problem: AddressProblem,
}

/// Error: the text is not an address for the event stream between agents and aggregator.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{:?} is not an address: {}; write {}", .0.text, .0.problem, suggested_forms(&.0.text, &[NetworkKind::default()]))]
pub struct InvalidEventStreamAddress(pub InvalidAddress);

/// Reason why a text is not an address.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AddressProblem {
    /// The text does not begin with a scheme such as `tcp://`.
    #[error("the scheme is missing")]
    NoScheme,
    /// The scheme is unknown.
    #[error("unknown scheme {0:?}")]
    UnknownScheme(String),
    /// An opening bracket is not closed.
    #[error("the closing bracket is missing")]
    NoClosingBracket,
    /// The text in brackets is not an IPv6 address.
    #[error("{0:?} is not an IPv6 address")]
    InvalidIpv6(String),
    /// An IPv6 address is not in brackets.
    #[error("an IPv6 host needs brackets")]
    Ipv6WithoutBrackets,
    /// The host is missing.
    #[error("the host is missing")]
    NoHost,
    /// The host consists of digits and dots and is not an IPv4 address.
    #[error("{0:?} is not an IPv4 address")]
    InvalidIpv4(String),
    /// The host is not a valid host name.
    #[error("{0:?} is not a host name")]
    InvalidName(String),
    /// The port is missing.
    #[error("the port is missing")]
    NoPort,
    /// The port is not a number.
    #[error("{0:?} is not a port")]
    InvalidPort(String),
    /// The port is above 65,535.
    #[error("port {0} is above 65535")]
    PortTooLarge(String),
    /// The text in place of host and port is not the number of a ROS 2 domain.
    #[error("{0:?} is not a domain; ROS 2 has the domains 0 to {max}", max = Ros2Settings::MAX_DOMAIN_ID)]
    InvalidDomain(String),
    /// The listener's name cannot be part of a topic name.
    #[error(
        "the name {0:?} must begin with a letter and have at most 63 characters, only letters, digits and _"
    )]
    InvalidListenerName(String),
}

/// Error: a configuration names another network than the address.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the network is {named}, but {address} is an address of {}; leave the network out, or write {}", .address.network(), forms_of(&[*.named]))]
pub struct NetworkMismatch {
    /// Network that was named.
    pub named: NetworkKind,
    /// Address of another network.
    pub address: Address,
}

/// Error: the event stream between agent and aggregator is not sent over the network of this address.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the event stream uses the network {default}, but {0} is an address of {network}; write {form}", default = NetworkKind::default(), network = .0.network(), form = forms_of(&[NetworkKind::default()]))]
pub struct UnsupportedEventStreamNetwork(pub Address);

impl Address {
    /// Returns the address `tcp://ip:port`.
    pub const fn from_ip(ip: IpAddr, port: u16) -> Self {
        // `ALL[0]` is `zmq-tcp`, the default network. `NetworkKind::default()` is not `const`.
        Self { scheme: Scheme::from_network(NetworkKind::ALL[0]), host: Host::Ip(ip), port, name: None }
    }

    /// Returns the address with its host and port replaced.
    #[must_use]
    pub fn with_ip(&self, ip: IpAddr, port: u16) -> Self {
        Self { scheme: self.scheme, host: Host::Ip(ip), port, name: self.name.clone() }
    }

    /// Returns the ROS 2 domain of the listener; `None` if the address has a host and a port instead.
    pub const fn ros_domain(&self) -> Option<u16> {
        match &self.host {
            Host::Domain(domain) => Some(*domain),
            Host::Ip(_) | Host::Name(_) => None,
        }
    }

    /// Returns the network that the scheme selects.
    pub const fn network(&self) -> NetworkKind {
        self.scheme.network
    }

    /// Returns the scheme: the text before `://`.
    pub const fn scheme(&self) -> &'static str {
        self.scheme.text
    }

    /// Checks that the scheme selects `named`, a network that was named next to the address.
    ///
    /// # Errors
    /// If the scheme selects another network.
    pub fn check_network(&self, named: Option<NetworkKind>) -> Result<(), NetworkMismatch> {
        match named {
            Some(named) if named != self.network() => Err(NetworkMismatch { named, address: self.clone() }),
            _ => Ok(()),
        }
    }

    /// Checks that the network of this address carries the event stream between agent and aggregator.
    ///
    /// # Errors
    /// If the address is of another network.
    pub fn check_event_stream(&self) -> Result<(), UnsupportedEventStreamNetwork> {
        if self.network() == NetworkKind::default() {
            Ok(())
        } else {
            Err(UnsupportedEventStreamNetwork(self.clone()))
        }
    }

    /// Returns the host without brackets, or the number of the domain.
    pub fn host(&self) -> String {
        match &self.host {
            Host::Domain(domain) => domain.to_string(),
            Host::Ip(ip) => ip.to_string(),
            Host::Name(name) => name.clone(),
        }
    }

    /// Returns the port; 0 lets the system choose one. An address of a domain has no port and returns 0.
    pub const fn port(&self) -> u16 {
        self.port
    }

    /// Returns the name of the listener if the address identifies the listener by a name; `None` if host and port of
    /// the address belong to the listener.
    pub fn listener_name(&self) -> Option<&str> {
        self.name.as_deref()
    }

    /// Returns whether only this machine can reach a listener at this address.
    pub fn is_loopback(&self) -> bool {
        match &self.host {
            Host::Ip(ip) => ip.is_loopback(),
            Host::Name(name) => name.eq_ignore_ascii_case("localhost"),
            // The interfaces of a domain are a setting, not part of the address.
            Host::Domain(_) => false,
        }
    }

    /// Returns `host:port` with IPv6 hosts in brackets, or the number of the domain.
    pub fn authority(&self) -> String {
        match &self.host {
            Host::Domain(domain) => domain.to_string(),
            Host::Ip(IpAddr::V6(ip)) => format!("[{ip}]:{}", self.port),
            Host::Ip(IpAddr::V4(ip)) => format!("{ip}:{}", self.port),
            Host::Name(name) => format!("{name}:{}", self.port),
        }
    }
}

impl FromStr for Address {
    type Err = InvalidAddress;

    fn from_str(text: &str) -> Result<Self, InvalidAddress> {
        parse(text).map_err(|problem| InvalidAddress { text: text.to_owned(), problem })
    }
}

fn parse(text: &str) -> Result<Address, AddressProblem> {
    let Some((scheme, rest)) = text.split_once("://") else {
        return Err(AddressProblem::NoScheme);
    };
    let Some(scheme) = Scheme::find(scheme) else {
        return Err(AddressProblem::UnknownScheme(scheme.to_owned()));
    };
    let form = scheme.network.address_form();
    let (authority, name) = match form {
        AddressForm::HostPort => (rest, None),
        AddressForm::Named { name: default_name, .. } => {
            let (authority, name) = rest.split_once('/').unwrap_or((rest, ""));
            (authority, Some(parse_name(if name.is_empty() { default_name } else { name })?))
        }
    };
    // DDS derives all ports from the number of the domain, so such an address has no port.
    if matches!(form, AddressForm::Named { domain_scheme, .. } if domain_scheme == scheme.text) {
        return Ok(Address { scheme, host: Host::Domain(parse_domain(authority)?), port: 0, name });
    }
    let text_with_port;
    let authority = match form {
        AddressForm::Named { port, .. } if !has_port(authority) => {
            text_with_port = format!("{authority}:{port}");
            &text_with_port
        }
        _ => authority,
    };
    let (host, port) = if let Some(bracketed) = authority.strip_prefix('[') {
        let (host, after_bracket) = bracketed.split_once(']').ok_or(AddressProblem::NoClosingBracket)?;
        let ip: Ipv6Addr = host.parse().map_err(|_| AddressProblem::InvalidIpv6(host.to_owned()))?;
        let port = after_bracket.strip_prefix(':').ok_or(AddressProblem::NoPort)?;
        (Host::Ip(IpAddr::V6(ip)), port)
    } else {
        let (host, port) = authority.rsplit_once(':').ok_or(AddressProblem::NoPort)?;
        (parse_host(host)?, port)
    };
    // The digits are checked before the number is parsed, because the parser of the standard library accepts a plus
    // sign.
    if port.is_empty() || !port.bytes().all(|byte| byte.is_ascii_digit()) {
        return Err(AddressProblem::InvalidPort(port.to_owned()));
    }
    let port = port.parse().map_err(|_| AddressProblem::PortTooLarge(port.to_owned()))?;
    Ok(Address { scheme, host, port, name })
}

fn parse_domain(text: &str) -> Result<u16, AddressProblem> {
    // The parser of the standard library accepts a plus sign.
    let number = text.parse().ok().filter(|_| text.bytes().all(|byte| byte.is_ascii_digit()));
    let domain = number.filter(|number| *number <= Ros2Settings::MAX_DOMAIN_ID);
    domain.ok_or_else(|| AddressProblem::InvalidDomain(text.to_owned()))
}

fn has_port(authority: &str) -> bool {
    // In an IPv6 host without a port, such as `[::1]`, the text after the last colon contains the bracket.
    authority.rsplit_once(':').is_some_and(|(_, port)| !port.contains(']'))
}

/// Parses the name of a listener, which becomes part of a topic name.
fn parse_name(name: &str) -> Result<String, AddressProblem> {
    let is_name = name.starts_with(|first: char| first.is_ascii_alphabetic())
        && name.len() <= 63
        && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
    if is_name { Ok(name.to_owned()) } else { Err(AddressProblem::InvalidListenerName(name.to_owned())) }
}

/// Returns the forms of addresses of these networks, for error texts. If `text` has the scheme of one of these
/// networks, returns only the form of that scheme.
fn suggested_forms(text: &str, networks: &[NetworkKind]) -> String {
    let scheme = text.split_once("://").and_then(|(scheme, _)| Scheme::find(scheme));
    let scheme = scheme.filter(|scheme| networks.contains(&scheme.network));
    let forms = scheme.map_or_else(
        || forms_of(networks),
        |Scheme { network, text }| format!("{text}://{}", network.address_form().placeholder(text)),
    );
    let brackets = if forms.contains("host") { ", IPv6 hosts in brackets" } else { "" };
    format!("{forms}{brackets}")
}

/// Returns the forms of all addresses of these networks.
fn forms_of(networks: &[NetworkKind]) -> String {
    let form = |network: &NetworkKind| {
        let form = network.address_form();
        network.schemes().iter().map(move |scheme| format!("{scheme}://{}", form.placeholder(scheme)))
    };
    let forms: BTreeSet<String> = networks.iter().flat_map(form).collect();
    forms.into_iter().collect::<Vec<_>>().join(" or ")
}

/// Parses a host name or an IPv4 address. A text of digits and dots must be an IPv4 address.
fn parse_host(host: &str) -> Result<Host, AddressProblem> {
    if host.is_empty() {
        return Err(AddressProblem::NoHost);
    }
    if host.contains(':') {
        return Err(AddressProblem::Ipv6WithoutBrackets);
    }
    if let Ok(ip) = host.parse() {
        return Ok(Host::Ip(IpAddr::V4(ip)));
    }
    // Without this check, a mistyped IPv4 address would be looked up as a host name.
    if host.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.') {
        return Err(AddressProblem::InvalidIpv4(host.to_owned()));
    }
    // A host name has no underscore. The name of a container may have one, and is resolved like a host name.
    let is_valid_label = |label: &str| {
        (1..=63).contains(&label.len())
            && label.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_".contains(&byte))
    };
    // These are limits of DNS (RFC 1035, section 2.3.4): 63 bytes for a label, and 255 bytes for an encoded name. The
    // text of such a name has 253 bytes.
    if host.len() > 253 || !host.strip_suffix('.').unwrap_or(host).split('.').all(is_valid_label) {
        return Err(AddressProblem::InvalidName(host.to_owned()));
    }
    Ok(Host::Name(host.to_owned()))
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}://{}", self.scheme(), self.authority())?;
        self.name.as_ref().map_or(Ok(()), |name| write!(f, "/{name}"))
    }
}

impl TryFrom<String> for Address {
    type Error = InvalidAddress;
    fn try_from(text: String) -> Result<Self, InvalidAddress> {
        text.parse()
    }
}

impl From<Address> for String {
    fn from(address: Address) -> Self {
        address.to_string()
    }
}

#[cfg(test)]
mod tests;
