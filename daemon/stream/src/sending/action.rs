//! What the machine asks of its owner, and what it tells it.

use super::super::{Chain, StreamId};
#[cfg(doc)]
use super::Sending;
use crate::spool::SpooledBatch;
use crate::totals::Totals;
use peernet_logger::Slug;

/// What the owner is to do, in this order. Every action but `Send` is answered by one of the calls named in it; until
/// then no second one of its kind comes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Write these batches and totals to the spool in one transaction: [`Sending::appended`] or
    /// [`Sending::append_failed`].
    ///
    /// Without batches it comes before anything is sent that was written out of contact, and says so
    /// ([`Totals::reached`]): it should be on the medium, not only in the system's memory, before it is answered.
    Append {
        /// The batches, contiguous and following the newest in the spool; none when only the totals changed.
        batches: Vec<SpooledBatch>,
        /// What is counted up to the last of them.
        totals: Totals,
    },
    /// Read batches from this number on, at least one, until they exceed so many bytes: [`Sending::loaded`] or
    /// [`Sending::load_failed`].
    Load {
        /// The first.
        from: u64,
        /// Bytes of bodies that are wanted.
        bytes: usize,
    },
    /// Delete the batches up to and including this number and keep the chain of that batch: [`Sending::deleted`], or
    /// [`Sending::delete_failed`] after which it is asked again later.
    ///
    /// The number may be beyond the newest in the spool: batches were stored from memory while it failed. It then is
    /// the newest one there ever was, and the next one that is appended follows it.
    Delete {
        /// The last.
        through: u64,
        /// Its chain.
        chain: Chain,
    },
    /// The stream is left for a new one, in which the batches that are held keep their numbers and chains:
    /// [`Sending::renewed`] or [`Sending::renew_failed`].
    Renew {
        /// The new one.
        stream: StreamId,
        /// The one that is left.
        previous: StreamId,
        /// The first number of the new one.
        first: u64,
        /// Events in all batches of the spool before that.
        events_before_first: u64,
    },
    /// Send this frame.
    Send(Vec<u8>),
}

/// What the agent should know of, and log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Notice {
    /// The aggregator knows no secret of this host and is told it now.
    Enrolling {
        /// Name of its host.
        aggregator: Slug,
    },
    /// The aggregator took us in; batches flow.
    Welcomed {
        /// Name of its host.
        aggregator: Slug,
        /// Number of the last batch it has.
        stored: u64,
        /// Whether it lacks batches that it once acknowledged: its database is a new one or an old copy.
        lacks: bool,
    },
    /// It did not; tried again later.
    Refused(String),
    /// It has batches of this stream that were never made here, or others than ours under the same numbers: the spool
    /// is a copy, or older than it was. What it holds goes on in a new stream.
    StreamRenewed {
        /// Number of the last batch the aggregator has.
        stored: u64,
        /// Number of the last batch made here.
        newest: u64,
    },
    /// The spool cannot be written or read; events wait in memory and go to the aggregator from there.
    SpoolFailed(String),
    /// It can again.
    SpoolRecovered,
}
