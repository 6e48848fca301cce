//! The end of a process: status, reason and last output.

use std::fmt;
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

use rustix::process::Signal;

/// End of a process, with the last lines that it wrote to its standard error.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProcessEnd {
    /// Exit status or signal; `None` if the system did not report it.
    pub status: Option<ExitStatus>,
    /// Misbehaviour before the end of the process; `None` if the process did not misbehave.
    pub fault: Option<Fault>,
    /// `true` if PEERNet killed the process.
    pub was_killed: bool,
    /// `true` if PEERNet had asked the process to end (SIGTERM).
    pub termination_requested: bool,
    /// Last lines of its standard error, oldest first.
    pub last_lines: Vec<String>,
}

/// Misbehaviour that makes a running process unusable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The process no longer reads what is written to it.
    ClosedInput,
    /// The process closed its standard output.
    ClosedOutput,
    /// The process did not end after SIGTERM.
    IgnoredTermination,
}

impl Fault {
    const fn description(self) -> &'static str {
        match self {
            Self::ClosedInput => "closed its standard input",
            Self::ClosedOutput => "closed its standard output",
            Self::IgnoredTermination => "did not end after SIGTERM",
        }
    }
}

impl ProcessEnd {
    /// Returns whether the exit status is 0, also after a requested termination.
    pub fn is_success(&self) -> bool {
        self.status.is_some_and(|status| status.success())
    }

    /// Returns whether the process ended as requested: with exit status 0, by the SIGTERM that PEERNet sent, or
    /// with the exit status by which a shell reports that signal (128 + 15).
    pub fn ended_as_requested(&self) -> bool {
        let term = Signal::TERM.as_raw();
        let by_term = |status: ExitStatus| status.signal() == Some(term) || status.code() == Some(128 + term);
        self.is_success() || self.termination_requested && self.status.is_some_and(by_term)
    }

    /// Returns the status as text: `exit status 3`, `signal 11 (SIGSEGV)`.
    pub fn status_text(&self) -> String {
        match self.status {
            Some(status) => match (status.code(), status.signal()) {
                // If a signal ends a program, a shell reports 128 + the number of the signal as exit status.
                (Some(code), _) => match signal_name(code - 128) {
                    Some(name) => format!(
                        "exit status {code} (from a shell: signal {}, {name}{})",
                        code - 128,
                        signal_cause(code - 128)
                    ),
                    None => format!("exit status {code}"),
                },
                (None, Some(signal)) => match signal_name(signal) {
                    Some(name) => format!("signal {signal} ({name}{})", signal_cause(signal)),
                    None => format!("signal {signal}"),
                },
                (None, None) => status.to_string(),
            },
            None => "an unknown status".to_owned(),
        }
    }

    /// Returns the last lines of its standard error as a suffix for a message; empty if there are none.
    pub fn stderr_suffix(&self) -> String {
        match self.last_lines.as_slice() {
            [] => String::new(),
            lines => format!("; last lines of its standard error: {}", lines.join(" / ")),
        }
    }
}

impl fmt::Display for ProcessEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the process ")?;
        match self.fault.map(Fault::description) {
            Some(fault) if self.was_killed => write!(f, "{fault} and was killed")?,
            Some(fault) => write!(f, "{fault} and ended with {}", self.status_text())?,
            None => write!(f, "ended with {}", self.status_text())?,
        }
        f.write_str(&self.stderr_suffix())
    }
}

/// Returns the name of a signal that ends processes in practice.
fn signal_name(signal: i32) -> Option<&'static str> {
    Some(match signal {
        2 => "SIGINT",
        4 => "SIGILL",
        6 => "SIGABRT",
        7 => "SIGBUS",
        8 => "SIGFPE",
        9 => "SIGKILL",
        11 => "SIGSEGV",
        13 => "SIGPIPE",
        15 => "SIGTERM",
        _ => return None,
    })
}

/// Returns a possible cause of a signal as a suffix for its name; empty if the name says enough.
const fn signal_cause(signal: i32) -> &'static str {
    // The kernel sends SIGKILL to a process if the system has no memory left.
    if signal == 9 { "; perhaps the system ran out of memory" } else { "" }
}
