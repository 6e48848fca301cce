//! A process that runs.

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::{MonoTime, SharedClock, Span};
use rustix::process::{PidfdFlags, Signal, pidfd_open};

use super::group::Group;
use super::pipe::{self, Broken, Reader, Wait};
use super::voice::Listening;
use super::{Ended, Killed, Launch, ProcessError};

/// How long a process that closed a pipe is given to end by itself, so that it can be said how.
const DYING: Span = Span::from_millis(1000);
/// How long its last words are waited for once it is gone.
const LAST_WORDS: Duration = Duration::from_millis(200);

/// A process, its pipes, and the thread that listens to its standard error. Dropping it kills it and its group.
#[derive(Debug)]
pub struct Process {
    group: Group,
    /// Tells when it is gone; a kernel before 5.3 has none.
    pidfd: Option<OwnedFd>,
    /// `None` once it has been told that nothing more will come.
    input: Option<OwnedFd>,
    output: Reader,
    voice: Listening,
    clock: SharedClock,
    status: Option<ExitStatus>,
    killed: Option<Killed>,
}

impl Process {
    /// Starts it.
    ///
    /// # Errors
    /// [`ProcessError::Start`] when the program is not there or cannot be run.
    pub fn start(launch: &Launch, clock: &SharedClock) -> Result<Self, ProcessError> {
        let failed = |error| ProcessError::Start { program: launch.describe(), error };
        let mut group = Group::start(launch.command()).map_err(failed)?;
        let pipes = Self::pipes(&mut group, launch).inspect_err(|_| {
            // It was killed: what its status is tells nothing more.
            let _ = group.finish();
        });
        let (input, output, voice) = pipes.map_err(failed)?;
        Ok(Self {
            pidfd: group.pid().and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok()),
            group,
            input: Some(input),
            output: Reader::new(output),
            voice,
            clock: SharedClock::clone(clock),
            status: None,
            killed: None,
        })
    }

    /// Its two pipes, and the thread at the third.
    fn pipes(group: &mut Group, launch: &Launch) -> io::Result<(OwnedFd, OwnedFd, Listening)> {
        let missing = || io::Error::other("it came without its pipes");
        let child = group.leader();
        let input = OwnedFd::from(child.stdin.take().ok_or_else(missing)?);
        let output = OwnedFd::from(child.stdout.take().ok_or_else(missing)?);
        let stderr = child.stderr.take().ok_or_else(missing)?;
        pipe::prepare(&input)?;
        pipe::prepare(&output)?;
        let voice = Listening::begin(stderr, launch.voice, launch.name.clone())?;
        Ok((input, output, voice))
    }

    /// Its number.
    pub fn pid(&self) -> u32 {
        self.group.id()
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
            None => Err(Broken::Closed(None)),
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
            self.group.terminate();
            self.ends_within(half);
        }
        self.reap(Some(Killed::Stayed));
        self.ended()
    }

    /// What a broken pipe means: asks a process that closed it how it ended.
    fn explain(&mut self, broken: Broken) -> ProcessError {
        broken.known().unwrap_or_else(|closed| {
            self.input = None;
            self.ends_within(DYING);
            self.reap(closed);
            ProcessError::Ended(self.ended())
        })
    }

    fn ended(&self) -> Ended {
        Ended { status: self.status, killed: self.killed, last_lines: self.voice.last_lines(LAST_WORDS) }
    }

    /// Waits for its end without taking its status. Where the kernel cannot tell, it gets no grace.
    fn ends_within(&self, patience: Span) -> bool {
        let until = self.clock.mono() + patience;
        self.status.is_some() || waiting(&self.clock, self.pidfd.as_ref(), until).is_over()
    }

    /// Kills what is left of it and its group; `why` is told where it was still there.
    fn reap(&mut self, why: Option<Killed>) {
        if self.status.is_none() {
            let ended = self.ends_within(Span::ZERO);
            self.status = self.group.finish();
            let by_kill = self.status.is_some_and(|status| status.signal() == Some(Signal::KILL.as_raw()));
            self.killed = why.filter(|_| !ended && by_kill);
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.reap(None);
    }
}

fn waiting<'a>(clock: &'a SharedClock, pidfd: Option<&'a OwnedFd>, until: MonoTime) -> Wait<'a> {
    Wait { clock, until, process: pidfd.map(AsFd::as_fd) }
}
