//! Kinds of networks, as people write them.

use peernet_networks::NetworkKind;

/// A kind by its published name.
///
/// # Errors
/// Which there are.
pub(crate) fn network(text: &str) -> Result<NetworkKind, String> {
    let known: Vec<&str> = NetworkKind::ALL.iter().map(|kind| kind.name()).collect();
    let found = NetworkKind::ALL.iter().find(|kind| kind.name() == text).copied();
    found.ok_or_else(|| match text {
        "zmq-udp" | "ros" => format!("{text} is not there yet; use {}", known.join(" or ")),
        _ => format!("there is {}", known.join(", ")),
    })
}
