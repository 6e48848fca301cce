//! What one of the two hosts of a relation told of its clocks. No I/O.

use peernet_clock::{Discipline, Interval, RawTime, Span};
use peernet_networks::PeerClock;

/// A host tells of its clocks so soon after it read them that no more than this passes until the other host has it.
const ON_THE_WAY: Span = Span::from_seconds(1);

/// The clock of a host that a relation relates, and what the host told of it last.
#[derive(Debug)]
pub(super) struct ToldClock {
    clock: PeerClock,
    /// When that was told, by the free-running clock of this host.
    at: RawTime,
    /// Whether the free-running clock is the related one, else the wall clock.
    is_free_running: bool,
    /// Epoch of the related clock, as far as known.
    epoch: u32,
    /// Whether claims that are told were made before this epoch.
    outdated: bool,
}

impl ToldClock {
    pub(super) fn new(clock: PeerClock, is_free_running: bool, at: RawTime) -> Self {
        let epoch = epoch_of(&clock, is_free_running).unwrap_or(0);
        Self { clock, at, is_free_running, epoch, outdated: false }
    }

    /// Takes what the host tells now. Returns the epoch of the related clock if it is a new one.
    pub(super) fn tell(&mut self, clock: PeerClock, at: RawTime) -> Option<u32> {
        let epoch = epoch_of(&clock, self.is_free_running);
        (self.clock, self.at) = (clock, at);
        self.outdated = epoch.is_some_and(|told| told < self.epoch);
        epoch.filter(|told| *told > self.epoch)
    }

    /// Takes the epoch of the related clock that an exchange knows of, perhaps before the host tells it. Returns whether it is a new
    /// one: what was claimed before is no claim about the clock after it.
    pub(super) fn begin_epoch(&mut self, epoch: u32) -> bool {
        let is_new = epoch > self.epoch;
        if is_new {
            self.epoch = epoch;
            self.outdated = epoch_of(&self.clock, self.is_free_running).is_none_or(|told| told < epoch);
        }
        is_new
    }

    /// What the host told last.
    pub(super) const fn clock(&self) -> &PeerClock {
        &self.clock
    }

    /// Epoch of the related clock, as far as known.
    pub(super) const fn epoch(&self) -> u32 {
        self.epoch
    }

    /// Epoch of its wall clock.
    pub(super) const fn wall_epoch(&self) -> u32 {
        self.clock.epoch
    }

    /// What its time daemon claims of the related clock at a time of this host's free-running clock: what the clock shows minus true
    /// time. The claim is about the wall clock. That is ahead of a free-running clock by what the host found out when it told of
    /// both; since then the free-running clock went off true time by what the limit of drift allows.
    pub(super) fn claim(&self, now: RawTime, max_drift_ppm: f64) -> Option<Discipline> {
        let claim = self.clock.discipline.filter(|_| !self.outdated)?;
        if !self.is_free_running {
            return Some(claim);
        }
        let ahead = self.clock.raw.as_ref()?.wall_ahead;
        let age = (now - self.at).max(Span::ZERO) + ON_THE_WAY;
        let drift = Span::from_nanos((age.nanos() as f64 * max_drift_ppm * 1e-6).ceil() as i64);
        let Interval { lo, hi } = claim.error;
        Some(Discipline { error: Interval { lo: lo - ahead.hi - drift, hi: hi - ahead.lo + drift }, ..claim })
    }
}

/// Returns the epoch of the related clock, where the host tells it.
fn epoch_of(clock: &PeerClock, is_free_running: bool) -> Option<u32> {
    if is_free_running { clock.raw.as_ref().map(|raw| raw.epoch) } else { Some(clock.epoch) }
}

#[cfg(test)]
mod tests {
    use peernet_clock::DelaySource;
    use peernet_networks::RawClock;

    use super::*;

    fn claiming(raw_epoch: u32) -> PeerClock {
        let millis = |lo, hi| Interval { lo: Span::from_millis(lo), hi: Span::from_millis(hi) };
        PeerClock {
            discipline: Some(Discipline { source: DelaySource::Chrony, error: millis(-1, 2) }),
            raw: Some(RawClock {
                epoch: raw_epoch,
                wall_ahead: millis(5_000, 5_001),
                clocksource: String::new(),
            }),
            ..PeerClock::default()
        }
    }

    #[test]
    fn claim_about_wall_clock_becomes_wider_one_about_free_running_clock() {
        let at = RawTime::from_nanos(0);
        let told = ToldClock::new(claiming(0), true, at);
        let claim = told.claim(at + Span::from_seconds(9), 100.0).expect("it has one");
        let expected = Interval { lo: Span::from_millis(-5_003), hi: Span::from_millis(-4_997) };
        assert_eq!(claim.error, expected, "10 s at 100 ppm are 1 ms at each end");
        let by_wall = ToldClock::new(claiming(0), false, at);
        assert_eq!(by_wall.claim(at + Span::from_seconds(9), 100.0), claiming(0).discipline);
    }

    #[test]
    fn claim_made_before_interruption_is_void_until_next_one() {
        let at = RawTime::from_nanos(0);
        let mut told = ToldClock::new(claiming(0), true, at);
        assert!(told.begin_epoch(1) && !told.begin_epoch(1));
        assert_eq!(told.claim(at, 100.0), None);
        assert_eq!(told.tell(claiming(0), at), None);
        assert_eq!(told.claim(at, 100.0), None, "it was on its way");
        assert_eq!(told.tell(claiming(1), at), None, "known already");
        assert!(told.claim(at, 100.0).is_some());
        assert_eq!(told.tell(claiming(2), at), Some(2));
    }
}
