//! Exit codes as in sysexits(3), so that systemd and scripts can distinguish wrong input from other failures.

use std::fmt;
use std::process::ExitCode;

/// Exit code of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// Success.
    Ok = 0,
    /// The command line was wrong (64).
    Usage = 64,
    /// Stored data is damaged or has another problem (65).
    Data = 65,
    /// A named file does not exist: a data set, a model, a configuration (66).
    NoInput = 66,
    /// Something that is needed is not available: a peer, a port, a library (69).
    Unavailable = 69,
    /// A task died, or stopping took longer than allowed (70).
    Software = 70,
    /// Results cannot be written (73).
    Unwritten = 73,
    /// The results are written, but some iterations failed or the peer went away during the run (75).
    Incomplete = 75,
    /// The configuration is wrong: starting again will not help (78). systemd does not restart the service after it.
    Configuration = 78,
    /// The user ended the program early (130, as shells report Ctrl-C).
    Interrupted = 130,
}

impl Exit {
    /// Converts the exit code into the value that `main` returns. If a thread still uses ONNX Runtime, such as a thread
    /// that opens a large model, the process ends here without the destructors of libraries. These destructors would
    /// otherwise run while the thread uses the library. No output is lost, because output is not buffered.
    pub fn into_exit_code(self) -> ExitCode {
        if peernet_inference::is_library_in_use() {
            #[expect(
                unsafe_code,
                reason = "the standard library cannot end a process without running the destructors of libraries"
            )]
            // SAFETY: `_exit` has no requirements. Nothing of this process runs afterwards.
            unsafe {
                libc::_exit(i32::from(self as u8))
            }
        }
        ExitCode::from(self as u8)
    }
}

/// An error with its exit code.
#[derive(Debug)]
pub struct Failure {
    /// Exit code of the program.
    pub exit: Exit,
    /// The error with the chain of its causes.
    pub error: anyhow::Error,
}

impl Failure {
    /// Makes an error with an exit code.
    pub fn new(exit: Exit, error: impl Into<anyhow::Error>) -> Self {
        Self { exit, error: error.into() }
    }
}

impl fmt::Display for Failure {
    /// Writes the error and its causes in one line.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&error_line(&self.error))
    }
}

/// Returns an error and its causes in one line. Many errors already contain the text of their cause, so a text that
/// another text contains is left out.
pub fn error_line(error: &anyhow::Error) -> String {
    let mut texts: Vec<String> = Vec::new();
    for cause in error.chain().map(ToString::to_string) {
        if texts.iter().any(|text| text.contains(&cause)) {
            continue;
        }
        if texts.last().is_some_and(|text| cause.starts_with(text)) {
            texts.pop();
        }
        texts.push(cause);
    }
    texts.join(": ")
}

#[cfg(test)]
mod tests {
    use anyhow::anyhow;

    use super::*;

    #[test]
    fn repeated_cause_is_printed_once() {
        let error = anyhow!("No such file").context("cannot open x: No such file; make it");
        assert_eq!(error_line(&error), "cannot open x: No such file; make it");
        let error =
            anyhow!("it is in use").context("cannot start it: it is in use").context("cannot start it");
        assert_eq!(error_line(&error), "cannot start it: it is in use");
        let error = anyhow!("the reason").context("what failed").context("what was wanted");
        assert_eq!(error_line(&error), "what was wanted: what failed: the reason");
    }
}
