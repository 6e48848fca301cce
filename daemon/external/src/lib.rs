//! Custom code in separate processes, which are connected by pipes and restarted after they died.
//!
//! [`process`] starts a process, exchanges bytes with it and ends it; it does not interpret the bytes. [`python`]
//! calls a Python object (`module::object`) in such a process, [`exec`] any program. Only the host's own
//! configuration or command line names the code to be run, never a peer.

pub mod exec;
pub mod process;
pub mod python;

mod digest;
mod environment;
mod role;
mod text;

pub use digest::{MAX_HASHED_BYTES, describe_with_hash, sha256};
pub use environment::{
    DEVICE_VARIABLE, REPEAT_VARIABLE, SEED_VARIABLE, USER_VARIABLE, environment, hide_values,
};
