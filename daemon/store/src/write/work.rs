//! Work for the writer, and the reasons why the writer does not store a piece of work.

use bytes::Bytes;
use peernet_logger::{HostId, RunId, Slug};
use peernet_stream::{
    BatchHead, HostDescription, HostSecret, MissingBatches, MissingPreviousBatches, Placement, StreamId,
    codec,
};

use super::prepared::PreparedBatch;

/// A piece of work for the writer. Work is done in the order of arrival.
#[derive(Debug)]
pub enum Work {
    /// A host introduced itself.
    Hello(Box<Introduction>),
    /// A host said goodbye, so its runs have ended. Events in its spool may still follow.
    Goodbye(HostId),
    /// Pipeline and placement of a run, from a live update. The store has iterations of this run, but its start has not
    /// arrived yet.
    LiveDescription(Box<LiveRunDescription>),
    /// A batch of events.
    Batch(Box<PreparedBatch>),
    /// A batch that can never be stored. It is quarantined as it arrived.
    UnstorableBatch(Box<UnstorableBatch>),
    /// Batches that are not in the database and that the agent no longer has. They are recorded as a gap.
    MissingBatches(MissingBatches),
    /// Request to read the secret of a host again, because an operator may have cleared it.
    Secret(HostId),
}

/// Introduction of an admitted host.
#[derive(Clone, Debug)]
pub struct Introduction {
    /// The host.
    pub host: HostDescription,
    /// Random number that the agent's process drew at its start.
    pub process: u64,
    /// The stream that the host's batches belong to.
    pub stream: StreamId,
    /// The earlier stream that this stream continues.
    pub previous_stream: Option<StreamId>,
    /// Number of the stream's first batch.
    pub first: u64,
    /// The host's previous stream, if this stream does not continue it: the spool was deleted or replaced.
    pub replaced: Option<StreamId>,
    /// Batches of the continued stream that are missing in this database.
    pub missing_previous: Option<MissingPreviousBatches>,
    /// The secret that the host proved to have. It is stored if the host has no stored secret.
    pub secret: Option<HostSecret>,
}

/// A batch that cannot be stored.
#[derive(Clone, Debug)]
pub struct UnstorableBatch {
    /// Head of the batch.
    pub head: BatchHead,
    /// The frame as it arrived.
    pub frame: Bytes,
    /// The events in wire form, if they match their hash.
    pub body: Option<Bytes>,
    /// Reason why the batch cannot be stored.
    pub reason: String,
}

/// Pipeline and placement of a run, from a live update.
#[derive(Clone, Debug)]
pub struct LiveRunDescription {
    /// The host of the run.
    pub host: HostId,
    /// The run.
    pub run: RunId,
    /// Pipeline of the run.
    pub pipeline: Slug,
    /// Placement: where the pipeline computes.
    pub placement: Placement,
}

impl Work {
    /// Prepares a batch whose events match their hash. A batch that cannot be prepared becomes work for the quarantine.
    pub fn from_batch(head: BatchHead, body: Bytes) -> Self {
        match PreparedBatch::new(head, body.clone()) {
            Ok(batch) => Self::Batch(Box::new(batch)),
            Err(error) => {
                let compress = false;
                let frame = Bytes::from(codec::encode_batch(&head, &body, compress));
                Self::UnstorableBatch(Box::new(UnstorableBatch {
                    head,
                    frame,
                    body: Some(body),
                    reason: error.to_string(),
                }))
            }
        }
    }

    /// Returns the weight of the work, by which the sizes of commits are limited. The weight of a batch is 1 plus the
    /// number of its tree nodes (rows of the table `node`), of the runs of its iterations, and of its other events. The
    /// weight of other work is 1.
    pub fn weight(&self) -> usize {
        if let Self::Batch(batch) = self { batch.weight() } else { 1 }
    }
}

/// Reason why work was not stored.
#[derive(Debug)]
pub(crate) enum Refusal {
    /// The batch itself cannot be stored. It is quarantined, and the stream continues.
    Batch(String),
    /// The database cannot store anything now. The same work has to be tried again.
    Database(sqlx::Error),
}

impl From<sqlx::Error> for Refusal {
    /// Attributes SQLite's errors about data to the batch, and all other errors (full, locked, read-only …) to the
    /// database.
    fn from(error: sqlx::Error) -> Self {
        /// Primary result codes: TOOBIG, CONSTRAINT, MISMATCH, RANGE.
        const DATA_ERRORS: [u32; 4] = [18, 19, 20, 25];
        let code = error.as_database_error().and_then(|error| error.code()?.parse::<u32>().ok());
        let is_data_error = matches!(error, sqlx::Error::Encode(_))
            // The lowest byte of an extended result code is the primary result code.
            || code.is_some_and(|code| DATA_ERRORS.contains(&(code & 0xff)));
        if is_data_error { Self::Batch(error.to_string()) } else { Self::Database(error) }
    }
}
