//! A running process.

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;
use std::thread;
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::{MonoTime, SharedClock, Span};
use rustix::process::{PidfdFlags, Signal, pidfd_open};

use super::group::Group;
use super::pipe::{self, PipeError, Reader, Wait};
use super::stderr_log::StderrReader;
use super::{Fault, Launch, ProcessEnd, ProcessError};

/// Longest time between the closing of the pipes and the end of a process that is exiting.
const PIPE_CLOSE_BEFORE_EXIT: Span = Span::from_millis(200);
/// Time for a running process that closed a pipe to end by itself, so that its exit status can be reported.
const EXIT_AFTER_PIPE_CLOSE: Span = Span::from_millis(1000);
/// Time between two queries whether a process has ended, if the kernel has no pidfd.
const EXIT_QUERY_INTERVAL: Duration = Duration::from_millis(5);
/// Longest wait for the rest of the standard error after the end of a process.
const LAST_OUTPUT_TIMEOUT: Duration = Duration::from_millis(200);

/// A process, its pipes, and the thread that reads its standard error. Dropping it kills the process and its group.
#[derive(Debug)]
pub struct Process {
    group: Group,
    /// Descriptor that becomes readable when the process ends (pidfd_open(2)); kernels before 5.3 have none.
    pidfd: Option<OwnedFd>,
    /// Write end of its standard input; `None` once it is closed.
    input: Option<OwnedFd>,
    output: Reader,
    stderr_log: StderrReader,
    clock: SharedClock,
    status: Option<ExitStatus>,
    fault: Option<Fault>,
    was_killed: bool,
    termination_requested: bool,
}

