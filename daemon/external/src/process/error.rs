//! Errors of a process.

use std::io;

use super::ProcessEnd;

/// Reason that a process cannot be started, written to or read from.
#[derive(Debug, thiserror::Error)]
pub enum ProcessError {
    /// The process cannot be started.
    #[error("cannot start {program}: {error}")]
    Start {
        /// The program, and its working directory if one is configured.
        program: String,
        /// Error of the operating system.
        error: io::Error,
    },
    /// The process ended or closed its pipe, so no further call can succeed.
    #[error("{0}")]
    ProcessEnd(ProcessEnd),
    /// The process did not read or write everything that the call needs before the deadline.
    #[error("it did not answer before its timeout")]
    TimedOut,
    /// The process sent a line of more than the given number of bytes.
    #[error("it sent a line of more than {0} bytes")]
    LineTooLong(usize),
    /// Reading from or writing to a pipe failed for another reason.
    #[error("its pipe failed: {0}")]
    Pipe(io::Error),
}
