//! How a process ended.

use std::fmt;
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

use rustix::process::Signal;

/// How a process ended, and the last that it said.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ended {
    /// Exit status or signal; `None` when the system did not tell.
    pub status: Option<ExitStatus>,
    /// What it did while it still ran, so that it had to end; `None` when it just ended.
    pub fault: Option<Fault>,
    /// Whether this program killed it.
    pub killed: bool,
    /// Whether this program had asked it to end (SIGTERM).
    pub asked: bool,
    /// The last lines of its standard error, oldest first.
    pub last_lines: Vec<String>,
}

/// After what a process is of no more use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// It no longer reads what is written to it.
    ClosedInput,
    /// Nothing more can be read from it.
    ClosedOutput,
    /// It was asked to end and did not.
    Stayed,
}

impl Fault {
    const fn in_words(self) -> &'static str {
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

    /// Whether it ended as it was to: well, or by the signal with which this program asked it to, whose number and 128 is
    /// what a shell makes of it.
    pub fn as_asked(&self) -> bool {
        let term = Signal::TERM.as_raw();
        let by_term = |status: ExitStatus| status.signal() == Some(term) || status.code() == Some(128 + term);
        self.well() || self.asked && self.status.is_some_and(by_term)
    }

    /// The status in words: `exit status 3`, `signal 11 (SIGSEGV)`.
    pub fn in_words(&self) -> String {
        match self.status {
            Some(status) => match (status.code(), status.signal()) {
                // 128 and the number of the signal: what a shell makes of a program that was killed.
                (Some(code), _) => match signal_name(code - 128) {
                    Some(name) => format!("exit status {code} (from a shell: signal {}, {name})", code - 128),
                    None => format!("exit status {code}"),
                },
                (None, Some(signal)) => match signal_name(signal) {
                    Some(name) => format!("signal {signal} ({name})"),
                    None => format!("signal {signal}"),
                },
                (None, None) => status.to_string(),
            },
            None => "an unknown status".to_owned(),
        }
    }

    /// The last that it said, to be put behind a message; empty when it said nothing.
    pub fn last_words(&self) -> String {
        match self.last_lines.as_slice() {
            [] => String::new(),
            lines => format!("; its last words: {}", lines.join(" / ")),
        }
    }
}

impl fmt::Display for Ended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the process ")?;
        match self.fault.map(Fault::in_words) {
            Some(fault) if self.killed => write!(f, "{fault} and was killed")?,
            Some(fault) => write!(f, "{fault} and ended with {}", self.in_words())?,
            None => write!(f, "ended with {}", self.in_words())?,
        }
        f.write_str(&self.last_words())
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
