//! What the writer is given, and why something of it is not stored.

use bytes::Bytes;
use peernet_logger::{HostId, RunId, Slug};
use peernet_stream::{
    BatchHead, HostDescription, HostSecret, LackingBatches, MissingBatches, Placement, StreamId, codec,
};

use super::prepared::Prepared;

/// What is to be stored, in the order in which it arrived.
#[derive(Debug)]
pub enum Work {
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
    MissingBatches(MissingBatches),
    /// Read the secret of a host again: an operator may have cleared it.
    Secret(HostId),
}

/// A host that was let in.
#[derive(Clone, Debug)]
pub struct Introduction {
    /// The host.
    pub host: HostDescription,
    /// The number that its process made at its start.
    pub process: u64,
    /// The stream that its batches belong to.
    pub stream: StreamId,
    /// The stream that this one goes on from.
    pub previous: Option<StreamId>,
    /// Number of the stream's first batch.
    pub first: u64,
    /// The host's stream before, which this one does not go on from: its spool was deleted or replaced.
    pub replaced: Option<StreamId>,
    /// What this database lacks of the stream that this one goes on from.
    pub lacking: Option<LackingBatches>,
    /// The secret that it has proven to have; kept unless there is one.
    pub secret: Option<HostSecret>,
}

/// A batch that cannot be stored.
#[derive(Clone, Debug)]
pub struct Aside {
    /// Which.
    pub head: BatchHead,
    /// As it came.
    pub frame: Bytes,
    /// Its events in wire form, where they match their hash.
    pub body: Option<Bytes>,
    /// What is wrong with it.
    pub reason: String,
}

/// What the live lane tells of a run.
#[derive(Clone, Debug)]
pub struct RunName {
    /// Whose.
    pub host: HostId,
    /// The run.
    pub run: RunId,
    /// Its pipeline.
    pub pipeline: Slug,
    /// Where it computes.
    pub placement: Placement,
}

impl Work {
    /// Events that match their hash, made ready to be stored or to be put aside.
    pub fn of_batch(head: BatchHead, body: Bytes) -> Self {
        match Prepared::new(head, body.clone()) {
            Ok(batch) => Self::Batch(Box::new(batch)),
            Err(error) => {
                let frame = Bytes::from(codec::batch_frame(&head, &body, false));
                Self::Aside(Box::new(Aside { head, frame, body: Some(body), reason: error.to_string() }))
            }
        }
    }

    /// What it counts when commits are cut by nodes.
    pub fn weight(&self) -> usize {
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
