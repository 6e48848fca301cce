//! What can go wrong with a process.

use std::io;

use super::Ended;

/// Why a process could not be started, written to or read from.
#[derive(Debug, thiserror::Error)]
pub enum ProcessError {
    /// It could not be started.
    #[error("cannot start {program}: {error}")]
    Start {
        /// The program, and the folder it was to run in when there was one.
        program: String,
        /// What the system said.
        error: io::Error,
    },
    /// It ended, or closed its pipe: nothing more can be had from it.
    #[error("{0}")]
    Ended(Ended),
    /// It neither read nor wrote until the moment that was given.
    #[error("it did not answer in time")]
    TimedOut,
    /// What it sends is longer than allowed.
    #[error("it sends more than {0} bytes at once")]
    TooLong(usize),
    /// A pipe failed in another way.
    #[error("the pipe failed: {0}")]
    Pipe(io::Error),
}
