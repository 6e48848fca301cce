//! The latest announcement of a host about its clocks. No I/O.

use peernet_clock::{ClockClaim, Interval, RawTime, Span};
use peernet_networks::PeerClock;

/// Longest time between the reading of a host's clocks and the arrival of the announcement at the other host.
const MAX_TRANSIT: Span = Span::from_seconds(1);

/// One of the two clocks that the link's clock relation relates, and the latest announcement of its host.
#[derive(Debug)]
pub(super) struct AnnouncedClock {
    /// The latest announcement.
    announcement: PeerClock,
    /// Time at which this host received the announcement, by this host's free-running clock.
    announced_at: RawTime,
    /// `true` if the free-running clock is related, `false` if the wall clock is.
    is_free_running: bool,
    /// Latest known epoch of the related clock.
    epoch: u32,
    /// `true` if the announced claims were made before the latest known epoch began.
    is_outdated: bool,
}

impl AnnouncedClock {
    pub(super) fn new(announcement: PeerClock, is_free_running: bool, at: RawTime) -> Self {
        let epoch = epoch_of(&announcement, is_free_running).unwrap_or(0);
        Self { announcement, announced_at: at, is_free_running, epoch, is_outdated: false }
    }

    /// Handles an announcement. Returns the epoch of the related clock if the epoch is new.
    // The caller passes a new epoch to `begin_epoch` after it has restarted the relation.
    pub(super) fn announce(&mut self, announcement: PeerClock, at: RawTime) -> Option<u32> {
        let epoch = epoch_of(&announcement, self.is_free_running);
        (self.announcement, self.announced_at) = (announcement, at);
        self.is_outdated = epoch.is_some_and(|announced| announced < self.epoch);
        epoch.filter(|announced| *announced > self.epoch)
    }

    /// Sets the epoch of the related clock from an exchange, which may arrive before the announcement. Returns whether
    /// the epoch is new; earlier claims are then void.
    pub(super) fn begin_epoch(&mut self, epoch: u32) -> bool {
        let is_new = epoch > self.epoch;
        if is_new {
            self.epoch = epoch;
            self.is_outdated =
                epoch_of(&self.announcement, self.is_free_running).is_none_or(|announced| announced < epoch);
        }
        is_new
    }

    /// Returns the latest announcement.
    pub(super) const fn announcement(&self) -> &PeerClock {
        &self.announcement
    }

    /// Returns the latest known epoch of the related clock.
    pub(super) const fn epoch(&self) -> u32 {
        self.epoch
    }

    /// Returns the epoch of the wall clock.
    pub(super) const fn wall_epoch(&self) -> u32 {
        self.announcement.epoch
    }

    /// Returns the claim of the time daemon about the related clock at a time of this host's free-running clock: the
    /// clock's reading minus true time.
    ///
    /// The daemon's claim is about the wall clock. The announcement contains the difference of the wall clock and the
    /// free-running clock. Since then the free-running clock may have drifted from true time by the drift limit.
    pub(super) fn claim(&self, now: RawTime, max_drift_ppm: f64) -> Option<ClockClaim> {
        let claim = self.announcement.claim.filter(|_| !self.is_outdated)?;
        if !self.is_free_running {
            return Some(claim);
        }
        let wall_ahead = self.announcement.raw.as_ref()?.wall_ahead;
        let drift = ((now - self.announced_at).max(Span::ZERO) + MAX_TRANSIT).drift(max_drift_ppm);
        let Interval { lo, hi } = claim.error;
        Some(ClockClaim {
            error: Interval { lo: lo - wall_ahead.hi - drift, hi: hi - wall_ahead.lo + drift },
            ..claim
        })
    }
}

/// Returns the epoch of the related clock, if the host announces it.
fn epoch_of(announcement: &PeerClock, is_free_running: bool) -> Option<u32> {
    if is_free_running { announcement.raw.as_ref().map(|raw| raw.epoch) } else { Some(announcement.epoch) }
}

#[cfg(test)]
mod tests {
    use peernet_clock::DelaySource;
    use peernet_networks::RawClock;

    use super::*;

    const FREE_RUNNING: bool = true;
    const WALL: bool = false;

    fn announcement_with_claim(raw_epoch: u32) -> PeerClock {
        let millis = |lo, hi| Interval { lo: Span::from_millis(lo), hi: Span::from_millis(hi) };
        PeerClock {
            claim: Some(ClockClaim { source: DelaySource::Chrony, error: millis(-1, 2) }),
            raw: Some(RawClock {
                epoch: raw_epoch,
                wall_ahead: millis(5_000, 5_001),
                clocksource: String::new(),
            }),
            ..PeerClock::default()
        }
    }

    #[test]
    fn claim_widens_when_related_to_free_running_clock() {
        let at = RawTime::from_nanos(0);
        let announced = AnnouncedClock::new(announcement_with_claim(0), FREE_RUNNING, at);
        let claim = announced.claim(at + Span::from_seconds(9), 100.0).expect("the announcement has a claim");
        let expected = Interval { lo: Span::from_millis(-5_003), hi: Span::from_millis(-4_997) };
        assert_eq!(claim.error, expected, "9 s and `MAX_TRANSIT` at 100 ppm are 1 ms");
        let wall_clock_of_host = AnnouncedClock::new(announcement_with_claim(0), WALL, at);
        assert_eq!(
            wall_clock_of_host.claim(at + Span::from_seconds(9), 100.0),
            announcement_with_claim(0).claim
        );
    }

    #[test]
    fn claim_from_before_interruption_is_void() {
        let at = RawTime::from_nanos(0);
        let mut announced = AnnouncedClock::new(announcement_with_claim(0), FREE_RUNNING, at);
        assert!(announced.begin_epoch(1) && !announced.begin_epoch(1));
        assert_eq!(announced.claim(at, 100.0), None);
        assert_eq!(announced.announce(announcement_with_claim(0), at), None);
        assert_eq!(
            announced.claim(at, 100.0),
            None,
            "the announcement was on its way during the interruption"
        );
        assert_eq!(
            announced.announce(announcement_with_claim(1), at),
            None,
            "the exchange already announced the epoch"
        );
        assert!(announced.claim(at, 100.0).is_some());
        assert_eq!(announced.announce(announcement_with_claim(2), at), Some(2));
    }
}
