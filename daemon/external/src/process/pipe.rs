//! The two pipes, with a moment until which each call may wait.

use std::io::{self, IoSlice};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use bytes::Bytes;
use peernet_clock::{MonoTime, SharedClock};
use rustix::buffer::spare_capacity;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::pipe::fcntl_setpipe_size;

use super::{Fault, ProcessError};

/// Bytes that a pipe is asked to hold: the most that Linux gives to everybody (`fs.pipe-max-size`).
const PIPE_BYTES: usize = 1 << 20;
/// Bytes that are read at once where it is not known how many there are.
const CHUNK: usize = 8 << 10;
/// Bytes that are taken in while there is still something to write: as large as any answer.
const MOST_EARLY: usize = 1 << 30;
/// Room that is kept once all has been taken.
const MOST_KEPT: usize = 4 << 20;
/// Most slices in one write, well below what the system takes.
const MAX_SLICES: usize = 64;

/// Why a pipe cannot be used any more.
#[derive(Debug)]
pub(super) enum Broken {
    /// The other end is closed; `None` when that is because the process is gone.
    Closed(Option<Fault>),
    TimedOut,
    TooLong(usize),
    Failed(io::Error),
}

impl From<Errno> for Broken {
    fn from(error: Errno) -> Self {
        Self::Failed(error.into())
    }
}

impl Broken {
    /// As what the caller sees.
    ///
    /// # Errors
    /// Which end is closed, when the process has to be asked how it ended.
    pub(super) fn known(self) -> Result<ProcessError, Option<Fault>> {
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
    // A smaller pipe works as well: it only takes more turns.
    if let Err(error) = fcntl_setpipe_size(&fd, PIPE_BYTES) {
        tracing::debug!(%error, "a pipe stays at its usual size");
    }
    Ok(())
}

/// How long to wait, and for whom.
#[derive(Clone, Copy)]
pub(super) struct Wait<'a> {
    pub(super) clock: &'a SharedClock,
    pub(super) until: MonoTime,
    /// The process at the other end, where the kernel can tell that it is gone: one that it forked may keep the pipe
    /// open.
    pub(super) process: Option<BorrowedFd<'a>>,
}

