//! Why an agent did not start.

use std::io;

use peernet_logger::InvalidName;
use peernet_networks::{Address, BindError};
use peernet_probes::KeyError;

use crate::identity::IdentityError;
use crate::outbox::SpoolError;

/// Why an agent did not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The machine's own name cannot be used as the agent's.
    #[error("{0}; set [agent] name")]
    Name(#[from] InvalidName),
    /// There are no threads for it.
    #[error("cannot start the threads for samples: {0}; [agent] io_threads says how many")]
    Threads(#[source] io::Error),
    /// The host id could not be read or made.
    #[error(transparent)]
    Identity(#[from] IdentityError),
    /// The spool could not be had.
    #[error(transparent)]
    Spool(#[from] SpoolError),
    /// The port for peers could not be had.
    #[error(transparent)]
    Bind(#[from] BindError),
    /// The port for peers' probes could not be had.
    #[error(transparent)]
    Reflector(#[from] ReflectorError),
    /// The key for probes could not be read.
    #[error("{0}; [probes] key_file names it")]
    Key(#[from] KeyError),
}

/// Why peers' probes cannot be answered.
#[derive(Debug, thiserror::Error)]
pub enum ReflectorError {
    /// The port could not be had.
    #[error("{0} ([probes] port, or reflect = false to answer none)")]
    Bind(#[from] peernet_probes::BindError),
    /// The name to listen on leads nowhere.
    #[error("cannot answer probes on {listen}: {source}; give [serve] listen an address of this machine")]
    Address {
        /// Where the host listens for peers.
        listen: Address,
        /// What is wrong with it.
        source: io::Error,
    },
}
