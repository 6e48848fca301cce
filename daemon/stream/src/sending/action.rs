//! Actions of the sending state machine, and its notices to the agent.

use super::super::{ChainHash, StreamId};
#[cfg(doc)]
use super::Sending;
use crate::spool::SpooledBatch;
use crate::totals::Totals;
use peernet_logger::Slug;

/// Action that the owner of the state machine has to perform. Actions are performed in the order in which they are
/// returned. The owner answers every action except `Send` by a call of one of the methods that the action's description
/// names. Before this answer, no second action of the same kind is returned.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Write these batches and totals to the spool in one transaction. Answer: [`Sending::on_appended`] or
    /// [`Sending::on_append_failed`].
    ///
    /// While the spool can be written, a batch is sent only after an `Append` has recorded that the batch may be sent
    /// ([`Totals::newest_sendable`]). For batches that were written while disconnected, this is an `Append` with empty
    /// `batches`. The record should be on the medium, not only in the system's memory, before the action is answered.
    Append {
        /// Contiguous batches that follow the newest batch in the spool; empty if only the totals changed.
        batches: Vec<SpooledBatch>,
        /// Totals up to the last of these batches; without batches, up to the newest batch that is in the spool or
        /// stored by the aggregator.
        totals: Totals,
    },
    /// Read batches from a number on: at least one, and more until their bodies exceed a number of bytes.
    /// Answer: [`Sending::on_loaded`] or [`Sending::on_load_failed`].
    Load {
        /// Number of the first batch.
        from: u64,
        /// Number of bytes of bodies to read.
        bytes: usize,
    },
    /// Delete the batches up to a number and keep the chain hash of the last deleted batch. Answer:
    /// [`Sending::on_deleted`], or [`Sending::on_delete_failed`], after which the deletion is requested again later.
    ///
    /// The number may be beyond the newest batch in the spool if the aggregator stored batches that were sent from
    /// memory while the spool failed. This number then becomes the newest number of the spool, and the next appended
    /// batch has the following number.
    Delete {
        /// Number of the last batch.
        through: u64,
        /// Chain hash of that batch.
        chain: ChainHash,
    },
    /// Replace the stream by a new stream, in which the batches in the spool keep their numbers and chain hashes.
    /// Answer: [`Sending::on_renewed`] or [`Sending::on_renew_failed`].
    Renew {
        /// New stream.
        stream: StreamId,
        /// Previous stream.
        previous_stream: StreamId,
        /// Number of the first batch of the new stream.
        first: u64,
        /// Number of events in all earlier batches, which are no longer in the spool.
        events_before_first: u64,
    },
    /// Send this frame.
    Send(Vec<u8>),
}

/// A notice for the agent to log and to show.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Notice {
    /// The aggregator has no secret of this host; the secret is sent now.
    Enrolling {
        /// Name of the aggregator's host.
        aggregator: Slug,
    },
    /// The aggregator accepted the host, and batches are sent.
    Welcomed {
        /// Name of the aggregator's host.
        aggregator: Slug,
        /// Number of the last batch that the aggregator has stored.
        stored: u64,
        /// `true` if the aggregator lacks batches that it acknowledged earlier: its database is new or an old copy.
        aggregator_lost_batches: bool,
    },
    /// The aggregator refused the host; the agent tries again later.
    Refused(String),
    /// The aggregator has batches of this stream that this spool never had, or different batches with the same numbers:
    /// the spool is a copy or was restored from an old copy. Its batches continue in a new stream.
    StreamRenewed {
        /// Number of the last batch that the aggregator has.
        stored: u64,
        /// Number of the newest batch of this spool.
        newest: u64,
    },
    /// The spool cannot be written or read. Events wait in memory and are sent from there.
    SpoolFailed(String),
    /// The spool works again.
    SpoolRecovered,
}
