//! Why a port could not be listened on.

use crate::Address;

/// Why a port could not be listened on.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BindError {
    /// Another program listens there.
    #[error(
        "cannot listen on {0}: another program uses port {port}; stop it or configure another port",
        port = .0.port()
    )]
    InUse(Address),
    /// The port needs a privilege.
    #[error(
        "cannot listen on {0}: permission denied; ports below 1024 need a privilege, configure a higher one"
    )]
    Denied(Address),
    /// The address is another machine's.
    #[error(
        "cannot listen on {0}: this machine has no such address; use {scheme}://0.0.0.0:{port} for all of its interfaces",
        scheme = .0.scheme(),
        port = .0.port()
    )]
    NotLocal(Address),
    /// Anything else.
    #[error("cannot listen on {0}: {1}")]
    Other(Address, String),
}