impl Process {
    /// Starts a process.
    ///
    /// # Errors
    /// [`ProcessError::Start`] if the program does not exist or cannot be run.
    pub fn start(launch: &Launch, clock: &SharedClock) -> Result<Self, ProcessError> {
        let start_error = |error| ProcessError::Start { program: launch.describe(), error };
        let mut group = Group::start(launch.command()).map_err(start_error)?;
        let pipes = Self::take_pipes(&mut group, launch, clock).inspect_err(|_| {
            // `finish` kills the process, so the status that it returns means nothing.
            let _ = group.finish();
        });
        let (input, output, stderr_log) = pipes.map_err(start_error)?;
        Ok(Self {
            pidfd: group.pid().and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok()),
            group,
            input: Some(input),
            output: Reader::new(output),
            stderr_log,
            clock: SharedClock::clone(clock),
            status: None,
            fault: None,
            was_killed: false,
            termination_requested: false,
        })
    }

    /// Returns the pipes of the standard input and output, and starts the thread that reads the standard error.
    fn take_pipes(
        group: &mut Group,
        launch: &Launch,
        clock: &SharedClock,
    ) -> io::Result<(OwnedFd, OwnedFd, StderrReader)> {
        let missing = || io::Error::other("the started process has no pipes");
        let child = group.leader();
        let input = OwnedFd::from(child.stdin.take().ok_or_else(missing)?);
        let output = OwnedFd::from(child.stdout.take().ok_or_else(missing)?);
        let stderr = child.stderr.take().ok_or_else(missing)?;
        pipe::prepare(&input)?;
        pipe::prepare(&output)?;
        let stderr_log = StderrReader::start(stderr, launch.stderr_log, launch.name.clone(), clock.clone())?;
        Ok((input, output, stderr_log))
    }

    /// Writes all pieces to the standard input of the process, without joining the pieces in one buffer.
    ///
    /// # Errors
    /// If the process has ended, or does not read everything before the deadline. No write succeeds after such
    /// an error.
    pub fn write(&mut self, pieces: &[&[u8]], deadline: MonoTime) -> Result<(), ProcessError> {
        let result = match &self.input {
            Some(input) => {
                let wait = wait_until(&self.clock, self.pidfd.as_ref(), deadline);
                pipe::write(input, pieces, &mut self.output, wait)
            }
            None => Err(PipeError::Closed(None)),
        };
        result.map_err(|error| self.convert_pipe_error(error))
    }

    /// Reads exactly `length` bytes from its standard output.
    ///
    /// # Errors
    /// If the process has ended, or does not send all bytes before the deadline.
    pub fn read_exact(&mut self, length: usize, deadline: MonoTime) -> Result<Bytes, ProcessError> {
        let wait = wait_until(&self.clock, self.pidfd.as_ref(), deadline);
        self.output.read_exact(length, wait).map_err(|error| self.convert_pipe_error(error))
    }

    /// Returns the number of bytes that the last [`read_exact`](Self::read_exact) received, also if it failed.
    pub const fn received_bytes(&self) -> usize {
        self.output.received_bytes()
    }

    /// Reads the next line of the standard output, without the line feed. The line has at most `max_length` bytes.
    ///
    /// # Errors
    /// If the process has ended, sends a longer line, or sends no whole line before the deadline.
    pub fn read_line(&mut self, max_length: usize, deadline: MonoTime) -> Result<Bytes, ProcessError> {
        let wait = wait_until(&self.clock, self.pidfd.as_ref(), deadline);
        self.output.read_until(b'\n', max_length, wait).map_err(|error| self.convert_pipe_error(error))
    }

    /// Waits until there is output that was not read yet.
    ///
    /// # Errors
    /// If the process has ended, or writes nothing before the deadline.
    pub fn wait_for_output(&mut self, deadline: MonoTime) -> Result<(), ProcessError> {
        let wait = wait_until(&self.clock, self.pidfd.as_ref(), deadline);
        self.output.wait_for_output(wait).map_err(|error| self.convert_pipe_error(error))
    }

    /// Returns whether there is output that was not read yet.
    pub fn has_unread_output(&self) -> bool {
        self.output.has_unread_output()
    }

    /// Returns what the process has written of its next line so far, without waiting. For messages only.
    pub fn peek_line(&mut self) -> String {
        let wait = wait_until(&self.clock, self.pidfd.as_ref(), self.clock.mono());
        String::from_utf8_lossy(self.output.peek_line(wait)).into_owned()
    }

    /// Kills the process and its group.
    pub fn kill(mut self) -> ProcessEnd {
        self.reap(None);
        self.process_end()
    }

    /// Ends the process: closes its standard input, sends SIGTERM after half of `grace`, and kills the group when
    /// `grace` has passed. Blocks no longer than `grace`.
    pub fn end(mut self, grace: Span) -> ProcessEnd {
        self.input = None;
        let half = Span::from_nanos(grace.nanos() / 2);
        if !self.exits_within(half) {
            self.termination_requested = true;
            self.group.terminate();
            self.exits_within(half);
        }
        // `reap` discards this fault if the process has ended in time.
        self.reap(Some(Fault::IgnoredTermination));
        self.process_end()
    }

    /// Converts the error of a pipe to an error of the process; waits for the exit status of a process that closed its
    /// end of the pipe.
    fn convert_pipe_error(&mut self, error: PipeError) -> ProcessError {
        error.into_process_error().unwrap_or_else(|fault| {
            // A process that ends closes its pipes as well. A closed pipe is a fault only of a process that still
            // runs.
            let is_running = !self.exits_within(PIPE_CLOSE_BEFORE_EXIT);
            self.input = None;
            if is_running {
                self.exits_within(EXIT_AFTER_PIPE_CLOSE);
            }
            self.reap(fault.filter(|_| is_running));
            ProcessError::ProcessEnd(self.process_end())
        })
    }

    /// Returns the end of the process, with the last lines of its standard error.
    fn process_end(&self) -> ProcessEnd {
        let last_lines = self.stderr_log.last_lines(LAST_OUTPUT_TIMEOUT);
        ProcessEnd {
            status: self.status,
            fault: self.fault,
            was_killed: self.was_killed,
            termination_requested: self.termination_requested,
            last_lines,
        }
    }

    /// Waits for the end of the process without collecting its status. Returns whether the process has ended.
    fn exits_within(&self, timeout: Span) -> bool {
        if self.status.is_some() {
            return true;
        }
        let deadline = self.clock.mono() + timeout;
        if self.pidfd.is_some() {
            return wait_until(&self.clock, self.pidfd.as_ref(), deadline).wait_for_exit();
        }
        while !self.group.leader_has_ended() {
            if deadline <= self.clock.mono() {
                return false;
            }
            thread::sleep(EXIT_QUERY_INTERVAL);
        }
        true
    }

    /// Kills the process and its group, and collects the exit status. `fault` is the preceding misbehaviour of the
    /// process, if any.
    fn reap(&mut self, fault: Option<Fault>) {
        if self.status.is_none() {
            // `has_ended` is queried before the group is killed. If the process had ended by then, a SIGKILL in its
            // status came from another sender, such as the system when memory runs out.
            let has_ended = self.exits_within(Span::ZERO);
            self.status = self.group.finish();
            let by_kill = self.status.is_some_and(|status| status.signal() == Some(Signal::KILL.as_raw()));
            self.was_killed = !has_ended && by_kill;
            // A process that ended before it was killed has not ignored SIGTERM.
            self.fault = fault.filter(|fault| self.was_killed || *fault != Fault::IgnoredTermination);
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.reap(None);
    }
}

fn wait_until<'a>(clock: &'a SharedClock, pidfd: Option<&'a OwnedFd>, deadline: MonoTime) -> Wait<'a> {
    Wait { clock, deadline, pidfd: pidfd.map(AsFd::as_fd) }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, SystemClock};

    use super::super::StderrLog;
    use super::*;

    #[test]
    fn process_without_pidfd_has_time_to_end() {
        let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "test")));
        let launch = Launch {
            name: "the program of a test".to_owned(),
            stderr_log: StderrLog::Exec,
            program: "sh".into(),
            arguments: vec!["-c".into(), "read -r _; sleep 0.2; exit 3".into()],
            folder: None,
            environment: [].into(),
            inherited_file: None,
        };
        let mut process = Process::start(&launch, &clock).expect("sh is there");
        process.pidfd = None;
        let end = process.end(Span::from_millis(60_000));
        assert_eq!(end.status.and_then(|status| status.code()), Some(3), "{end}");
        assert!(!end.was_killed && !end.termination_requested, "{end}");
    }
}
