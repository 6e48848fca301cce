//! A process that runs.

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::process::{Child, ExitStatus};
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::{MonoTime, SharedClock, Span};
use rustix::process::{Pid, PidfdFlags, Signal, kill_process_group, pidfd_open};

use super::pipe::{self, Broken, Reader, Wait};
use super::voice::Listening;
use super::{Ended, Launch, ProcessError, spawner};

/// How long a process that closed a pipe is given to end by itself, so that it can be said how.
const DYING: Span = Span::from_millis(1000);
/// How long its last words are waited for once it is gone.
const LAST_WORDS: Duration = Duration::from_millis(200);

/// A process, its pipes, and the thread that listens to its standard error. Dropping it kills it and its group.
#[derive(Debug)]
pub struct Process {
    child: Child,
    group: Option<Pid>,
    /// Tells when it is gone; a kernel before 5.3 has none.
    pidfd: Option<OwnedFd>,
    /// `None` once it has been told that nothing more will come.
    input: Option<OwnedFd>,
    output: Reader,
    voice: Listening,
    clock: SharedClock,
    status: Option<ExitStatus>,
}

impl Process {
    /// Starts it.
    ///
    /// # Errors
    /// [`ProcessError::Start`] when the program is not there or cannot be run.
    pub fn start(launch: &Launch, clock: &SharedClock) -> Result<Self, ProcessError> {
        let failed = |error| ProcessError::Start { program: launch.describe(), error };
        let mut child = spawner::spawn(launch.command()).map_err(failed)?;
        let missing = || failed(io::Error::other("it came without its pipes"));
        let input = OwnedFd::from(child.stdin.take().ok_or_else(missing)?);
        let output = OwnedFd::from(child.stdout.take().ok_or_else(missing)?);
        let stderr = child.stderr.take().ok_or_else(missing)?;
        let prepared = pipe::prepare(&input)
            .and_then(|()| pipe::prepare(&output))
            .and_then(|()| Listening::begin(stderr, launch.voice, launch.name.clone()));
        let group = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
        match prepared {
            Ok(voice) => Ok(Self {
                child,
                pidfd: group.and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok()),
                group,
                input: Some(input),
                output: Reader::new(output),
                voice,
                clock: SharedClock::clone(clock),
                status: None,
            }),
            Err(error) => {
                kill(group);
                // It was killed: what its status is tells nothing more.
                let _ = child.wait();
                Err(failed(error))
            }
        }
    }

    /// Its number.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Writes all parts to its standard input, without copying them together.
    ///
    /// # Errors
    /// When it has ended, or does not take it all until the given moment; then nothing more can be said to it.
    pub fn write(&mut self, parts: &[&[u8]], until: MonoTime) -> Result<(), ProcessError> {
        let result = match &self.input {
            Some(input) => {
                let wait = waiting(&self.clock, self.pidfd.as_ref(), until);
                pipe::write(input, parts, &mut self.output, wait)
            }
            None => Err(Broken::Closed),
        };
        result.map_err(|broken| self.explain(broken))
    }

    /// Closes its standard input: tells it that nothing more will come.
    pub fn close_input(&mut self) {
        self.input = None;
    }

    /// Exactly `length` bytes from its standard output.
    ///
    /// # Errors
    /// When it has ended, or does not send it all until the given moment.
    pub fn read_exact(&mut self, length: usize, until: MonoTime) -> Result<Bytes, ProcessError> {
        let wait = waiting(&self.clock, self.pidfd.as_ref(), until);
        self.output.exact(length, wait).map_err(|broken| self.explain(broken))
    }

    /// The next line of its standard output without its end, of at most `most` bytes.
    ///
    /// # Errors
    /// When it has ended, sends a longer line, or none until the given moment.
    pub fn read_line(&mut self, most: usize, until: MonoTime) -> Result<Bytes, ProcessError> {
        let wait = waiting(&self.clock, self.pidfd.as_ref(), until);
        self.output.until(b'\n', most, wait).map_err(|broken| self.explain(broken))
    }

    /// Whether it has written something that nobody has read yet.
    pub fn has_more(&self) -> bool {
        self.output.holds_something()
    }

    /// Ends it: closes its input, asks after half the grace (SIGTERM) and kills it with its group when that is over.
    /// Blocks no longer than that.
    pub fn end(mut self, grace: Span) -> Ended {
        self.input = None;
        let half = Span::from_nanos(grace.nanos() / 2);
        if !self.ends_within(half) {
            if let Some(group) = self.group {
                // It may have gone in between.
                let _ = kill_process_group(group, Signal::TERM);
            }
            self.ends_within(half);
        }
        self.reap();
        self.ended()
    }

    /// What a broken pipe means: asks a process that closed it how it ended.
    fn explain(&mut self, broken: Broken) -> ProcessError {
        broken.known().unwrap_or_else(|| {
            self.input = None;
            self.ends_within(DYING);
            self.reap();
            ProcessError::Ended(self.ended())
        })
    }

    fn ended(&self) -> Ended {
        Ended { status: self.status, last_lines: self.voice.last_lines(LAST_WORDS) }
    }

    /// Waits for its end without taking its status. Where the kernel cannot tell, it gets no grace.
    fn ends_within(&self, patience: Span) -> bool {
        let until = self.clock.mono() + patience;
        self.status.is_some() || waiting(&self.clock, self.pidfd.as_ref(), until).is_over()
    }

    /// Kills what is left of the group, then takes the status: in this order, because the number is free afterwards.
    fn reap(&mut self) {
        if self.status.is_none() {
            kill(self.group);
            self.status = self.child.wait().ok();
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.reap();
    }
}

fn waiting<'a>(clock: &'a SharedClock, pidfd: Option<&'a OwnedFd>, until: MonoTime) -> Wait<'a> {
    Wait { clock, until, process: pidfd.map(AsFd::as_fd) }
}

fn kill(group: Option<Pid>) {
    if let Some(group) = group {
        // It may be gone already.
        let _ = kill_process_group(group, Signal::KILL);
    }
}
