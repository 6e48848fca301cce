//! The pipes to and from a process; each call waits no longer than until a deadline.

use std::io::{self, IoSlice};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use bytes::Bytes;
use peernet_clock::{MonoTime, SharedClock};
use rustix::buffer::spare_capacity;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::pipe::fcntl_setpipe_size;

use super::{Fault, ProcessError};

/// Requested capacity of a pipe, bytes: the most that Linux grants to unprivileged processes (`fs.pipe-max-size`).
const PIPE_BYTES: usize = 1 << 20;
/// Bytes that are read at once while the length of the data is unknown.
const CHUNK: usize = 8 << 10;
/// Largest number of bytes that are read ahead while a request is still being written: the length of the longest answer.
const MAX_READ_AHEAD: usize = 1 << 30;
/// Largest capacity of an empty buffer, bytes: more is given back.
const MAX_IDLE_CAPACITY: usize = 4 << 20;
/// Largest number of slices in one write, well below the system's limit.
const MAX_SLICES: usize = 64;

/// Reason that a pipe cannot be used any more.
#[derive(Debug)]
pub(super) enum PipeError {
    /// The other end is closed; `None` when that is because the process is gone.
    Closed(Option<Fault>),
    TimedOut,
    TooLong(usize),
    Failed(io::Error),
}

impl From<Errno> for PipeError {
    fn from(error: Errno) -> Self {
        Self::Failed(error.into())
    }
}

impl PipeError {
    /// Converts this to the error of a process.
    ///
    /// # Errors
    /// For a closed pipe, which end was closed: only the exit status of the process tells the reason.
    pub(super) fn into_process_error(self) -> Result<ProcessError, Option<Fault>> {
        match self {
            Self::Closed(end) => Err(end),
            Self::TimedOut => Ok(ProcessError::TimedOut),
            Self::TooLong(most) => Ok(ProcessError::TooLong(most)),
            Self::Failed(error) => Ok(ProcessError::Pipe(error)),
        }
    }
}

/// Makes a pipe large and our end of it non-blocking.
pub(super) fn prepare(fd: impl AsFd) -> io::Result<()> {
    rustix::io::ioctl_fionbio(&fd, true)?;
    // A smaller pipe works as well, with more system calls.
    if let Err(error) = fcntl_setpipe_size(&fd, PIPE_BYTES) {
        tracing::debug!(%error, "a pipe stays at its usual size");
    }
    Ok(())
}

/// Deadline of a call, and the process at the other end.
#[derive(Clone, Copy)]
pub(super) struct Wait<'a> {
    pub(super) clock: &'a SharedClock,
    pub(super) until: MonoTime,
    /// Descriptor that tells when the process at the other end has ended, where the kernel has such descriptors (pidfd_open(2)).
    /// The pipe alone does not tell it: a child of the process may keep the pipe open.
    pub(super) process: Option<BorrowedFd<'a>>,
}