impl Wait<'_> {
    /// Waits until something can be done with one of the pipes, and says with which.
    fn ready<const N: usize>(&self, pipes: [(&OwnedFd, PollFlags); N]) -> Result<[bool; N], Broken> {
        let mut watched: Vec<_> = pipes.iter().map(|(fd, what)| PollFd::new(*fd, *what)).collect();
        watched.extend(self.process.map(|process| PollFd::from_borrowed_fd(process, PollFlags::IN)));
        self.poll(&mut watched)?;
        if watched[..N].iter().all(|pipe| pipe.revents().is_empty()) {
            // The process is gone; what it wrote just before is in its pipe by now.
            poll(&mut watched[..N], Some(&Timespec::default()))?;
        }
        let ready = std::array::from_fn(|at| !watched[at].revents().is_empty());
        if ready.contains(&true) { Ok(ready) } else { Err(Broken::Closed(None)) }
    }

    /// Waits until one of these is ready.
    fn poll(&self, watched: &mut [PollFd<'_>]) -> Result<(), Broken> {
        loop {
            let left = (self.until - self.clock.mono()).to_duration();
            let timeout =
                Timespec { tv_sec: left.as_secs().cast_signed(), tv_nsec: left.subsec_nanos().into() };
            match poll(watched, Some(&timeout)) {
                Ok(0) if self.until <= self.clock.mono() => return Err(Broken::TimedOut),
                Ok(0) | Err(Errno::INTR) => {}
                Ok(_) => return Ok(()),
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Waits for the end of the process; `false` when there is still one, or nobody can tell.
    pub(super) fn is_over(&self) -> bool {
        let over = |process| self.poll(&mut [PollFd::from_borrowed_fd(process, PollFlags::IN)]).is_ok();
        self.process.is_some_and(over)
    }
}

/// Writes all of the parts, one after the other. What the process writes meanwhile is taken in: one that answers while
/// it still reads would otherwise wait for us as we for it.
pub(super) fn write(
    fd: &OwnedFd,
    parts: &[&[u8]],
    answers: &mut Reader,
    wait: Wait<'_>,
) -> Result<(), Broken> {
    let mut slices: Vec<IoSlice<'_>> = parts.iter().map(|part| IoSlice::new(part)).collect();
    let mut left = slices.as_mut_slice();
    IoSlice::advance_slices(&mut left, 0);
    while !left.is_empty() {
        match rustix::io::writev(fd, &left[..left.len().min(MAX_SLICES)]) {
            Ok(written) => IoSlice::advance_slices(&mut left, written),
            Err(Errno::INTR) => {}
            Err(Errno::AGAIN) => wait_to_write(fd, answers, wait)?,
            Err(Errno::PIPE) => return Err(Broken::Closed(Some(Fault::ClosedInput))),
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

/// Waits until there is room to write, taking in what comes meanwhile.
fn wait_to_write(fd: &OwnedFd, answers: &mut Reader, wait: Wait<'_>) -> Result<(), Broken> {
    let room = (fd, PollFlags::OUT);
    if answers.is_full() {
        return wait.ready([room]).map(drop);
    }
    let [_, answered] = wait.ready([room, (&answers.fd, PollFlags::IN)])?;
    if answered { answers.read_more(wait) } else { Ok(()) }
}

/// The end that is read, with what was read too early.
#[derive(Debug)]
pub(super) struct Reader {
    pub(super) fd: OwnedFd,
    buffer: Vec<u8>,
    /// How much of `buffer` has been taken.
    taken: usize,
}

impl Reader {
    pub(super) fn new(fd: OwnedFd) -> Self {
        Self { fd, buffer: Vec::with_capacity(CHUNK), taken: 0 }
    }

    /// Whether so much waits that no more is taken in before it is asked for.
    fn is_full(&self) -> bool {
        self.waiting().len() >= MOST_EARLY
    }

    /// What was read and not taken yet.
    fn waiting(&self) -> &[u8] {
        &self.buffer[self.taken..]
    }

    /// Whether there is something to be read without waiting.
    pub(super) fn holds_something(&self) -> bool {
        let nothing = Timespec { tv_sec: 0, tv_nsec: 0 };
        let mut fds = [PollFd::from_borrowed_fd(self.fd.as_fd(), PollFlags::IN)];
        let polled = self.waiting().is_empty().then(|| poll(&mut fds, Some(&nothing)));
        // A pipe that is closed holds nothing; whoever writes or reads next is told so.
        polled.is_none_or(|polled| polled.is_ok() && fds[0].revents().contains(PollFlags::IN))
    }

    /// Reads once into the room that a vector has; waits when there is nothing.
    fn read_into(fd: &OwnedFd, into: &mut Vec<u8>, wait: Wait<'_>) -> Result<(), Broken> {
        loop {
            match rustix::io::read(fd, spare_capacity(into)) {
                Ok(0) => return Err(Broken::Closed(Some(Fault::ClosedOutput))),
                Ok(_) => return Ok(()),
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => drop(wait.ready([(fd, PollFlags::IN)])?),
                Err(error) => return Err(error.into()),
            }
        }
    }

    fn read_more(&mut self, wait: Wait<'_>) -> Result<(), Broken> {
        if self.taken == self.buffer.len() {
            self.buffer.clear();
            self.buffer.shrink_to(MOST_KEPT);
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

    /// What has been written of the next line, without waiting for more.
    pub(super) fn glimpse(&mut self, wait: Wait<'_>) -> &[u8] {
        if self.waiting().is_empty() {
            // Nothing there is nothing to be shown, and whoever reads next is told why.
            let _ = self.read_more(wait);
        }
        self.waiting().split(|byte| *byte == b'\n').next().unwrap_or_default()
    }

    /// Exactly `length` bytes.
    pub(super) fn exact(&mut self, length: usize, wait: Wait<'_>) -> Result<Bytes, Broken> {
        let mut bytes = Vec::with_capacity(length);
        let early = self.waiting().len().min(length);
        bytes.extend_from_slice(&self.waiting()[..early]);
        self.taken += early;
        while bytes.len() < length {
            // What is small is read together with what follows it.
            if length - bytes.len() < CHUNK {
                self.read_more(wait)?;
                let more = self.waiting().len().min(length - bytes.len());
                bytes.extend_from_slice(&self.waiting()[..more]);
                self.taken += more;
            } else {
                Self::read_into(&self.fd, &mut bytes, wait)?;
            }
        }
        Ok(bytes.into())
    }

    /// The bytes up to the next `end`, without it.
    pub(super) fn until(&mut self, end: u8, most: usize, wait: Wait<'_>) -> Result<Bytes, Broken> {
        let mut searched = 0;
        loop {
            if let Some(at) = self.waiting()[searched..].iter().position(|byte| *byte == end) {
                let length = searched + at;
                let bytes = Bytes::copy_from_slice(&self.waiting()[..length]);
                self.taken += length + 1;
                return if length > most { Err(Broken::TooLong(most)) } else { Ok(bytes) };
            }
            searched = self.waiting().len();
            if searched > most {
                return Err(Broken::TooLong(most));
            }
            self.read_more(wait)?;
        }
    }
}
