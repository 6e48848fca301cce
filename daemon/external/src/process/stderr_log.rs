//! The standard error of a process, passed on to the log.

use std::collections::VecDeque;
use std::io::{self, Read};
use std::process::ChildStderr;
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use peernet_sample::printable_lines;

/// Longest line in the log, bytes; a longer one is split.
const MAX_LINE_BYTES: usize = 4096;
/// Largest number of last lines in the report of the process's end.
const MAX_KEPT_LINES: usize = 12;
/// Longest part of a line in that report.
const MAX_KEPT_LINE_BYTES: usize = 400;

/// Log target of a process's standard error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StderrLog {
    /// Target `peernet_external::python`.
    Python,
    /// Target `peernet_external::exec`.
    Exec,
}

impl StderrLog {
    fn log_line(self, name: &str, line: &str) {
        match self {
            Self::Python => tracing::info!(target: "peernet_external::python", name, "{line}"),
            Self::Exec => tracing::info!(target: "peernet_external::exec", name, "{line}"),
        }
    }
}

/// The thread that logs the lines, and the last of them.
#[derive(Debug)]
pub(super) struct StderrReader {
    last: Arc<Mutex<VecDeque<String>>>,
    closed: Receiver<()>,
}

impl StderrReader {
    pub(super) fn start(stderr: ChildStderr, stderr_log: StderrLog, name: String) -> io::Result<Self> {
        let last = Arc::new(Mutex::new(VecDeque::with_capacity(MAX_KEPT_LINES)));
        let (end, closed) = sync_channel(0);
        let keep = Arc::clone(&last);
        thread::Builder::new().name("stderr".to_owned()).spawn(move || {
            // Dropping the sender reports that the standard error is closed.
            let _end = end;
            read_lines(stderr, |line| {
                stderr_log.log_line(&name, line);
                keep_line(&keep, line);
            });
        })?;
        Ok(Self { last, closed })
    }

    /// Returns the last lines, after the standard error is closed or `timeout` has passed.
    pub(super) fn last_lines(&self, timeout: Duration) -> Vec<String> {
        let _ = self.closed.recv_timeout(timeout);
        self.last.lock().unwrap_or_else(PoisonError::into_inner).iter().cloned().collect()
    }
}

fn keep_line(last: &Mutex<VecDeque<String>>, line: &str) {
    let mut last = last.lock().unwrap_or_else(PoisonError::into_inner);
    if last.len() == MAX_KEPT_LINES {
        last.pop_front();
    }
    last.push_back(printable_lines(&line[..line.floor_char_boundary(MAX_KEPT_LINE_BYTES)]).into_owned());
}

/// Calls `log_line` with each line that is not blank.
fn read_lines(mut from: impl Read, mut log_line: impl FnMut(&str)) {
    let (mut line, mut chunk) = (Vec::new(), [0; MAX_LINE_BYTES]);
    let mut log_and_clear = |line: &mut Vec<u8>| {
        let text = String::from_utf8_lossy(line);
        let text = text.trim_end();
        if !text.is_empty() {
            log_line(text);
        }
        line.clear();
    };
    loop {
        let read = match from.read(&mut chunk) {
            Ok(0) => break,
            Ok(read) => read,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(_) => break,
        };
        for &byte in &chunk[..read] {
            if byte == b'\n' || line.len() >= MAX_LINE_BYTES {
                log_and_clear(&mut line);
            }
            if byte != b'\n' {
                line.push(byte);
            }
        }
    }
    log_and_clear(&mut line);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_logged_separately_and_long_ones_split() {
        let mut logged = Vec::new();
        let text = format!("one\r\n\n{}\nlast", "x".repeat(MAX_LINE_BYTES + 3));
        read_lines(text.as_bytes(), |line| logged.push(line.to_owned()));
        assert_eq!(logged, ["one", &"x".repeat(MAX_LINE_BYTES), "xxx", "last"]);
    }

    #[test]
    fn last_lines_are_kept_and_bounded() {
        let last = Mutex::new(VecDeque::new());
        for number in 0..100 {
            keep_line(&last, &format!("{number} {}", "ä".repeat(MAX_KEPT_LINE_BYTES)));
        }
        let last = last.into_inner().expect("not poisoned");
        assert_eq!(last.len(), MAX_KEPT_LINES);
        assert!(last.iter().all(|line| line.len() <= MAX_KEPT_LINE_BYTES));
        assert!(last.back().is_some_and(|line| line.starts_with("99 ")));
    }
}
