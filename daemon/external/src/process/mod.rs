//! A process that is connected by pipes: standard input, standard output and standard error.
//!
//! Writes go to its standard input, reads come from its standard output, and each line of its standard error goes to
//! the log.
//!
//! All calls block the calling thread, until a deadline at most. Each process leads a separate process group. The
//! whole group is killed when the process or PEERNet ends, for whatever reason.

mod error;
mod group;
mod launch;
mod log_limit;
mod pipe;
mod process_end;
mod restart_backoff;
mod running;
mod spawner;
mod stderr_log;

pub use error::ProcessError;
pub use launch::{Launch, find_program};
pub(crate) use launch::{invalid_variable, is_executable};
pub use process_end::{Fault, ProcessEnd};
pub use restart_backoff::RestartBackoff;
pub use running::Process;
pub use stderr_log::StderrLog;

use peernet_clock::Span;

/// Time for a process to end after it is no longer needed.
pub(crate) const STOP_TIMEOUT: Span = Span::from_millis(1000);
/// Longest timeout that a configuration may set, milliseconds: one day.
pub const MAX_TIMEOUT_MS: u64 = 24 * 3600 * 1000;
