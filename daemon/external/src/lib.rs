//! Users' own code, run in separate processes that are connected by pipes and restarted when they die.
//!
//! [`process`] starts, writes to, watches and ends a process; it does not interpret the bytes. [`python`] calls a
//! Python object (`module::object`) in such a process, [`exec`] any program. Only the host's own configuration or
//! command line names the code to be run, never a peer.

pub mod exec;
pub mod process;
pub mod python;

mod digest;
mod environment;
mod text;

pub use digest::{describe_with_hash, sha256};
pub use environment::{environment, hide_values};
