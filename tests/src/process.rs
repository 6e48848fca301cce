//! A program that a test starts. Its log is read continuously, and it is killed when the test ends.

use std::ffi::OsStr;
use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Condvar, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};

use crate::TEST_TIMEOUT;

/// Number of log lines of each running program that are printed when a test fails.
const PRINTED_LINES: usize = 200;

/// Option of `env` that restores the default action of signals. Without it, the program would inherit signals that are
/// ignored: SIGHUP by `nohup`, SIGINT and SIGQUIT by `&` in a script.
const DEFAULT_SIGNALS: &str = "--default-signal=HUP,INT,QUIT,TERM";

/// A running program.
#[derive(Debug)]
pub struct Process {
    /// Last argument; distinguishes the programs of a test in messages.
    name: String,
    child: Child,
    log: Arc<Log>,
    readers: Vec<JoinHandle<()>>,
}

/// Result of a program that has ended.
#[derive(Debug)]
pub struct ProcessEnd {
    /// Exit status.
    pub status: ExitStatus,
    /// Everything that it wrote to standard output and standard error.
    pub log: String,
}

#[derive(Debug, Default)]
struct Log {
    written: Mutex<WrittenText>,
    changed: Condvar,
}

/// Everything that a program has written so far.
#[derive(Debug, Default)]
struct WrittenText {
    /// Lines that ended with a line feed, which is removed.
    lines: Vec<String>,
    /// Ends of outputs that were closed without a line feed. They may be truncated lines.
    unterminated: Vec<String>,
    /// Number of readers that have ended.
    ended_readers: usize,
}

impl Process {
    /// Starts a program in a folder with additional environment variables. The program does not
    /// inherit signals that the tests ignore.
    ///
    /// # Panics
    /// If `env` cannot be started. A missing program is reported in the log.
    pub fn start<A: AsRef<OsStr>>(
        program: &Path,
        arguments: &[A],
        folder: &Path,
        environment: &[(&str, &str)],
    ) -> Self {
        // `env` is replaced by the program, so that signals reach the program.
        let mut child = Command::new("env")
            .arg(DEFAULT_SIGNALS)
            .arg(program)
            .args(arguments)
            .current_dir(folder)
            .envs(environment.iter().copied())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("cannot start {}: {error}", program.display()));
        let log = Arc::new(Log::default());
        let out = child.stdout.take().map(|pipe| log.clone().read_lines(pipe));
        let err = child.stderr.take().map(|pipe| log.clone().read_lines(pipe));
        let name =
            arguments.last().map_or_else(String::new, |last| last.as_ref().to_string_lossy().into_owned());
        Self { name, child, log, readers: out.into_iter().chain(err).collect() }
    }

    /// Returns the process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Returns everything that was written so far. The text ends with a line feed unless the last line
    /// is incomplete.
    pub fn log(&self) -> String {
        self.log.written.lock().expect("no reader panics").text()
    }

    /// Waits until a line contains `text`, and returns that line.
    ///
    /// # Panics
    /// If the program ends or [`TEST_TIMEOUT`] passes before.
    pub fn wait_for(&self, text: &str) -> String {
        self.wait_for_nth(text, 1)
    }

    /// Waits until `n` lines contain `text`, and returns the last of these lines.
    ///
    /// # Panics
    /// If the program ends or [`TEST_TIMEOUT`] passes before.
    pub fn wait_for_nth(&self, text: &str, n: usize) -> String {
        let guard = self.log.written.lock().expect("no reader panics");
        let (guard, _) = self
            .log
            .changed
            .wait_timeout_while(guard, TEST_TIMEOUT, |written| {
                written.lines_with(text).count() < n && written.ended_readers < self.readers.len()
            })
            .expect("no reader panics");
        let line = guard.lines_with(text).nth(n - 1).cloned();
        // The lock is released before the panic, because a poisoned lock would abort the tests while another panic
        // unwinds.
        drop(guard);
        line.unwrap_or_else(|| {
            panic!("{} did not log {text:?} {n} times; its log:\n{}", self.name, self.log())
        })
    }

    /// Waits until a line contains `text` or the program ends; returns whether there is such a line.
    ///
    /// # Panics
    /// If [`TEST_TIMEOUT`] passes before.
    pub fn logs_before_end(&self, text: &str) -> bool {
        let is_logged = |written: &WrittenText| written.lines_with(text).next().is_some();
        let guard = self.log.written.lock().expect("no reader panics");
        let (guard, timeout) = self
            .log
            .changed
            .wait_timeout_while(guard, TEST_TIMEOUT, |written| {
                !is_logged(written) && written.ended_readers < self.readers.len()
            })
            .expect("no reader panics");
        let logs_before_end = is_logged(&guard);
        drop(guard);
        assert!(
            !timeout.timed_out(),
            "{} neither ended nor logged {text:?}; its log:\n{}",
            self.name,
            self.log()
        );
        logs_before_end
    }

    /// Sends SIGTERM.
    pub fn terminate(&self) {
        self.signal(Signal::TERM);
    }

    /// Sends SIGKILL and waits for the end.
    ///
    /// # Panics
    /// If the program ended before it was killed.
    pub fn kill(mut self) -> ProcessEnd {
        self.signal(Signal::KILL);
        let end = self.wait();
        assert_eq!(
            end.status.signal(),
            Some(Signal::KILL.as_raw()),
            "{} ended before it was killed; its log:\n{}",
            self.name,
            end.log
        );
        end
    }

    /// Sends SIGTERM and waits for the end.
    pub fn stop(mut self) -> ProcessEnd {
        self.terminate();
        self.wait()
    }

    /// Sends a signal.
    pub fn signal(&self, signal: Signal) {
        let pid = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw).expect("a child has a pid");
        kill_process(pid, signal).expect("the child has not been waited for");
    }

    /// Waits for the end: until standard output and standard error are closed, and then for the exit.
    ///
    /// # Panics
    /// If the program does not end within [`TEST_TIMEOUT`].
    pub fn wait(&mut self) -> ProcessEnd {
        let guard = self.log.written.lock().expect("no reader panics");
        let (guard, timeout) = self
            .log
            .changed
            .wait_timeout_while(guard, TEST_TIMEOUT, |written| written.ended_readers < self.readers.len())
            .expect("no reader panics");
        drop(guard);
        assert!(!timeout.timed_out(), "{} does not end; its log:\n{}", self.name, self.log());
        let status = self.child.wait().expect("only this process waits for the child");
        ProcessEnd { status, log: self.log() }
    }

    /// Waits for the end without sending a signal, and consumes the process.
    pub fn wait_for_end(mut self) -> ProcessEnd {
        self.wait()
    }
}

