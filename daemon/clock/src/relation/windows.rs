//! The current window of exchanges, and the past windows that suspected jumps ended.

use std::collections::VecDeque;

use super::RelationSettings;
use super::jumps::{ShortestRoundTrips, SuspectedJump};
use crate::band::{Band, Bounds, Contradiction, DriftChangeLimit, DriftLimit, DriftModel, OffsetInterval};
use crate::{Exchange, RawTime, Span};

/// Maximum number of past windows that are kept to judge delays from their time.
const MAX_PAST_WINDOWS: usize = 16;
/// Longest duration of a message. Past windows are kept for this time in addition to `retention`.
const MAX_MESSAGE_DURATION: Span = Span::from_seconds(60);

/// The exchanges of the current and of past windows, and the bounds of the offset that follow from them.
///
/// A suspected jump happened at some time between two exchanges. The earlier window holds before the first of these
/// exchanges, and the later window holds after the second. Between the two exchanges either window may hold, so the
/// interval is the hull of both.
#[derive(Clone, Debug)]
pub(super) struct Windows {
    drift: DriftModel,
    /// The setting [`RelationSettings::window`], a duration.
    window: Span,
    retention: Span,
    current: Band,
    past_windows: VecDeque<PastWindow>,
    shortest_round_trips: ShortestRoundTrips,
}

/// A window that a suspected jump ended.
#[derive(Clone, Debug)]
struct PastWindow {
    band: Band,
    /// Time until which this window certainly holds.
    holds_until: RawTime,
    /// Time after which the next window certainly holds.
    next_holds_from: RawTime,
    /// Time at which the first exchange of the next window was sent.
    next_sent: RawTime,
}

impl Windows {
    pub(super) fn new(settings: &RelationSettings) -> Self {
        let limit = DriftLimit::new(settings.max_drift_ppm);
        // A time daemon may change the rate of a wall clock at once, so no limit holds for the change of the drift.
        let are_free_running = settings.clocks.are_free_running();
        let change_limit =
            are_free_running.then(|| DriftChangeLimit::new(settings.max_drift_change_ppm_per_s, limit));
        let drift = DriftModel { limit, change_limit };
        let (window, retention) = (settings.window, settings.retention);
        Self {
            drift,
            window,
            retention,
            current: Band::new(drift, window, retention),
            past_windows: VecDeque::new(),
            shortest_round_trips: ShortestRoundTrips::default(),
        }
    }

    /// Returns the limit of drift.
    pub(super) fn limit(&self) -> DriftLimit {
        self.drift.limit
    }

    /// Returns the current window.
    pub(super) fn current(&self) -> &Band {
        &self.current
    }

    /// Returns a window without exchanges.
    pub(super) fn new_band(&self) -> Band {
        Band::new(self.drift, self.window, self.retention)
    }

    /// Returns the assumption that an exchange contradicts.
    pub(super) fn contradiction(&self, bounds: &Bounds) -> Option<Contradiction> {
        self.current.contradiction(bounds)
    }

    /// Returns whether the exchange that showed the last suspected jump overtook this exchange, which may therefore be
    /// from before the jump.
    pub(super) fn may_precede_jump(&self, exchange: &Exchange) -> bool {
        self.past_windows.back().is_some_and(|past| exchange.sent < past.next_sent)
    }

