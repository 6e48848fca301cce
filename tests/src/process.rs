//! A program that a test started: its log is read as it comes, and it never outlives the test.

use std::ffi::OsStr;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Condvar, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};

use crate::PATIENCE;

/// So much of its log is shown of a program that ran when a test failed.
const LAST_LINES: usize = 200;

/// Signals that a program minds unless whoever started the tests ignored them: `nohup` does so with the first, a script's
/// `&` with the two after it, and what runs in between passes that on.
const MINDED: &str = "--default-signal=HUP,INT,QUIT,TERM";

/// A running program.
#[derive(Debug)]
pub struct Process {
    name: String,
    child: Child,
    log: Arc<Log>,
    readers: Vec<JoinHandle<()>>,
}

/// What a program left behind.
#[derive(Debug)]
pub struct Ended {
    /// How it ended.
    pub status: ExitStatus,
    /// All it wrote, standard output and standard error.
    pub log: String,
}

#[derive(Debug, Default)]
struct Log {
    lines: Mutex<(Vec<String>, usize)>,
    changed: Condvar,
}

impl Process {
    /// Starts a program in a folder with extra environment variables. It minds all signals, whatever the tests were told.
    ///
    /// # Panics
    /// When no program can be started. Of one that is not there the log says so.
    pub fn start<A: AsRef<OsStr>>(
        program: &Path,
        arguments: &[A],
        folder: &Path,
        environment: &[(&str, &str)],
    ) -> Self {
        // In the place of this one, so that signals reach the program.
        let mut child = Command::new("env")
            .arg(MINDED)
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
        let out = child.stdout.take().map(|pipe| log.clone().follow(pipe));
        let err = child.stderr.take().map(|pipe| log.clone().follow(pipe));
        let name =
            arguments.last().map_or_else(String::new, |last| last.as_ref().to_string_lossy().into_owned());
        Self { name, child, log, readers: out.into_iter().chain(err).collect() }
    }

    /// The process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// All that was written so far.
    pub fn log(&self) -> String {
        self.log.lines.lock().expect("no reader panics").0.join("\n")
    }

    /// Waits until a line holds `text`, and returns that line.
    ///
    /// # Panics
    /// When the program ends or [`PATIENCE`] passes before.
    pub fn wait_for(&self, text: &str) -> String {
        self.wait_for_nth(text, 1)
    }

    /// Waits until `n` lines hold `text`, and returns the last of them.
    ///
    /// # Panics
    /// When the program ends or [`PATIENCE`] passes before.
    pub fn wait_for_nth(&self, text: &str, n: usize) -> String {
        let guard = self.log.lines.lock().expect("no reader panics");
        let (guard, _) = self
            .log
            .changed
            .wait_timeout_while(guard, PATIENCE, |(lines, ended)| {
                lines.iter().filter(|line| line.contains(text)).count() < n && *ended < self.readers.len()
            })
            .expect("no reader panics");
        let line = guard.0.iter().filter(|line| line.contains(text)).nth(n - 1).cloned();
        // A panic that holds the lock would end the tests in the middle of another, without cleaning up.
        drop(guard);
        line.unwrap_or_else(|| {
            panic!("{} never said {text:?} ({n}. time); it said:\n{}", self.name, self.log())
        })
    }

    /// Waits until a line holds `text` or the program ends; returns which.
    ///
    /// # Panics
    /// When [`PATIENCE`] passes before.
    pub fn says(&self, text: &str) -> bool {
        let said = |lines: &[String]| lines.iter().any(|line| line.contains(text));
        let guard = self.log.lines.lock().expect("no reader panics");
        let (guard, timeout) = self
            .log
            .changed
            .wait_timeout_while(guard, PATIENCE, |(lines, ended)| !said(lines) && *ended < self.readers.len())
            .expect("no reader panics");
        let says = said(&guard.0);
        drop(guard);
        assert!(!timeout.timed_out(), "{} neither ended nor said {text:?}:\n{}", self.name, self.log());
        says
    }

    /// Sends SIGTERM.
    pub fn terminate(&self) {
        self.signal(Signal::TERM);
    }

    /// Sends SIGKILL and waits for the end.
    pub fn kill(mut self) -> Ended {
        self.signal(Signal::KILL);
        self.wait()
    }

    /// Sends SIGTERM and waits for the end.
    pub fn stop(mut self) -> Ended {
        self.terminate();
        self.wait()
    }

    /// Sends a signal.
    pub fn signal(&self, signal: Signal) {
        let pid = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw).expect("a child has a pid");
        kill_process(pid, signal).expect("the child has not been waited for");
    }

    /// Waits for the end.
    ///
    /// # Panics
    /// When it does not end within [`PATIENCE`].
    pub fn wait(&mut self) -> Ended {
        let guard = self.log.lines.lock().expect("no reader panics");
        let (guard, timeout) = self
            .log
            .changed
            .wait_timeout_while(guard, PATIENCE, |(_, ended)| *ended < self.readers.len())
            .expect("no reader panics");
        drop(guard);
        assert!(!timeout.timed_out(), "{} does not end; it said:\n{}", self.name, self.log());
        let status = self.child.wait().expect("the child is ours");
        Ended { status, log: self.log() }
    }

    /// Waits for the end, of a program that is meant to end by itself.
    pub fn ended(mut self) -> Ended {
        self.wait()
    }
}

impl Log {
    fn follow(self: Arc<Self>, pipe: impl Read + Send + 'static) -> JoinHandle<()> {
        std::thread::spawn(move || {
            for line in BufReader::new(pipe).lines().map_while(Result::ok) {
                self.lines.lock().expect("no reader panics").0.push(line);
                self.changed.notify_all();
            }
            self.lines.lock().expect("no reader panics").1 += 1;
            self.changed.notify_all();
        })
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
                let beyond = log.lines().count().saturating_sub(LAST_LINES);
                let last: Vec<&str> = log.lines().skip(beyond).collect();
                eprintln!("--- {} (after {beyond} lines) ---\n{}", self.name, last.join("\n"));
            }
        }
    }
}

impl Ended {
    /// The exit code; -1 when a signal ended it.
    pub fn code(&self) -> i32 {
        self.status.code().unwrap_or(-1)
    }
}

/// Asks `question` until it has an answer: for state that is only visible by asking, such as a REST resource.
///
/// # Panics
/// When [`PATIENCE`] passes before.
pub fn until<T>(what: &str, question: impl FnMut() -> Option<T>) -> T {
    patiently(question).unwrap_or_else(|| panic!("waited {PATIENCE:?} in vain for {what}"))
}

/// The same; `None` when [`PATIENCE`] passes before.
pub(crate) fn patiently<T>(mut question: impl FnMut() -> Option<T>) -> Option<T> {
    let pause = Duration::from_millis(50);
    for _ in 0..PATIENCE.as_millis() / pause.as_millis() {
        if let Some(answer) = question() {
            return Some(answer);
        }
        std::thread::sleep(pause);
    }
    None
}

/// Asks for a figure until it has reached `enough`, however long that takes, as long as it grows.
///
/// # Panics
/// When it has not grown for [`PATIENCE`].
pub fn until_grown(what: &str, enough: u64, mut figure: impl FnMut() -> Option<u64>) {
    let mut before = None;
    while before < Some(enough) {
        let next = format!("{what}: more of {enough} than {}", before.unwrap_or(0));
        before = Some(until(&next, || figure().filter(|now| Some(*now) > before)));
    }
}
