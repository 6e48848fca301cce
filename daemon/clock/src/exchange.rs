//! Four stamps of a message and its answer: all that two hosts' clocks can be related by.

use serde::{Deserialize, Serialize};

use crate::{Interval, RawTime, Span};

/// A message from the edge to the cloud and its answer, stamped at all four ends (T1 to T4 of RFC 5905, section 8).
///
/// Stamps may be early at a departure and late at an arrival by any amount: that only widens what follows from
/// them. What would make it wrong, a departure stamped late or an arrival stamped early, is `uncertainty`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Exchange {
    /// Not later than the message left the edge; the edge's clock.
    pub sent: RawTime,
    /// Not earlier than it was at the cloud; the cloud's clock.
    pub received: RawTime,
    /// Not later than the answer left the cloud; the cloud's clock.
    pub replied: RawTime,
    /// Not earlier than it was at the edge; the edge's clock.
    pub returned: RawTime,
    /// How wrong, to the unsafe side, the stamps of a departure and of its arrival can be together: the
    /// resolution of clocks and of the format in which stamps travel.
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

    /// Time on the way, both directions together: the edge's waiting less what the cloud took.
    pub fn round_trip(&self) -> Span {
        (self.returned - self.sent) - (self.replied - self.received)
    }

    /// The offset's bounds by this exchange alone, as if the two clocks ran at one rate.
    pub fn bounds(&self) -> Interval {
        Interval { lo: self.lower(), hi: self.upper() }
    }
}

/// An exchange with what else is known of its two ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Witnessed {
    /// The stamps.
    pub exchange: Exchange,
    /// From `received` to `replied` by the cloud's monotonic clock, where these two are of its wall clock: a step of that in between shows
    /// as a difference. Read together with both stamps, or it is `None`: a kernel's stamp is earlier than the program's look at another
    /// clock by as much as the program was kept waiting.
    pub cloud_elapsed: Option<Span>,
    /// [`Clock::epoch`](crate::Clock::epoch) of the edge, read after `returned` was stamped.
    pub edge_epoch: u32,
    /// The cloud's, read after `replied` was stamped; `None` where the peer does not tell, as other
    /// implementations of the probes' protocol.
    pub cloud_epoch: Option<u32>,
}
