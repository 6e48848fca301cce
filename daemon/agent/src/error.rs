//! The errors that keep an agent from starting.

use std::io;

use peernet_logger::InvalidName;
use peernet_networks::{Address, BindError};
use peernet_probes::KeyError;

use crate::identity::IdentityError;
use crate::outbox::SpoolError;

/// Reason why an agent did not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The machine's own name is not a valid agent name, and no name is configured.
    #[error("{0}; set [agent] name")]
    Name(#[from] InvalidName),
    /// The operating system refuses to start the I/O threads.
    #[error("cannot start the I/O threads: {0}; lower their number, [agent] io_threads")]
    Threads(#[source] io::Error),
    /// A file of the state directory, such as the host id, could not be locked, read or created.
    #[error(transparent)]
    Identity(#[from] IdentityError),
    /// The spool could not be opened.
    #[error(transparent)]
    Spool(#[from] SpoolError),
    /// The agent cannot listen on the port for peers.
    #[error(transparent)]
    Bind(#[from] BindError),
    /// The agent cannot listen on the port for peers' probes.
    #[error(transparent)]
    Reflector(#[from] ReflectorError),
    /// The key for probes could not be read.
    #[error("{0}; check [probes] key_file")]
    Key(#[from] KeyError),
}

/// Reason why peers' probes cannot be answered.
#[derive(Debug, thiserror::Error)]
pub enum ReflectorError {
    /// The UDP port cannot be opened.
    #[error("{0}; choose another [probes] port, or set reflect = false to answer no probes")]
    Bind(#[from] peernet_probes::BindError),
    /// The host name to listen on cannot be resolved.
    #[error("cannot answer probes at {listen}: {source}; set [serve] listen to an address of this machine")]
    Address {
        /// Address at which the host listens for peers.
        listen: Address,
        /// Error of the name resolution.
        source: io::Error,
    },
}
