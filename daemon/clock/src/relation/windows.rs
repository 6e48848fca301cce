//! The window of exchanges that counts now, and those before it that a suspected jump ended.

use std::collections::VecDeque;

use super::RelationSettings;
use super::jumps::{Floor, Suspicion};
use crate::band::{Band, Bounds, Contradiction, DriftChangeLimit, DriftLimit, DriftModel, OffsetInterval};
use crate::{Exchange, RawTime, Span};

/// Largest number of windows before the current one that are kept to judge delays of their time.
const MAX_PAST: usize = 16;
/// Time for which past windows are kept beyond `retention`: the longest that a message takes.
const LONGEST_MESSAGE: Span = Span::from_seconds(60);

/// What the exchanges prove of the offset, window by window.
///
/// A suspected jump lies at some time between two exchanges. Before the first the earlier window holds, after the second the later
/// one; in between either may, and the interval is the hull of both.
#[derive(Clone, Debug)]
pub(super) struct Windows {
    drift: DriftModel,
    window: Span,
    retention: Span,
    current: Band,
    past: VecDeque<PastWindow>,
    floor: Floor,
}

/// A window that a suspected jump ended.
#[derive(Clone, Debug)]
struct PastWindow {
    band: Band,
    /// Time until which this window certainly holds.
    until: RawTime,
    /// Time from which on the next window certainly holds.
    next_from: RawTime,
    /// Time at which the first exchange of the next window was sent.
    next_sent: RawTime,
}

impl Windows {
    pub(super) fn new(settings: &RelationSettings) -> Self {
        let limit = DriftLimit::new(settings.max_drift_ppm);
        // A time daemon changes the rate of a wall clock at once.
        let is_free = settings.clocks.are_free_running();
        let change = is_free.then(|| DriftChangeLimit::new(settings.max_drift_change_ppm_per_s, limit));
        let drift = DriftModel { limit, change };
        let (window, retention) = (settings.window, settings.retention);
        Self {
            drift,
            window,
            retention,
            current: Band::new(drift, window, retention),
            past: VecDeque::new(),
            floor: Floor::default(),
        }
    }

    /// The limit of drift.
    pub(super) fn limit(&self) -> DriftLimit {
        self.drift.limit
    }

    /// The window that counts now.
    pub(super) fn current(&self) -> &Band {
        &self.current
    }

    /// Returns a window without exchanges.
    pub(super) fn empty(&self) -> Band {
        Band::new(self.drift, self.window, self.retention)
    }

    /// Returns the assumption that an exchange contradicts.
    pub(super) fn contradiction(&self, bounds: &Bounds) -> Option<Contradiction> {
        self.current.contradiction(bounds)
    }

    /// Inserts an exchange that contradicts nothing. Returns by how much the offset seems to have jumped before it, if
    /// a jump is suspected: the exchange is then the first of a new window.
    pub(super) fn insert(&mut self, exchange: &Exchange, bounds: &Bounds) -> Option<Span> {
        if self.past.back().is_some_and(|past| exchange.sent < past.next_sent) {
            // The exchange that showed the jump overtook this one, which may be from before the jump.
            return None;
        }
        let suspicion = self.floor.suspect(exchange, self.drift.limit);
        if let Some(Suspicion { last_before: (sent, returned), .. }) = suspicion {
            let empty = self.empty();
            let mut band = std::mem::replace(&mut self.current, empty);
            // Exchanges since then may be from after the jump, and too wide to show it.
            band.truncate(returned);
            // The edge's own clock may have jumped back.
            let (until, next_from) = (sent.min(exchange.sent), returned.max(exchange.returned));
            self.past.push_back(PastWindow { band, until, next_from, next_sent: exchange.sent });
            let start = exchange.returned - self.retention - LONGEST_MESSAGE;
            while self.past.len() > MAX_PAST || self.past.front().is_some_and(|past| past.next_from < start) {
                self.past.pop_front();
            }
            self.floor.clear();
        }
        self.current.insert(bounds);
        self.floor.insert(exchange, self.window);
        suspicion.map(|suspicion| suspicion.moved)
    }

    /// Replaces all windows by one, after a step of a clock.
    pub(super) fn restart(&mut self, window: Band) {
        self.current = window;
        self.past.clear();
        self.floor.clear();
    }

    /// The interval at a time; `None` without an exchange that says anything of it.
    pub(super) fn interval(&self, at: RawTime) -> Option<OffsetInterval> {
        let hull = |one: OffsetInterval, other: OffsetInterval| OffsetInterval {
            interval: one.interval.hull(other.interval),
            is_consistent: one.is_consistent && other.is_consistent,
        };
        self.bands(at).filter_map(|band| band.interval(at)).reduce(hull)
    }

    /// The best guess at a time, within the interval of that time.
    pub(super) fn estimate(&self, at: RawTime, known: OffsetInterval) -> Span {
        let band = self.bands(at).next().unwrap_or(&self.current);
        band.estimate(at, known.interval)
    }

    /// Returns by how much the offset most likely grows from one time to another one near it.
    pub(super) fn growth(&self, from: RawTime, to: RawTime) -> Span {
        self.current.growth(from, to)
    }

    /// Whether a jump is suspected so shortly before a time that delays are `limited`: within the length of the window.
    pub(super) fn is_unsettled(&self, at: RawTime) -> bool {
        self.past.iter().any(|past| past.until <= at && at <= past.next_from + self.window)
    }

    /// Exchanges of the current window, and of the one before it where a jump is suspected in between.
    pub(super) fn exchanges(&self) -> u64 {
        self.current.exchanges() + self.past.back().map_or(0, |past| past.band.exchanges())
    }

    pub(super) fn memory_bytes(&self) -> usize {
        let past: usize =
            self.past.iter().map(|past| size_of::<PastWindow>() + past.band.memory_bytes()).sum();
        self.current.memory_bytes() + past + self.floor.memory_bytes()
    }

    /// The windows that may hold at a time, the latest first.
    fn bands(&self, at: RawTime) -> impl Iterator<Item = &Band> {
        let past = self.past.iter().rev();
        let begins = past.clone().map(|past| Some(past.until)).chain([None]);
        let ends = [None].into_iter().chain(past.clone().map(|past| Some(past.next_from)));
        let bands = [&self.current].into_iter().chain(past.map(|past| &past.band));
        bands.zip(begins.zip(ends)).filter_map(move |(band, (begin, end))| {
            let may_hold = begin.is_none_or(|begin| begin < at) && end.is_none_or(|end| at < end);
            may_hold.then_some(band)
        })
    }
}
