//! The standard error of a process, passed on to the log.

use std::collections::VecDeque;
use std::io;
use std::process::ChildStderr;
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use peernet_clock::SharedClock;
use peernet_sample::escaped_line;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use super::log_limit::{LogLimit, LogVolume};

/// Longest line in the log, bytes; a longer one is split.
const MAX_LINE_BYTES: usize = 4096;
/// Maximum number of last lines that are kept for [`ProcessEnd`](super::ProcessEnd).
const MAX_KEPT_LINES: usize = 12;
/// Longest part of a kept line, bytes.
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

    /// Logs a line beyond the limit. Such lines are logged at level `debug` only.
    fn log_omitted_line(self, name: &str, line: &str) {
        match self {
            Self::Python => tracing::debug!(target: "peernet_external::python", name, "{line}"),
            Self::Exec => tracing::debug!(target: "peernet_external::exec", name, "{line}"),
        }
    }

    fn log_omission(self, name: &str, omitted: LogVolume) {
        let LogVolume { lines, bytes } = omitted;
        let limit = LogLimit::in_words();
        self.log_line(
            name,
            &format!(
                "left out {lines} lines ({bytes} bytes) of its output: {limit}; PEERNET_LOG=info,peernet_external=debug shows all"
            ),
        );
    }
}

/// Handle of the thread that logs the lines of one process. It also has the last of these lines.
#[derive(Debug)]
pub(super) struct StderrReader {
    last_lines: Arc<Mutex<VecDeque<String>>>,
    /// Is disconnected when the standard error is closed.
    closed: Receiver<()>,
}

impl StderrReader {
    pub(super) fn start(
        stderr: ChildStderr,
        stderr_log: StderrLog,
        name: String,
        clock: SharedClock,
    ) -> io::Result<Self> {
        let last_lines = Arc::new(Mutex::new(VecDeque::with_capacity(MAX_KEPT_LINES)));
        let (end, closed) = sync_channel(0);
        let mut logger = LineLogger {
            stderr_log,
            name,
            clock,
            limit: LogLimit::default(),
            last_lines: Arc::clone(&last_lines),
        };
        thread::Builder::new().name("stderr".to_owned()).spawn(move || {
            // Dropping the sender reports that the standard error is closed.
            let _end = end;
            logger.log_all(&stderr);
        })?;
        Ok(Self { last_lines, closed })
    }

    /// Returns the last lines, after the standard error is closed or `timeout` has passed.
    pub(super) fn last_lines(&self, timeout: Duration) -> Vec<String> {
        let _ = self.closed.recv_timeout(timeout);
        self.last_lines.lock().unwrap_or_else(PoisonError::into_inner).iter().cloned().collect()
    }
}

/// Logger of the lines of one process.
struct LineLogger {
    stderr_log: StderrLog,
    name: String,
    clock: SharedClock,
    limit: LogLimit,
    last_lines: Arc<Mutex<VecDeque<String>>>,
}

impl LineLogger {
    /// Logs the lines until the standard error is closed.
    fn log_all(&mut self, stderr: &ChildStderr) {
        let (mut lines, mut chunk) = (LineSplitter::default(), [0; MAX_LINE_BYTES]);
        loop {
            self.wait_for_output(stderr);
            match rustix::io::read(stderr, &mut chunk) {
                Ok(0) => break,
                Ok(length) => lines.split(&chunk[..length], |line| self.log(line)),
                Err(Errno::INTR) => {}
                Err(_) => break,
            }
        }
        lines.finish(|line| self.log(line));
        if let Some(omitted) = self.limit.take_omitted() {
            self.stderr_log.log_omission(&self.name, omitted);
        }
    }

    /// Waits for output. Meanwhile, reports the left-out lines when their period ends.
    fn wait_for_output(&mut self, stderr: &ChildStderr) {
        while let Some(left) = self.limit.time_to_report(self.clock.mono()) {
            let timeout =
                Timespec { tv_sec: left.as_secs().cast_signed(), tv_nsec: left.subsec_nanos().into() };
            match poll(&mut [PollFd::new(stderr, PollFlags::IN)], Some(&timeout)) {
                Ok(0) => self.report(),
                Err(Errno::INTR) => {}
                // If polling failed, the next read returns the error.
                Ok(_) | Err(_) => return,
            }
        }
    }

    /// Logs the number of left-out lines if their period has ended.
    fn report(&mut self) {
        if let Some(omitted) = self.limit.take_omitted_after_period(self.clock.mono()) {
            self.stderr_log.log_omission(&self.name, omitted);
        }
    }

    fn log(&mut self, line: &str) {
        self.report();
        if self.limit.admit(line, self.clock.mono()) {
            self.stderr_log.log_line(&self.name, line);
        } else {
            self.stderr_log.log_omitted_line(&self.name, line);
        }
        keep_line(&self.last_lines, line);
    }
}

/// Appends a line to the last lines, without the part beyond [`MAX_KEPT_LINE_BYTES`].
fn keep_line(last_lines: &Mutex<VecDeque<String>>, line: &str) {
    let mut last_lines = last_lines.lock().unwrap_or_else(PoisonError::into_inner);
    if last_lines.len() == MAX_KEPT_LINES {
        last_lines.pop_front();
    }
    last_lines.push_back(line[..line.floor_char_boundary(MAX_KEPT_LINE_BYTES)].to_owned());
}

/// Splitter of output into lines. A carriage return ends a line as well: progress bars write only these.
#[derive(Default)]
struct LineSplitter(Vec<u8>);

impl LineSplitter {
    /// Calls `log` with each complete line that is not blank; control characters are escaped.
    fn split(&mut self, output: &[u8], mut log: impl FnMut(&str)) {
        for &byte in output {
            let is_end = matches!(byte, b'\n' | b'\r');
            if is_end || self.0.len() >= MAX_LINE_BYTES {
                self.finish(&mut log);
            }
            if !is_end {
                self.0.push(byte);
            }
        }
    }

    /// Calls `log` with the bytes of the current line, unless they are blank, and begins a new line.
    fn finish(&mut self, mut log: impl FnMut(&str)) {
        let line = self.0.trim_ascii_end();
        if !line.is_empty() {
            log(&escaped_line(line));
        }
        self.0.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_logged_separately_and_long_lines_are_split() {
        let (mut lines, mut logged) = (LineSplitter::default(), Vec::new());
        let text = format!("one\r\n\n{}\n50 %\r100 %\rlast\x1b[0m", "x".repeat(MAX_LINE_BYTES + 3));
        for chunk in text.as_bytes().chunks(7) {
            lines.split(chunk, |line| logged.push(line.to_owned()));
        }
        lines.finish(|line| logged.push(line.to_owned()));
        assert_eq!(logged, ["one", &"x".repeat(MAX_LINE_BYTES), "xxx", "50 %", "100 %", "last\\u{1b}[0m"]);
    }

    #[test]
    fn number_and_length_of_kept_lines_are_limited() {
        let last_lines = Mutex::new(VecDeque::new());
        for number in 0..100 {
            keep_line(&last_lines, &format!("{number} {}", "ä".repeat(MAX_KEPT_LINE_BYTES)));
        }
        let last_lines = last_lines.into_inner().expect("not poisoned");
        assert_eq!(last_lines.len(), MAX_KEPT_LINES);
        assert!(last_lines.iter().all(|line| line.len() <= MAX_KEPT_LINE_BYTES));
        assert!(last_lines.back().is_some_and(|line| line.starts_with("99 ")));
    }
}