impl Log {
    fn read_lines(self: Arc<Self>, pipe: impl Read + Send + 'static) -> JoinHandle<()> {
        std::thread::spawn(move || {
            let mut pipe = BufReader::new(pipe);
            let mut line = Vec::new();
            while pipe.read_until(b'\n', &mut line).is_ok_and(|length| length > 0) {
                self.written.lock().expect("no reader panics").push(&String::from_utf8_lossy(&line));
                self.changed.notify_all();
                line.clear();
            }
            self.written.lock().expect("no reader panics").ended_readers += 1;
            self.changed.notify_all();
        })
    }
}

impl WrittenText {
    /// Adds a line with its line feed, or the end of an output that was closed without one.
    fn push(&mut self, line: &str) {
        match line.strip_suffix('\n') {
            Some(line) => self.lines.push(line.trim_end_matches('\r').to_owned()),
            None => self.unterminated.push(line.to_owned()),
        }
    }

    /// Returns the lines that contain `text`, including incomplete lines.
    fn lines_with(&self, text: &str) -> impl Iterator<Item = &String> {
        self.lines.iter().chain(&self.unterminated).filter(move |line| line.contains(text))
    }

    /// Returns all lines, each with a line feed, and then the incomplete lines without one.
    fn text(&self) -> String {
        let lines: String = self.lines.iter().flat_map(|line| [line.as_str(), "\n"]).collect();
        lines + &self.unterminated.join(" ")
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
        if std::thread::panicking() {
            #[expect(clippy::print_stderr, reason = "the log of a failed test")]
            {
                let log = self.log();
                let skipped_lines = log.lines().count().saturating_sub(PRINTED_LINES);
                let last: Vec<&str> = log.lines().skip(skipped_lines).collect();
                eprintln!("--- {} (after {skipped_lines} lines) ---\n{}", self.name, last.join("\n"));
            }
        }
    }
}

impl ProcessEnd {
    /// Returns the exit code; -1 if a signal ended the program.
    pub fn code(&self) -> i32 {
        self.status.code().unwrap_or(-1)
    }
}

/// Calls `condition` until it returns a value, and returns that value. This function is for state
/// that can only be polled, such as a REST resource.
///
/// # Panics
/// If [`TEST_TIMEOUT`] passes before.
pub fn wait_until<T>(description: &str, condition: impl FnMut() -> Option<T>) -> T {
    poll(condition)
        .unwrap_or_else(|| panic!("timeout after {TEST_TIMEOUT:?} while waiting for {description}"))
}

/// Calls `condition` until it returns a value; returns `None` if [`TEST_TIMEOUT`] passes before.
pub(crate) fn poll<T>(mut condition: impl FnMut() -> Option<T>) -> Option<T> {
    let pause = Duration::from_millis(50);
    for _ in 0..TEST_TIMEOUT.as_millis() / pause.as_millis() {
        if let Some(answer) = condition() {
            return Some(answer);
        }
        std::thread::sleep(pause);
    }
    None
}

/// Polls a number until it has reached `minimum`. The timeout starts again whenever the number has grown.
///
/// # Panics
/// If it does not grow for [`TEST_TIMEOUT`].
pub fn wait_until_grown(description: &str, minimum: u64, mut read_number: impl FnMut() -> Option<u64>) {
    let mut previous = None;
    while previous < Some(minimum) {
        let description = format!("{description}: more than {} of {minimum}", previous.unwrap_or(0));
        previous = Some(wait_until(&description, || read_number().filter(|number| Some(*number) > previous)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log_of(script: &str) -> String {
        Process::start(Path::new("sh"), &["-c", script], Path::new("/"), &[]).wait_for_end().log
    }

    #[test]
    fn log_ends_with_line_feed_unless_truncated() {
        assert_eq!(log_of(r"printf 'a\nb\n'"), "a\nb\n");
        assert_eq!(log_of(r"printf 'a\nb'"), "a\nb");
        assert_eq!(log_of("true"), "");
    }

    #[test]
    fn lines_after_invalid_utf8_are_read() {
        assert_eq!(log_of(r"printf 'a\n\377\nb\n'"), "a\n\u{fffd}\nb\n");
    }
}
