//! Which exchanges count, and when all that was learnt is void.

use super::{Learned, Refusal, Relation};
use crate::band::{Band, Bounds};
use crate::{Exchange, Span, WallTime, Witnessed};

/// Offsets and stamps beyond are no clock's (±73 years; a host without a battery starts in 1970).
const ABSURD: Span = Span::from_nanos(1 << 61);
/// A wall clock that moved on differently from the monotonic one by more was stepped: two reads of two clocks, and
/// what a rehearsed clock drifts.
const STEADY: Span = Span::from_micros(50);
const STEADY_PPM: i64 = 500;
/// A peer's counter of steps that went back is a new process, if so many in a row say so. Before, it is an answer that
/// was overtaken.
const NEW_COUNTER: u32 = 8;
/// An exchange that ends so long after the one that told of a step may still have begun before it. For the edge it
/// is short: its stamps themselves may have been set back. Longer ones show against the monotonic clock.
const EDGE_REACH: Span = Span::from_seconds(2);
const CLOUD_REACH: Span = Span::from_seconds(60);

/// The counters of steps of both hosts.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Epochs {
    edge: Option<u32>,
    cloud: Option<u32>,
    /// An older one of the cloud, and how often in a row.
    older: Option<(u32, u32)>,
}

/// What keeps out exchanges that were under way during a step. Who makes exchanges compares the edge's counter before and
/// after them; the cloud's is read after its stamps, so that a stamp may be older than it says, never younger.
#[derive(Clone, Copy, Debug)]
pub(super) enum Barrier {
    /// Nothing.
    Open,
    /// The next exchange is kept out and tells the time.
    Next(Span),
    /// Those sent before, but not by more than the reach.
    Before(WallTime, Span),
}

impl Relation {
    /// An exchange of probes finished.
    pub fn learn(&mut self, witnessed: &Witnessed) -> Learned {
        let learned = self.consider(witnessed);
        let counts = &mut self.counts;
        match learned {
            Learned::Taken | Learned::Restarted(_) => {
                counts.taken += 1;
                self.presence.note(witnessed.exchange.returned);
            }
            Learned::Refused(Refusal::Impossible) => counts.impossible += 1,
            Learned::Refused(Refusal::Outlier) => counts.outliers += 1,
            Learned::Refused(Refusal::Stepped) => counts.stepped += 1,
        }
        learned
    }

    /// The host's own clock was stepped, or ran off faster than the limit: what was learnt before is void.
    pub fn edge_stepped(&mut self, epoch: u32) {
        if self.epochs.edge.is_none_or(|known| known < epoch) {
            self.epochs.edge = Some(epoch);
            self.edge = None;
            self.restart(Barrier::Next(EDGE_REACH));
        }
    }

    /// The peer says that its clock was.
    pub fn cloud_stepped(&mut self, epoch: u32) {
        if self.epochs.cloud.is_none_or(|known| known < epoch) {
            self.epochs.cloud = Some(epoch);
            self.cloud = None;
            self.restart(Barrier::Next(CLOUD_REACH));
        }
    }

    fn consider(&mut self, witnessed: &Witnessed) -> Learned {
        let exchange = &witnessed.exchange;
        if !self.possible(exchange) {
            return Learned::Refused(Refusal::Impossible);
        }
        // The epochs of one that spans a step are news all the same.
        if !self.epochs_hold(witnessed) || !steady(witnessed) || self.kept_out(exchange) {
            return Learned::Refused(Refusal::Stepped);
        }
        let bounds = Bounds::from(exchange);
        if self.band.excludes(&bounds) {
            let Some(believed) = self.suspects.add(&bounds, || Band::new(self.drift, self.settings.window))
            else {
                return Learned::Refused(Refusal::Outlier);
            };
            self.restart(Barrier::Open);
            self.surprises.note(exchange.returned);
            self.band = believed;
        } else {
            self.suspects.hear(&bounds);
            self.band.insert(&bounds);
        }
        match self.restarted.take() {
            None => Learned::Taken,
            Some(before) => {
                let now = self.estimate_at(exchange.returned);
                Learned::Restarted(before.zip(now).map(|(before, now)| now - before))
            }
        }
    }