impl Wait<'_> {
    /// Waits until one of the pipes is ready; returns which are.
    fn ready<const N: usize>(&self, pipes: [(&OwnedFd, PollFlags); N]) -> Result<[bool; N], PipeError> {
        let mut watched: Vec<_> = pipes.iter().map(|(fd, what)| PollFd::new(*fd, *what)).collect();
        watched.extend(self.process.map(|process| PollFd::from_borrowed_fd(process, PollFlags::IN)));
        self.poll(&mut watched)?;
        if watched[..N].iter().all(|pipe| pipe.revents().is_empty()) {
            // The process is gone; what it wrote just before is in its pipe by now.
            poll(&mut watched[..N], Some(&Timespec::default()))?;
        }
        let ready = std::array::from_fn(|at| !watched[at].revents().is_empty());
        if ready.contains(&true) { Ok(ready) } else { Err(PipeError::Closed(None)) }
    }

    /// Waits until one of the descriptors is ready.
    fn poll(&self, watched: &mut [PollFd<'_>]) -> Result<(), PipeError> {
        loop {
            let left = (self.until - self.clock.mono()).to_duration();
            let timeout =
                Timespec { tv_sec: left.as_secs().cast_signed(), tv_nsec: left.subsec_nanos().into() };
            match poll(watched, Some(&timeout)) {
                Ok(0) if self.until <= self.clock.mono() => return Err(PipeError::TimedOut),
                Ok(0) | Err(Errno::INTR) => {}
                Ok(_) => return Ok(()),
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Waits for the end of the process. Returns `false` if it still runs at the deadline, or if the kernel cannot tell.
    pub(super) fn wait_for_exit(&self) -> bool {
        let over = |process| self.poll(&mut [PollFd::from_borrowed_fd(process, PollFlags::IN)]).is_ok();
        self.process.is_some_and(over)
    }
}

/// Writes all parts, one after the other, and reads what the process writes meanwhile: otherwise both would wait for each
/// other when the process answers before it has read everything.
pub(super) fn write(
    fd: &OwnedFd,
    parts: &[&[u8]],
    answers: &mut Reader,
    wait: Wait<'_>,
) -> Result<(), PipeError> {
    let mut slices: Vec<IoSlice<'_>> = parts.iter().map(|part| IoSlice::new(part)).collect();
    let mut left = slices.as_mut_slice();
    IoSlice::advance_slices(&mut left, 0);
    while !left.is_empty() {
        match rustix::io::writev(fd, &left[..left.len().min(MAX_SLICES)]) {
            Ok(written) => IoSlice::advance_slices(&mut left, written),
            Err(Errno::INTR) => {}
            Err(Errno::AGAIN) => wait_to_write(fd, answers, wait)?,
            Err(Errno::PIPE) => return Err(PipeError::Closed(Some(Fault::ClosedInput))),
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

/// Waits until the pipe takes more, and reads what the process writes meanwhile.
fn wait_to_write(fd: &OwnedFd, answers: &mut Reader, wait: Wait<'_>) -> Result<(), PipeError> {
    let room = (fd, PollFlags::OUT);
    if answers.is_full() {
        return wait.ready([room]).map(drop);
    }
    let [_, answered] = wait.ready([room, (&answers.fd, PollFlags::IN)])?;
    if answered { answers.read_more(wait) } else { Ok(()) }
}

/// The end of a pipe that is read, with a buffer for what was read ahead.
#[derive(Debug)]
pub(super) struct Reader {
    pub(super) fd: OwnedFd,
    buffer: Vec<u8>,
    /// Number of bytes of `buffer` that were returned already.
    taken: usize,
}

impl Reader {
    pub(super) fn new(fd: OwnedFd) -> Self {
        Self { fd, buffer: Vec::with_capacity(CHUNK), taken: 0 }
    }

    /// Returns whether the limit of read-ahead is reached.
    fn is_full(&self) -> bool {
        self.buffered().len() >= MAX_READ_AHEAD
    }

    /// Returns the bytes that were read and not returned yet.
    fn buffered(&self) -> &[u8] {
        &self.buffer[self.taken..]
    }

    /// Returns whether a byte can be read without waiting.
    pub(super) fn has_more(&self) -> bool {
        let nothing = Timespec { tv_sec: 0, tv_nsec: 0 };
        let mut fds = [PollFd::from_borrowed_fd(self.fd.as_fd(), PollFlags::IN)];
        let polled = self.buffered().is_empty().then(|| poll(&mut fds, Some(&nothing)));
        // A closed pipe holds nothing; the next write or read returns the error.
        polled.is_none_or(|polled| polled.is_ok() && fds[0].revents().contains(PollFlags::IN))
    }

    /// Reads once into the spare capacity of a vector; waits until there is something to read.
    fn read_into(fd: &OwnedFd, into: &mut Vec<u8>, wait: Wait<'_>) -> Result<(), PipeError> {
        loop {
            match rustix::io::read(fd, spare_capacity(into)) {
                Ok(0) => return Err(PipeError::Closed(Some(Fault::ClosedOutput))),
                Ok(_) => return Ok(()),
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => drop(wait.ready([(fd, PollFlags::IN)])?),
                Err(error) => return Err(error.into()),
            }
        }
    }

    fn read_more(&mut self, wait: Wait<'_>) -> Result<(), PipeError> {
        if self.taken == self.buffer.len() {
            self.buffer.clear();
            self.buffer.shrink_to(MAX_IDLE_CAPACITY);
            self.taken = 0;
        } else if self.buffer.len() == self.buffer.capacity() {
            self.buffer.drain(..self.taken);
            self.taken = 0;
        }
        if self.buffer.len() == self.buffer.capacity() {
            self.buffer.reserve(CHUNK);
        }
        Self::read_into(&self.fd, &mut self.buffer, wait)
    }

    /// Returns what the process has written of its next line, without waiting for more.
    pub(super) fn peek_line(&mut self, wait: Wait<'_>) -> &[u8] {
        if self.buffered().is_empty() {
            // After an error the line is empty; the next read returns the error.
            let _ = self.read_more(wait);
        }
        self.buffered().split(|byte| *byte == b'\n').next().unwrap_or_default()
    }

    /// Reads exactly `length` bytes.
    pub(super) fn read_exact(&mut self, length: usize, wait: Wait<'_>) -> Result<Bytes, PipeError> {
        let mut bytes = Vec::with_capacity(length);
        let early = self.buffered().len().min(length);
        bytes.extend_from_slice(&self.buffered()[..early]);
        self.taken += early;
        while bytes.len() < length {
            // A short rest is read together with what follows it, which saves a system call.
            if length - bytes.len() < CHUNK {
                self.read_more(wait)?;
                let more = self.buffered().len().min(length - bytes.len());
                bytes.extend_from_slice(&self.buffered()[..more]);
                self.taken += more;
            } else {
                Self::read_into(&self.fd, &mut bytes, wait)?;
            }
        }
        Ok(bytes.into())
    }

    /// Reads the bytes up to the next `end`, without it; at most `most`.
    pub(super) fn read_until(&mut self, end: u8, most: usize, wait: Wait<'_>) -> Result<Bytes, PipeError> {
        let mut searched = 0;
        loop {
            if let Some(at) = self.buffered()[searched..].iter().position(|byte| *byte == end) {
                let length = searched + at;
                let bytes = Bytes::copy_from_slice(&self.buffered()[..length]);
                self.taken += length + 1;
                return if length > most { Err(PipeError::TooLong(most)) } else { Ok(bytes) };
            }
            searched = self.buffered().len();
            if searched > most {
                return Err(PipeError::TooLong(most));
            }
            self.read_more(wait)?;
        }
    }
}
