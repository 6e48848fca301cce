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
use super::pipe::{self, PipeError, Reader, Wait};
use super::voice::Listening;
use super::{Ended, Fault, Launch, ProcessError};

/// How long before its end a process that ends by itself has closed its pipes, at most.
const GOING: Span = Span::from_millis(200);
/// How long one that closed a pipe and goes on is given to end by itself, so that it can be said how.
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
    fault: Option<Fault>,
    killed: bool,
    asked: bool,
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
            fault: None,
            killed: false,
            asked: false,
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
            None => Err(PipeError::Closed(None)),
        };
        result.map_err(|error| self.explain(error))
    }

    /// Exactly `length` bytes from its standard output.
    ///
    /// # Errors
    /// When it has ended, or does not send it all until the given moment.
    pub fn read_exact(&mut self, length: usize, until: MonoTime) -> Result<Bytes, ProcessError> {
        let wait = waiting(&self.clock, self.pidfd.as_ref(), until);
        self.output.read_exact(length, wait).map_err(|error| self.explain(error))
    }

    /// The next line of its standard output without its end, of at most `most` bytes.
    ///
    /// # Errors
    /// When it has ended, sends a longer line, or none until the given moment.
    pub fn read_line(&mut self, most: usize, until: MonoTime) -> Result<Bytes, ProcessError> {
        let wait = waiting(&self.clock, self.pidfd.as_ref(), until);
        self.output.read_until(b'\n', most, wait).map_err(|error| self.explain(error))
    }

    /// Whether it has written something that nobody has read yet.
    pub fn has_more(&self) -> bool {
        self.output.has_more()
    }

    /// Returns what the process has written of its next line, without waiting for more: for messages.
    pub fn peek_line(&mut self) -> String {
        let wait = waiting(&self.clock, self.pidfd.as_ref(), self.clock.mono());
        String::from_utf8_lossy(self.output.peek_line(wait)).into_owned()
    }

    /// Kills it and its group.
    pub fn kill(mut self) -> Ended {
        self.reap(None);
        self.ended()
    }

    /// Ends it: closes its input, asks after half the grace (SIGTERM) and kills it with its group when that is over.
    /// Blocks no longer than that.
    pub fn end(mut self, grace: Span) -> Ended {
        self.input = None;
        let half = Span::from_nanos(grace.nanos() / 2);
        if !self.ends_within(half) {
            self.asked = true;
            self.group.terminate();
            self.ends_within(half);
        }
        self.reap(Some(Fault::Stayed));
        self.ended()
    }

    /// Converts the error of a pipe to that of the process; waits for the exit status of a process that closed its end.
    fn explain(&mut self, error: PipeError) -> ProcessError {
        error.into_process_error().unwrap_or_else(|fault| {
            // One that ends closes its pipes as well: that is worth telling only of one that goes on.
            let goes_on = !self.ends_within(GOING);
            self.input = None;
            if goes_on {
                self.ends_within(DYING);
            }
            self.reap(fault.filter(|_| goes_on));
            ProcessError::Ended(self.ended())
        })
    }

    fn ended(&self) -> Ended {
        let last_lines = self.voice.last_lines(LAST_WORDS);
        Ended { status: self.status, fault: self.fault, killed: self.killed, asked: self.asked, last_lines }
    }

    /// Waits for its end without taking its status. Where the kernel cannot tell, it gets no grace.
    fn ends_within(&self, patience: Span) -> bool {
        let until = self.clock.mono() + patience;
        self.status.is_some() || waiting(&self.clock, self.pidfd.as_ref(), until).wait_for_exit()
    }

    /// Kills what is left of it and its group; `fault` is what it did before.
    fn reap(&mut self, fault: Option<Fault>) {
        if self.status.is_none() {
            let ended = self.ends_within(Span::ZERO);
            self.status = self.group.finish();
            let by_kill = self.status.is_some_and(|status| status.signal() == Some(Signal::KILL.as_raw()));
            self.killed = !ended && by_kill;
            self.fault = fault.filter(|fault| self.killed || *fault != Fault::Stayed);
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