    /// Whether any two clocks can show this: an answer after the message, and a round trip that is not negative, by more
    /// than the stamps are wrong and than the clocks can run apart meanwhile.
    fn possible(&self, exchange: &Exchange) -> bool {
        let Exchange { sent, received, replied, returned, uncertainty } = *exchange;
        let apart = Span::from_nanos(self.drift.between(sent.unix_nanos(), returned.unix_nanos()));
        let absurd = [sent, received, replied, returned]
            .into_iter()
            .map(|stamp| stamp - WallTime::from_unix_nanos(0))
            .chain([exchange.upper(), exchange.lower(), uncertainty])
            .any(|span| span.abs() > ABSURD);
        !absurd
            && !uncertainty.is_negative()
            && returned >= sent
            && replied >= received
            && exchange.round_trip() + uncertainty + uncertainty + apart >= Span::ZERO
    }

    /// Compares the counters of steps with those known; new ones begin a new window. Whether the exchange is of the
    /// window that was known before.
    fn epochs_hold(&mut self, witnessed: &Witnessed) -> bool {
        let returned = witnessed.exchange.returned;
        let edge = *self.epochs.edge.get_or_insert(witnessed.edge_epoch);
        if witnessed.edge_epoch > edge {
            self.edge_stepped(witnessed.edge_epoch);
            self.barrier = Barrier::Before(returned, EDGE_REACH);
        }
        let cloud = witnessed.cloud_epoch.map(|told| (told, *self.epochs.cloud.get_or_insert(told)));
        let overtaken = cloud.is_some_and(|(told, known)| told < known) && !self.new_counter(cloud);
        if let Some((told, known)) = cloud.filter(|_| !overtaken) {
            self.epochs.older = None;
            if told != known {
                self.epochs.cloud = None;
                self.cloud_stepped(told);
                self.barrier = Barrier::Before(returned, CLOUD_REACH);
            }
        }
        witnessed.edge_epoch == edge && cloud.is_none_or(|(told, known)| told == known)
    }

    /// Whether so many in a row tell of the same older counter that it is a new one.
    fn new_counter(&mut self, cloud: Option<(u32, u32)>) -> bool {
        let Some((told, _)) = cloud else { return false };
        let times = match self.epochs.older {
            Some((older, times)) if older == told => times + 1,
            _ => 1,
        };
        self.epochs.older = Some((told, times));
        times >= NEW_COUNTER
    }

    /// Whether it may have begun before the last step.
    fn kept_out(&mut self, exchange: &Exchange) -> bool {
        match self.barrier {
            Barrier::Open => false,
            Barrier::Next(reach) => {
                self.barrier = Barrier::Before(exchange.returned, reach);
                true
            }
            Barrier::Before(time, reach) => exchange.sent < time && time - exchange.sent <= reach,
        }
    }

    fn restart(&mut self, barrier: Barrier) {
        self.barrier = barrier;
        self.suspects.clear();
        let Some(newest) = self.band.newest() else { return };
        self.restarted = Some(self.estimate_at(newest));
        self.band = Band::new(self.drift, self.settings.window);
        self.presence.clear();
        self.counts.restarts += 1;
    }

    fn estimate_at(&self, at: WallTime) -> Option<Span> {
        self.band.interval(at).map(|interval| self.band.estimate(at, interval))
    }
}

/// Whether each wall clock moved on like its monotonic clock.
fn steady(witnessed: &Witnessed) -> bool {
    let Exchange { sent, received, replied, returned, .. } = witnessed.exchange;
    let alike = |wall: Span, mono: Option<Span>| {
        mono.is_none_or(|mono| {
            let limit = STEADY + Span::from_nanos(mono.abs().nanos() / 1_000_000 * STEADY_PPM);
            (wall - mono).abs() <= limit
        })
    };
    alike(returned - sent, witnessed.edge_elapsed) && alike(replied - received, witnessed.cloud_elapsed)
}
