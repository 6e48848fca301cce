//! Reasons why a listener could not be bound.

use std::io;

/// Reason why a listener could not be bound.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BindFailure {
    /// Another socket has the port.
    #[error("another program uses the port")]
    InUse,
    /// The port needs a privilege.
    #[error("permission denied")]
    Denied,
    /// The address does not belong to this machine.
    #[error("this machine has no such address")]
    NotLocal,
    /// Another error, in the words of the system.
    #[error("{0}")]
    Other(String),
}

impl From<io::Error> for BindFailure {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::AddrInUse => Self::InUse,
            io::ErrorKind::PermissionDenied => Self::Denied,
            io::ErrorKind::AddrNotAvailable => Self::NotLocal,
            _ => Self::Other(error.to_string()),
        }
    }
}
