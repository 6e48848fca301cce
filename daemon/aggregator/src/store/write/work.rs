//! What the writer is given, and why something of it is not stored.

use bytes::Bytes;
use peernet_logger::stream::codec::BatchHead;
use peernet_logger::stream::{Batch, Event, HostDescription, Missing, Placement};
use peernet_logger::{HostId, RunId, Slug};

/// What is to be stored, in the order in which it arrived.
#[derive(Debug)]
pub(crate) enum Work {
    /// A host introduced itself.
    Hello {
        /// The host.
        host: Box<HostDescription>,
        /// The number that its process made at its start.
        process: u64,
    },
    /// A host took its leave: nothing more comes of its runs, unless it kept something for later.
    Goodbye(HostId),
    /// The live lane names a run that the store knows by its iterations only.
    Name(Box<RunName>),
    /// Events.
    Batch(Box<Batch>),
    /// A batch that cannot be read: put aside as it came.
    Unreadable {
        /// Which.
        head: BatchHead,
        /// As it came.
        frame: Bytes,
        /// What is wrong with it.
        reason: String,
    },
    /// Batches that nobody has any more.
    Missing(Missing),
}

/// What the live lane tells of a run.
#[derive(Clone, Debug)]
pub(crate) struct RunName {
    /// Whose.
    pub(crate) host: HostId,
    /// The run.
    pub(crate) run: RunId,
    /// Its pipeline.
    pub(crate) pipeline: Slug,
    /// Where it computes.
    pub(crate) placement: Placement,
}

impl Work {
    /// What it counts when commits are cut by nodes.
    pub(crate) fn weight(&self) -> usize {
        let Self::Batch(batch) = self else { return 1 };
        let weight = |event: &Event| match event {
            Event::Iteration(iteration) => iteration.tree.nodes().len(),
            _ => 1,
        };
        1 + batch.events.iter().map(weight).sum::<usize>()
    }

    /// Whose it is, and up to which number of which stream it goes; nothing of what is no batch.
    pub(super) fn head(&self) -> Option<BatchHead> {
        match self {
            Self::Hello { .. } | Self::Goodbye(_) | Self::Name(_) => None,
            Self::Batch(batch) => {
                Some(BatchHead { host: batch.host, stream: batch.stream, number: batch.number })
            }
            Self::Unreadable { head, .. } => Some(*head),
            Self::Missing(Missing { host, stream, through, .. }) => {
                Some(BatchHead { host: *host, stream: *stream, number: *through })
            }
        }
    }
}

/// Why something was not stored.
#[derive(Debug)]
pub(crate) enum Refusal {
    /// The batch itself cannot be stored: put aside, the stream goes on.
    Batch(String),
    /// The database cannot store anything now: try again.
    Database(sqlx::Error),
}

impl From<sqlx::Error> for Refusal {
    /// What SQLite says of the data is the batch's fault; all else (full, locked, read-only …) is the database's.
    fn from(error: sqlx::Error) -> Self {
        /// Primary result codes: TOOBIG, CONSTRAINT, MISMATCH, RANGE.
        const OF_THE_DATA: [u32; 4] = [18, 19, 20, 25];
        let code = error.as_database_error().and_then(|error| error.code()?.parse::<u32>().ok());
        let data = matches!(error, sqlx::Error::Encode(_))
            || code.is_some_and(|code| OF_THE_DATA.contains(&(code & 0xff)));
        if data { Self::Batch(error.to_string()) } else { Self::Database(error) }
    }
}
