//! The pipes to and from a process; each call waits until a deadline at most.

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
/// Number of bytes of one read while the length of the data is unknown.
const READ_CHUNK_BYTES: usize = 8 << 10;
/// Maximum number of bytes that are read ahead while a request is still being written: the length of the longest
/// answer.
const MAX_READ_AHEAD_BYTES: usize = 1 << 30;
/// Largest capacity of an empty buffer. Memory beyond it is freed.
const MAX_IDLE_CAPACITY_BYTES: usize = 4 << 20;
/// Maximum number of slices in one write, well below the system's limit.
const MAX_SLICES_PER_WRITE: usize = 64;

/// Reason that a pipe cannot be used any more.
#[derive(Debug)]
pub(super) enum PipeError {
    /// The process closed its end of the pipe, which is a fault; `None` if the process has ended.
    Closed(Option<Fault>),
    TimedOut,
    LineTooLong(usize),
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
    /// If the pipe is closed, returns the fault in [`Closed`](Self::Closed). The caller then waits for the exit status,
    /// and makes the error from the end of the process.
    pub(super) fn into_process_error(self) -> Result<ProcessError, Option<Fault>> {
        match self {
            Self::Closed(fault) => Err(fault),
            Self::TimedOut => Ok(ProcessError::TimedOut),
            Self::LineTooLong(limit) => Ok(ProcessError::LineTooLong(limit)),
            Self::Failed(error) => Ok(ProcessError::Pipe(error)),
        }
    }
}

/// Makes a pipe large and our end of it non-blocking.
pub(super) fn prepare(fd: impl AsFd) -> io::Result<()> {
    rustix::io::ioctl_fionbio(&fd, true)?;
    // A smaller pipe works as well, with more system calls.
    if let Err(error) = fcntl_setpipe_size(&fd, PIPE_BYTES) {
        tracing::debug!(%error, "cannot enlarge a pipe; it keeps its default size");
    }
    Ok(())
}

/// Limits of a wait: the deadline of the call, and the exit of the process that uses the pipe.
#[derive(Clone, Copy)]
pub(super) struct Wait<'a> {
    pub(super) clock: &'a SharedClock,
    pub(super) deadline: MonoTime,
    /// Descriptor that becomes readable when the process ends (pidfd_open(2)), if the kernel supports it.
    // The pipe alone does not show the end of the process, because a child of the process may keep the pipe open.
    pub(super) pidfd: Option<BorrowedFd<'a>>,
}

