//! Kinds of networks, as people write them.

use peernet_networks::NetworkKind;

/// A name that no kind of network has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum NetworkNameError {
    /// The published program names it, this one does not have it.
    #[error("{0} is not there yet; use {known}", known = known(" or "))]
    Planned(String),
    /// Nobody knows it.
    #[error("there is {known}", known = known(", "))]
    Unknown,
}

/// A kind by its published name.
///
/// # Errors
/// When no kind has this name.
pub(crate) fn network(text: &str) -> Result<NetworkKind, NetworkNameError> {
    let found = NetworkKind::ALL.iter().find(|kind| kind.name() == text).copied();
    found.ok_or_else(|| match text {
        "ros" => NetworkNameError::Planned(text.to_owned()),
        _ => NetworkNameError::Unknown,
    })
}

fn known(between: &str) -> String {
    NetworkKind::ALL.iter().map(|kind| kind.name()).collect::<Vec<_>>().join(between)
}
