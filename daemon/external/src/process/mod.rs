//! A process behind two pipes: what is written reaches its standard input, what is read came from its standard
//! output, and what it says on its standard error goes to the log, line by line.
//!
//! All calls block the thread that makes them, until a moment the caller gives. A process has a group of its own, which
//! is ended with it, also when it ended by itself, and with this program, however that ends.

mod ended;
mod error;
mod group;
mod launch;
mod pipe;
mod restarts;
mod running;
mod spawner;
mod voice;

pub use ended::{Ended, Fault};
pub use error::ProcessError;
pub(crate) use launch::impossible_variable;
pub use launch::{Launch, find_program};
pub use restarts::Restarts;
pub use running::Process;
pub use voice::Voice;

/// Longest wait for a process: a day. Milliseconds.
pub(crate) const MAX_TIMEOUT_MS: u64 = 24 * 3600 * 1000;
