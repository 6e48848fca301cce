//! Reasons why a port cannot be bound.

use crate::Address;

/// Error: the port cannot be bound.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BindError {
    /// Another program listens on the port.
    #[error(
        "cannot listen on {0}: another program uses port {port}; stop it or configure another port",
        port = .0.port()
    )]
    InUse(Address),
    /// The process lacks the privilege that the port needs.
    #[error(
        "cannot listen on {0}: permission denied; ports below 1024 need a privilege; configure a higher port"
    )]
    Denied(Address),
    /// The address belongs to another machine.
    #[error(
        "cannot listen on {0}: this machine has no such address; use {scheme}://0.0.0.0:{port} to listen on all of its interfaces",
        scheme = .0.scheme(),
        port = .0.port()
    )]
    NotLocal(Address),
    /// Another error, in the words of the system.
    #[error("cannot listen on {0}: {1}")]
    Other(Address, String),
}
