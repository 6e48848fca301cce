//! The shortest round trip of the connection, and its regular remeasurement.

use peernet_clock::{MonoTime, Span};

/// Time for which the shortest round trip is valid. At this interval the path is drained for a moment: otherwise a
/// standing queue would be mistaken for a longer path.
const LIFETIME: Span = Span::from_seconds(30);

/// The shortest observed round trip. A probe on a drained path renews it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MinRoundTrip {
    /// Shortest round trip and the time of its observation.
    shortest: Option<(Span, MonoTime)>,
    /// `true` while the durable lane waits until the path is nearly empty.
    is_draining: bool,
    /// Position of the echo that was requested on a drained path.
    probe: Option<u64>,
}

impl MinRoundTrip {
    /// Returns the shortest round trip; `None` before the first measurement.
    pub(super) fn shortest(&self) -> Option<Span> {
        self.shortest.map(|(shortest, _)| shortest)
    }

    /// Returns whether the durable lane waits until the path is nearly empty.
    pub(super) const fn is_draining(&self) -> bool {
        self.is_draining
    }

    /// Adds a round trip.
    pub(super) fn observe(&mut self, span: Span, now: MonoTime) {
        if self.shortest.is_none_or(|(shortest, _)| span <= shortest) {
            self.shortest = Some((span, now));
        }
    }

    /// Adds the round trip of the echo of the request at a position. The echo of the probe replaces a shortest round
    /// trip that is outdated.
    pub(super) fn observe_echo(&mut self, position: u64, round_trip: Span, now: MonoTime) {
        if self.probe.take_if(|probe| *probe <= position) == Some(position) && self.is_outdated(now) {
            self.shortest = Some((round_trip, now));
        }
        self.observe(round_trip, now);
    }

    /// Returns whether the shortest round trip is outdated and no probe is in flight.
    pub(super) fn is_probe_due(&self, now: MonoTime) -> bool {
        self.is_outdated(now) && self.probe.is_none()
    }

    /// Sets whether the durable lane waits until the path is nearly empty.
    pub(super) const fn set_draining(&mut self, is_draining: bool) {
        self.is_draining = is_draining;
    }

    /// Records that an echo is requested on a drained path.
    pub(super) const fn begin_probe(&mut self, position: u64) {
        self.is_draining = false;
        self.probe = Some(position);
    }

    fn is_outdated(&self, now: MonoTime) -> bool {
        self.shortest.is_some_and(|(_, at)| now - at > LIFETIME)
    }
}
