//! Four stamps of a message and its answer: all that two hosts' clocks can be related by.

use serde::{Deserialize, Serialize};

use crate::{Interval, RawTime, Span};

/// A message from the edge to the cloud and its answer, stamped at all four ends (T1 to T4 of RFC 5905, section 8).
///
/// Stamps may be early at a departure and late at an arrival by any amount: that only widens what follows from
/// them. What would make it wrong, a departure stamped late or an arrival stamped early, is `uncertainty`.
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
    /// Largest sum by which the departure is stamped too late and its arrival too early: the resolution of clocks and of
    /// the format in which stamps travel.
    pub uncertainty: Span,
}

impl Exchange {
    /// An upper bound of the offset (cloud minus edge) at the edge's time [`sent`](Self::sent).
    ///
    /// When the edge showed `sent` the cloud showed no more than `received`: its clock was read later.
    pub fn upper(&self) -> Span {
        self.received - self.sent + self.uncertainty
    }

    /// A lower bound of the offset (cloud minus edge) at the edge's time [`returned`](Self::returned).
    ///
    /// When the edge showed `returned` the cloud showed at least `replied`: its clock was read earlier.
    pub fn lower(&self) -> Span {
        self.replied - self.returned - self.uncertainty
    }

    /// Time on the way in both directions together: the time that the edge waited, less the time that the cloud took.
    pub fn round_trip(&self) -> Span {
        (self.returned - self.sent) - (self.replied - self.received)
    }

    /// The offset's bounds by this exchange alone, as if the two clocks ran at one rate.
    pub fn bounds(&self) -> Interval {
        Interval { lo: self.lower(), hi: self.upper() }
    }
}

/// An exchange, with the epochs of the clocks that stamped it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExchangeObservation {
    /// The stamps.
    pub exchange: Exchange,
    /// Time from `received` to `replied` by the cloud's monotonic clock, where these two stamps are of its wall clock: a step of the wall
    /// clock in between shows as a difference. `None` unless the monotonic clock was read together with both stamps: a kernel's stamp
    /// is earlier than the program's reading of another clock by as long as the program waited for the processor.
    pub cloud_elapsed: Option<Span>,
    /// [`Clock::epoch`](crate::Clock::epoch) of the edge, read after `returned` was stamped.
    pub edge_epoch: u32,
    /// Epoch of the cloud's clock, read after `replied` was stamped; `None` where the peer does not send it, such as another
    /// implementation of the probes' protocol.
    pub cloud_epoch: Option<u32>,
}
