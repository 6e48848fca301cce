//! What can go wrong, in words that say what was tried, on what, and what to do.

use peernet_store::OpenError;

/// A value of the configuration that cannot work.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{key}: {message}")]
pub struct Problem {
    /// The key within the `[aggregator]` table.
    pub key: &'static str,
    /// What is wrong and what to do.
    pub message: String,
}

/// Why the aggregator did not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// A value of the configuration cannot work.
    #[error("cannot start the aggregator: {0}")]
    Configuration(#[from] Problem),
    /// The address is taken or not this machine's.
    #[error(
        "cannot listen on {address}: {source}; is another aggregator running there? choose another address with `listen`"
    )]
    Listen {
        /// The configured address.
        address: String,
        /// What the system says.
        source: peernet_networks::BindFailure,
    },
    /// The database cannot be had.
    #[error(transparent)]
    Database(#[from] OpenError),
}

/// Why the aggregator ended without being asked to.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// One of its tasks panicked.
    #[error("the aggregator's {task} task died: {reason}")]
    TaskDied {
        /// Which.
        task: &'static str,
        /// The panic's words.
        reason: String,
    },
    /// One of its tasks ended early.
    #[error("the aggregator's {0} task ended before it was asked to")]
    TaskEnded(&'static str),
    /// The socket broke.
    #[error("cannot receive on {address}: its socket was closed")]
    Socket {
        /// Where it listened.
        address: String,
    },
}
