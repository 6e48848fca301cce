//! What the writer is given, and why something of it is not stored.

use bytes::Bytes;
use peernet_logger::{HostId, RunId, Slug};
use peernet_stream::{BatchHead, HostDescription, HostSecret, Lacking, Missing, Placement, StreamId, codec};

use super::prepared::Prepared;

/// What is to be stored, in the order in which it arrived.
#[derive(Debug)]
pub(crate) enum Work {
    /// A host introduced itself.
    Hello(Box<Introduction>),
    /// A host took its leave: nothing more comes of its runs, unless it kept something for later.
    Goodbye(HostId),
    /// The live lane names a run that the store knows by its iterations only.
    Name(Box<RunName>),
    /// Events.
    Batch(Box<Prepared>),
    /// A batch that cannot be stored whatever the database holds: put aside as it came.
    Aside(Box<Aside>),
    /// Batches that nobody has any more.
    Missing(Missing),
    /// Read the secret of a host again: an operator may have cleared it.
    Secret(HostId),
}

/// A host that was let in.
#[derive(Clone, Debug)]
pub(crate) struct Introduction {
    /// The host.
    pub(crate) host: HostDescription,
    /// The number that its process made at its start.
    pub(crate) process: u64,
    /// The stream that its batches belong to.
    pub(crate) stream: StreamId,
    /// The stream that this one goes on from.
    pub(crate) previous: Option<StreamId>,
    /// Number of the stream's first batch.
    pub(crate) first: u64,
    /// The host's stream before, which this one does not go on from: its spool was deleted or replaced.
    pub(crate) replaced: Option<StreamId>,
    /// What this database lacks of the stream that this one goes on from.
    pub(crate) lacking: Option<Lacking>,
    /// The secret that it has proven to have; kept unless there is one.
    pub(crate) secret: Option<HostSecret>,
}

/// A batch that cannot be stored.
#[derive(Clone, Debug)]
pub(crate) struct Aside {
    /// Which.
    pub(crate) head: BatchHead,
    /// As it came.
    pub(crate) frame: Bytes,
    /// Its events in wire form, where they match their hash.
    pub(crate) body: Option<Bytes>,
    /// What is wrong with it.
    pub(crate) reason: String,
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
    /// Events that match their hash, made ready to be stored or to be put aside.
    pub(crate) fn of_batch(head: BatchHead, body: Bytes) -> Self {
        match Prepared::new(head, body.clone()) {
            Ok(batch) => Self::Batch(Box::new(batch)),
            Err(reason) => {
                let frame = Bytes::from(codec::batch_frame(&head, &body, false));
                Self::Aside(Box::new(Aside { head, frame, body: Some(body), reason }))
            }
        }
    }

    /// What it counts when commits are cut by nodes.
    pub(crate) fn weight(&self) -> usize {
        if let Self::Batch(batch) = self { batch.weight() } else { 1 }
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
