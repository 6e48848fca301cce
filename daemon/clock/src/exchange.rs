//! Four stamps of a message and its answer, from which the clocks of two hosts are related.

use serde::{Deserialize, Serialize};

use crate::{Interval, RawTime, Span};

/// A message from the edge to the cloud and its answer, stamped at all four ends (T1 to T4 of RFC 5905, section 8).
///
/// A departure that is stamped early, or an arrival that is stamped late, only widens the bounds. A departure that is
/// stamped late, or an arrival that is stamped early, makes the bounds wrong; `uncertainty` covers such errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Exchange {
    /// Time on the edge's clock at which the message left the edge, or earlier.
    pub sent: RawTime,
    /// Time on the cloud's clock at which the message arrived there, or later.
    pub received: RawTime,
    /// Time on the cloud's clock at which the answer left the cloud, or earlier.
    pub replied: RawTime,
    /// Time on the edge's clock at which the answer arrived there, or later.
    pub returned: RawTime,
    /// Upper limit of the sum of two errors: by how much the departure of a message is stamped too late, and by how
    /// much the arrival of the same message is stamped too early. The errors come from the resolution of the clocks and
    /// of the format in which stamps are sent.
    pub uncertainty: Span,
}

impl Exchange {
    /// Returns an upper bound of the offset (cloud minus edge) at the edge's time [`sent`](Self::sent).
    // When the edge's clock showed `sent`, the cloud's clock showed no more than `received`, because it was read later.
    pub fn upper(&self) -> Span {
        self.received - self.sent + self.uncertainty
    }

    /// Returns a lower bound of the offset (cloud minus edge) at the edge's time [`returned`](Self::returned).
    // When the edge's clock showed `returned`, the cloud's clock showed at least `replied`, because it was read
    // earlier.
    pub fn lower(&self) -> Span {
        self.replied - self.returned - self.uncertainty
    }

    /// Returns the time spent on the network in both directions: the time that the edge waited minus the time that the
    /// cloud took.
    pub fn round_trip(&self) -> Span {
        (self.returned - self.sent) - (self.replied - self.received)
    }

    /// Returns the bounds of the offset that follow from this exchange alone, if the clocks do not drift during the
    /// exchange.
    pub fn bounds(&self) -> Interval {
        Interval { lo: self.lower(), hi: self.upper() }
    }
}

/// An exchange with the epochs of the clocks that stamped it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExchangeObservation {
    /// The stamps.
    pub exchange: Exchange,
    /// Time from `received` to `replied` by the cloud's monotonic clock, if these two stamps are of the cloud's wall
    /// clock ([`RawTime`] holds times of either clock). If the difference of the stamps is not this time, the wall
    /// clock was stepped between them. `None` unless the monotonic clock was read together with both stamps.
    // The monotonic clock cannot be read together with a stamp of the kernel: the kernel takes its stamp first, and the
    // program reads the other clock only after it has waited for the processor.
    pub cloud_elapsed: Option<Span>,
    /// [`Clock::epoch`](crate::Clock::epoch) of the edge, read after `returned` was stamped.
    pub edge_epoch: u32,
    /// Epoch of the cloud's clock, read after `replied` was stamped; `None` if the peer does not send it, such as
    /// another implementation of STAMP.
    pub cloud_epoch: Option<u32>,
}