    /// Inserts an exchange that contradicts nothing and was sent after the last suspected jump. If a jump is suspected
    /// before the exchange, the exchange is the first of a new window, and the movement of the offset is returned.
    pub(super) fn insert(&mut self, exchange: &Exchange, bounds: &Bounds) -> Option<Span> {
        let suspected_jump = self.shortest_round_trips.suspected_jump(exchange, self.drift.limit);
        if let Some(SuspectedJump { last_exchange_before: (sent, returned), .. }) = suspected_jump {
            let new_band = self.new_band();
            let mut band = std::mem::replace(&mut self.current, new_band);
            // Exchanges that returned later may be from after the jump: their bounds can be too wide to show it.
            band.truncate(returned);
            // If the edge's own clock jumped back, the second exchange has the earlier stamps. Therefore the
            // minimum and the maximum are taken.
            let (holds_until, next_holds_from) = (sent.min(exchange.sent), returned.max(exchange.returned));
            self.past_windows.push_back(PastWindow {
                band,
                holds_until,
                next_holds_from,
                next_sent: exchange.sent,
            });
            // No query needs a window that ended before `start`.
            let start = exchange.returned - self.retention - MAX_MESSAGE_DURATION;
            while self.past_windows.len() > MAX_PAST_WINDOWS
                || self.past_windows.front().is_some_and(|past| past.next_holds_from < start)
            {
                self.past_windows.pop_front();
            }
            self.shortest_round_trips.clear();
        }
        self.current.insert(bounds);
        self.shortest_round_trips.insert(exchange, self.window);
        suspected_jump.map(|jump| jump.movement)
    }

    /// Replaces all windows by one window, which has the exchanges of `band`, after a step of a clock.
    pub(super) fn restart(&mut self, band: Band) {
        self.current = band;
        // A step makes all earlier bounds invalid. After a suspected jump, past windows stay valid, because the time of
        // the jump is known.
        self.past_windows.clear();
        self.shortest_round_trips.clear();
    }

    /// Returns the interval at a time; `None` without an exchange that bounds the offset at this time.
    pub(super) fn interval(&self, at: RawTime) -> Option<OffsetInterval> {
        let hull = |a: OffsetInterval, b: OffsetInterval| OffsetInterval {
            interval: a.interval.hull(b.interval),
            is_consistent: a.is_consistent && b.is_consistent,
        };
        self.bands(at).filter_map(|band| band.interval(at)).reduce(hull)
    }

    /// Returns the estimate at a time, within the interval of that time.
    pub(super) fn estimate(&self, at: RawTime, interval: OffsetInterval) -> Span {
        let band = self.bands(at).next().unwrap_or(&self.current);
        band.estimate(at, interval.interval)
    }

    /// Returns the estimated change of the offset between two neighbouring times.
    pub(super) fn offset_change(&self, from: RawTime, to: RawTime) -> Span {
        self.current.offset_change(from, to)
    }

    /// Returns whether a jump is suspected at a time or at most one window before it. Delays are then `limited`.
    pub(super) fn is_near_suspected_jump(&self, at: RawTime) -> bool {
        self.past_windows
            .iter()
            .any(|past| past.holds_until <= at && at <= past.next_holds_from + self.window)
    }

    /// Returns the number of exchanges of the current window, and of the window before it if a suspected jump separates
    /// them.
    pub(super) fn exchange_count(&self) -> u64 {
        // If only the current window counted, delays would be `stale` after a suspected jump, although both windows
        // bound them.
        self.current.exchange_count() + self.past_windows.back().map_or(0, |past| past.band.exchange_count())
    }

    pub(super) fn memory_bytes(&self) -> usize {
        let past: usize =
            self.past_windows.iter().map(|past| size_of::<PastWindow>() + past.band.memory_bytes()).sum();
        self.current.memory_bytes() + past + self.shortest_round_trips.memory_bytes()
    }

    /// Returns the windows that may hold at a time, the latest first.
    fn bands(&self, at: RawTime) -> impl Iterator<Item = &Band> {
        let past = self.past_windows.iter().rev();
        let starts = past.clone().map(|past| Some(past.holds_until)).chain([None]);
        let ends = [None].into_iter().chain(past.clone().map(|past| Some(past.next_holds_from)));
        let bands = [&self.current].into_iter().chain(past.map(|past| &past.band));
        bands.zip(starts.zip(ends)).filter_map(move |(band, (start, end))| {
            let may_hold = start.is_none_or(|start| start < at) && end.is_none_or(|end| at < end);
            may_hold.then_some(band)
        })
    }
}
