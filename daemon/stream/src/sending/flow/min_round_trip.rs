//! The shortest round trip of the connection, and when it is measured again.

use peernet_clock::{MonoTime, Span};

/// How long the shortest round trip is believed. A standing queue would pass for it in the end, so that the path is
/// left to run nearly empty for a moment that often.
const BELIEVED: Span = Span::from_seconds(30);

/// The shortest round trip that was seen, renewed by a probe on a path that was left to drain.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MinRoundTrip {
    /// The shortest round trip, and when it was seen.
    shortest: Option<(Span, MonoTime)>,
    /// Whether the durable lane waits until the path has run nearly empty.
    draining: bool,
    /// Position of the echo that was requested on a drained path.
    probe: Option<u64>,
}

impl MinRoundTrip {
    /// The shortest round trip; `None` before the first measurement.
    pub(super) fn get(&self) -> Option<Span> {
        self.shortest.map(|(shortest, _)| shortest)
    }

    /// Whether the durable lane waits until the path has run nearly empty.
    pub(super) const fn is_draining(&self) -> bool {
        self.draining
    }

    /// Takes in a round trip.
    pub(super) fn observe(&mut self, span: Span, now: MonoTime) {
        if self.shortest.is_none_or(|(shortest, _)| span <= shortest) {
            self.shortest = Some((span, now));
        }
    }

    /// Takes in the echo of a position: the echo of the probe replaces a shortest round trip that is too old.
    pub(super) fn observe_echo(&mut self, bytes: u64, took: Span, now: MonoTime) {
        if self.probe.take_if(|probe| *probe <= bytes) == Some(bytes) && self.is_old(now) {
            self.shortest = Some((took, now));
        }
        self.observe(took, now);
    }

    /// Whether a probe is due, and none is on its way.
    pub(super) fn is_due(&self, now: MonoTime) -> bool {
        self.is_old(now) && self.probe.is_none()
    }

    /// Lets the path drain while `draining`.
    pub(super) const fn set_draining(&mut self, draining: bool) {
        self.draining = draining;
    }

    /// An echo of this position is requested on a drained path.
    pub(super) const fn begin_probe(&mut self, position: u64) {
        self.draining = false;
        self.probe = Some(position);
    }

    fn is_old(&self, now: MonoTime) -> bool {
        self.shortest.is_some_and(|(_, at)| now - at > BELIEVED)
    }
}
