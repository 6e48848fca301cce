//! Kinds of networks, as people write them.

use peernet_networks::NetworkKind;

/// A text that is not the name of a kind of network.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the kinds are {}", known_kinds())]
pub(crate) struct NetworkNameError;

/// Returns the kind of network with this name.
///
/// # Errors
/// When no kind has this name.
pub(crate) fn parse_network_kind(text: &str) -> Result<NetworkKind, NetworkNameError> {
    NetworkKind::ALL.iter().find(|kind| kind.name() == text).copied().ok_or(NetworkNameError)
}

fn known_kinds() -> String {
    NetworkKind::ALL.iter().map(|kind| kind.name()).collect::<Vec<_>>().join(", ")
}