impl Wait<'_> {
    /// Waits until one of the pipes is ready. Returns for each pipe whether it is ready.
    fn until_ready<const N: usize>(&self, pipes: [(&OwnedFd, PollFlags); N]) -> Result<[bool; N], PipeError> {
        let mut poll_fds: Vec<_> = pipes.iter().map(|(fd, events)| PollFd::new(*fd, *events)).collect();
        poll_fds.extend(self.pidfd.map(|pidfd| PollFd::from_borrowed_fd(pidfd, PollFlags::IN)));
        self.poll(&mut poll_fds)?;
        if poll_fds[..N].iter().all(|pipe| pipe.revents().is_empty()) {
            // Only the pidfd is ready, so the process has ended. Its last output is in the pipe by now.
            poll(&mut poll_fds[..N], Some(&Timespec::default()))?;
        }
        let ready = std::array::from_fn(|index| !poll_fds[index].revents().is_empty());
        if ready.contains(&true) { Ok(ready) } else { Err(PipeError::Closed(None)) }
    }

    /// Waits until one of the descriptors is ready.
    fn poll(&self, poll_fds: &mut [PollFd<'_>]) -> Result<(), PipeError> {
        loop {
            let remaining = (self.deadline - self.clock.mono()).to_duration();
            let timeout = Timespec {
                tv_sec: remaining.as_secs().cast_signed(),
                tv_nsec: remaining.subsec_nanos().into(),
            };
            match poll(poll_fds, Some(&timeout)) {
                Ok(0) if self.deadline <= self.clock.mono() => return Err(PipeError::TimedOut),
                Ok(0) | Err(Errno::INTR) => {}
                Ok(_) => return Ok(()),
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Waits for the end of the process. Returns `false` if the process still runs at the deadline, or if the kernel
    /// has no pidfd.
    pub(super) fn wait_for_exit(&self) -> bool {
        let has_ended = |pidfd| self.poll(&mut [PollFd::from_borrowed_fd(pidfd, PollFlags::IN)]).is_ok();
        self.pidfd.is_some_and(has_ended)
    }
}

/// Writes all pieces in order, and at the same time reads what the process writes.
// If this function only wrote, both sides would wait for each other when the process answers before it has read
// everything.
pub(super) fn write(
    fd: &OwnedFd,
    pieces: &[&[u8]],
    output: &mut Reader,
    wait: Wait<'_>,
) -> Result<(), PipeError> {
    let mut slices: Vec<IoSlice<'_>> = pieces.iter().map(|piece| IoSlice::new(piece)).collect();
    let mut remaining = slices.as_mut_slice();
    // Removes empty pieces at the beginning: if all pieces are empty, nothing is written.
    IoSlice::advance_slices(&mut remaining, 0);
    while !remaining.is_empty() {
        match rustix::io::writev(fd, &remaining[..remaining.len().min(MAX_SLICES_PER_WRITE)]) {
            Ok(written) => IoSlice::advance_slices(&mut remaining, written),
            Err(Errno::INTR) => {}
            Err(Errno::AGAIN) => wait_to_write(fd, output, wait)?,
            Err(Errno::PIPE) => return Err(PipeError::Closed(Some(Fault::ClosedInput))),
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

/// Waits until the pipe accepts more bytes, and at the same time reads what the process writes.
fn wait_to_write(fd: &OwnedFd, output: &mut Reader, wait: Wait<'_>) -> Result<(), PipeError> {
    let writable = (fd, PollFlags::OUT);
    if output.is_full() {
        return wait.until_ready([writable]).map(drop);
    }
    let [_, has_output] = wait.until_ready([writable, (&output.fd, PollFlags::IN)])?;
    if has_output { output.read_more(wait) } else { Ok(()) }
}

/// Read end of a pipe, with a buffer for bytes that were read ahead.
#[derive(Debug)]
pub(super) struct Reader {
    pub(super) fd: OwnedFd,
    buffer: Vec<u8>,
    /// Number of bytes of `buffer` that were returned already.
    consumed: usize,
    /// Number of bytes that the last `read_exact` received.
    received_bytes: usize,
}

impl Reader {
    pub(super) fn new(fd: OwnedFd) -> Self {
        Self { fd, buffer: Vec::with_capacity(READ_CHUNK_BYTES), consumed: 0, received_bytes: 0 }
    }

    /// Returns whether the buffer holds as many bytes as may be read ahead.
    fn is_full(&self) -> bool {
        self.buffered_bytes().len() >= MAX_READ_AHEAD_BYTES
    }

    /// Returns the bytes that were read and not returned yet.
    fn buffered_bytes(&self) -> &[u8] {
        &self.buffer[self.consumed..]
    }

    /// Returns whether a byte can be read without waiting.
    pub(super) fn has_unread_output(&self) -> bool {
        let no_wait = Timespec { tv_sec: 0, tv_nsec: 0 };
        let mut fds = [PollFd::from_borrowed_fd(self.fd.as_fd(), PollFlags::IN)];
        // A closed pipe holds nothing; the next write or read returns the error.
        let mut pipe_has_output =
            || poll(&mut fds, Some(&no_wait)).is_ok() && fds[0].revents().contains(PollFlags::IN);
        !self.buffered_bytes().is_empty() || pipe_has_output()
    }

    /// Reads once into the spare capacity of a vector; waits until there is something to read.
    fn read_into(fd: &OwnedFd, buffer: &mut Vec<u8>, wait: Wait<'_>) -> Result<(), PipeError> {
        loop {
            match rustix::io::read(fd, spare_capacity(buffer)) {
                Ok(0) => return Err(PipeError::Closed(Some(Fault::ClosedOutput))),
                Ok(_) => return Ok(()),
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => drop(wait.until_ready([(fd, PollFlags::IN)])?),
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Reads once into the buffer. Before that, removes bytes that were returned already, if the buffer has no other
    /// bytes or is full.
    fn read_more(&mut self, wait: Wait<'_>) -> Result<(), PipeError> {
        if self.consumed == self.buffer.len() {
            self.buffer.clear();
            self.buffer.shrink_to(MAX_IDLE_CAPACITY_BYTES);
            self.consumed = 0;
        } else if self.buffer.len() == self.buffer.capacity() {
            self.buffer.drain(..self.consumed);
            self.consumed = 0;
        }
        if self.buffer.len() == self.buffer.capacity() {
            self.buffer.reserve(READ_CHUNK_BYTES);
        }
        Self::read_into(&self.fd, &mut self.buffer, wait)
    }

    /// Waits until there is a byte that was not returned yet.
    pub(super) fn wait_for_output(&mut self, wait: Wait<'_>) -> Result<(), PipeError> {
        if self.buffered_bytes().is_empty() { self.read_more(wait) } else { Ok(()) }
    }

    /// Returns the part of the next line that is available. Reads at most once, and only if the buffer is empty.
    pub(super) fn peek_line(&mut self, wait: Wait<'_>) -> &[u8] {
        if self.buffered_bytes().is_empty() {
            // After an error the line is empty; the next read returns the error.
            let _ = self.read_more(wait);
        }
        self.buffered_bytes().split(|byte| *byte == b'\n').next().unwrap_or_default()
    }

    /// Returns the number of bytes that the last [`read_exact`](Self::read_exact) received, also if it failed.
    pub(super) const fn received_bytes(&self) -> usize {
        self.received_bytes
    }

    /// Reads exactly `length` bytes.
    pub(super) fn read_exact(&mut self, length: usize, wait: Wait<'_>) -> Result<Bytes, PipeError> {
        let mut bytes = Vec::with_capacity(length);
        let result = self.fill(&mut bytes, length, wait);
        self.received_bytes = bytes.len();
        result.map(|()| bytes.into())
    }

    /// Reads until a vector has `length` bytes.
    fn fill(&mut self, bytes: &mut Vec<u8>, length: usize, wait: Wait<'_>) -> Result<(), PipeError> {
        let buffered = self.buffered_bytes().len().min(length);
        bytes.extend_from_slice(&self.buffered_bytes()[..buffered]);
        self.consumed += buffered;
        while bytes.len() < length {
            // A short remainder is read together with the bytes after it, which saves a system call.
            if length - bytes.len() < READ_CHUNK_BYTES {
                self.read_more(wait)?;
                let available = self.buffered_bytes().len().min(length - bytes.len());
                bytes.extend_from_slice(&self.buffered_bytes()[..available]);
                self.consumed += available;
            } else {
                Self::read_into(&self.fd, bytes, wait)?;
            }
        }
        Ok(())
    }

    /// Reads the bytes before the next `delimiter`, at most `max_length`. The delimiter is read but not returned.
    pub(super) fn read_until(
        &mut self,
        delimiter: u8,
        max_length: usize,
        wait: Wait<'_>,
    ) -> Result<Bytes, PipeError> {
        let mut searched_bytes = 0;
        loop {
            if let Some(offset) =
                self.buffered_bytes()[searched_bytes..].iter().position(|byte| *byte == delimiter)
            {
                let length = searched_bytes + offset;
                let bytes = Bytes::copy_from_slice(&self.buffered_bytes()[..length]);
                self.consumed += length + 1;
                return if length > max_length { Err(PipeError::LineTooLong(max_length)) } else { Ok(bytes) };
            }
            searched_bytes = self.buffered_bytes().len();
            if searched_bytes > max_length {
                return Err(PipeError::LineTooLong(max_length));
            }
            self.read_more(wait)?;
        }
    }
}
