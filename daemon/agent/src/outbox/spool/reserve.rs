//! Room on the disk that is kept for deleting.
//!
//! SQLite writes before it deletes: into the log, and from there into the file. A spool that filled its disk could
//! never be emptied. So a file beside it holds some room, which is given free for a deletion and taken again after it.

use std::fs::{self, File};
use std::io;
use std::path::PathBuf;

use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;

/// What the log may hold when the disk becomes full (256 pages and the largest transaction), and what deleting adds.
const BYTES: u64 = 6 << 20;

/// The room.
#[derive(Debug)]
pub(super) struct Reserve {
    file: PathBuf,
    state: State,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Held,
    /// To be taken again before anything else is written.
    Free,
    /// The file system cannot hold room.
    Impossible,
}

impl Reserve {
    /// Gives free what an earlier process held.
    pub(super) fn new(file: PathBuf) -> Self {
        let mut reserve = Self { file, state: State::Held };
        reserve.release();
        reserve
    }

    /// Gives the room free; returns whether there was any.
    pub(super) fn release(&mut self) -> bool {
        if self.state != State::Held {
            return false;
        }
        match fs::remove_file(&self.file) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                tracing::debug!(%error, "the spool's reserve {} cannot be given free", self.file.display());
                false
            }
            _ => {
                self.state = State::Free;
                true
            }
        }
    }

    /// Takes the room; returns whether the disk has it, if it can be held at all.
    pub(super) fn take(&mut self) -> bool {
        if self.state == State::Free {
            self.state = match self.allocate() {
                Ok(()) => State::Held,
                Err(Errno::OPNOTSUPP) => State::Impossible,
                Err(error) => {
                    tracing::debug!(%error, "the spool's reserve {} cannot be had", self.file.display());
                    State::Free
                }
            };
            // What was allocated of it before the disk was full is not kept from the others.
            if self.state != State::Held
                && let Err(error) = fs::remove_file(&self.file)
            {
                tracing::debug!(%error, "no reserve to remove");
            }
        }
        self.state != State::Free
    }

    fn allocate(&self) -> Result<(), Errno> {
        let file =
            File::create(&self.file).map_err(|error| Errno::from_io_error(&error).unwrap_or(Errno::IO))?;
        fallocate(&file, FallocateFlags::empty(), 0, BYTES)
    }
}
