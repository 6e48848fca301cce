//! Users' own code beside the daemon: a process behind two pipes, started anew when it dies.
//!
//! [`process`] starts, feeds, watches and ends a process and knows nothing of what it says. [`python`] runs a Python
//! object (`module::object`) in such a process. What may be run is named by the host's own configuration or command
//! line, never by a peer.

pub mod exec;
pub mod process;
pub mod python;

mod digest;
mod environment;
mod text;

pub use digest::{identified, sha256};
pub use environment::{environment, hide_values};
