//! Errors of the aggregator. Each message states what was attempted and on which object, and what to do if something
//! can be done.

use peernet_store::OpenError;

/// An invalid value of the configuration.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{key}: {message}")]
pub struct Problem {
    /// Key within the `[aggregator]` table.
    pub key: &'static str,
    /// The problem and its remedy.
    pub message: String,
}

/// Reason for which the aggregator did not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// A configured value is invalid.
    #[error("cannot start the aggregator: {0}")]
    Configuration(#[from] Problem),
    /// The address is in use or does not belong to this machine.
    #[error(
        "cannot listen on {address}: {source}; is another aggregator running there? choose another address with `listen`"
    )]
    Listen {
        /// Configured address.
        address: String,
        /// Error of the operating system.
        source: peernet_networks::BindFailure,
    },
    /// The database cannot be opened.
    #[error(transparent)]
    Database(#[from] OpenError),
}

/// Reason for which the aggregator ended although it was not stopped.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// A task panicked.
    #[error("the aggregator's {task} task panicked: {reason}")]
    TaskDied {
        /// Name of the task.
        task: &'static str,
        /// Message of the panic.
        reason: String,
    },
    /// A task ended early.
    #[error("the aggregator's {0} task ended unexpectedly")]
    TaskEnded(&'static str),
    /// The socket was closed.
    #[error("cannot receive on {address}: the socket was closed")]
    Socket {
        /// Address that the socket listened on.
        address: String,
    },
}
