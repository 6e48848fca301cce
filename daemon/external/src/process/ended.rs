//! How a process ended.

use std::fmt;
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

/// How a process ended, and the last that it said.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ended {
    /// Exit status or signal; `None` when the system did not tell.
    pub status: Option<ExitStatus>,
    /// Why this program killed it; `None` when it ended by itself, or another killed it.
    pub killed: Option<Killed>,
    /// The last lines of its standard error, oldest first.
    pub last_lines: Vec<String>,
}

/// Why this program killed a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Killed {
    /// It no longer reads what is written to it.
    ClosedInput,
    /// Nothing more can be read from it.
    ClosedOutput,
    /// It was asked to end and did not.
    Stayed,
}

impl Killed {
    const fn did(self) -> &'static str {
        match self {
            Self::ClosedInput => "closed its standard input",
            Self::ClosedOutput => "closed its standard output",
            Self::Stayed => "did not end when it was asked to",
        }
    }
}

impl Ended {
    /// Whether it ended by itself and well.
    pub fn well(&self) -> bool {
        self.status.is_some_and(|status| status.success())
    }

    /// The status in words: `exit status 3`, `signal 11 (SIGSEGV)`.
    pub fn in_words(&self) -> String {
        match self.status {
            Some(status) => match (status.code(), status.signal()) {
                (Some(code), _) => format!("exit status {code}"),
                (None, Some(signal)) => match signal_name(signal) {
                    Some(name) => format!("signal {signal} ({name})"),
                    None => format!("signal {signal}"),
                },
                (None, None) => status.to_string(),
            },
            None => "an unknown status".to_owned(),
        }
    }
}

impl fmt::Display for Ended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.killed {
            Some(killed) => write!(f, "the process {} and was killed", killed.did())?,
            None => write!(f, "the process ended with {}", self.in_words())?,
        }
        if !self.last_lines.is_empty() {
            write!(f, "; its last words: {}", self.last_lines.join(" / "))?;
        }
        Ok(())
    }
}

/// The signals that end processes in practice.
fn signal_name(signal: i32) -> Option<&'static str> {
    Some(match signal {
        2 => "SIGINT",
        4 => "SIGILL",
        6 => "SIGABRT",
        7 => "SIGBUS",
        8 => "SIGFPE",
        9 => "SIGKILL: killed, or out of memory",
        11 => "SIGSEGV",
        13 => "SIGPIPE",
        15 => "SIGTERM",
        _ => return None,
    })
}
