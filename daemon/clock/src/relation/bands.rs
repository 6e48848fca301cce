//! The current band, and the past bands that suspected jumps ended.

use std::collections::VecDeque;

use super::RelationSettings;
use super::jumps::{ShortestRoundTrips, SuspectedJump};
use crate::band::{Band, Bounds, Contradiction, DriftChangeLimit, DriftLimit, DriftModel, OffsetInterval};
use crate::{Exchange, RawTime, Span};

/// Maximum number of past bands that are kept to judge delays from their time.
const MAX_PAST_BANDS: usize = 16;
/// Longest duration of a message. Past bands are kept for this time in addition to `retention`.
const MAX_MESSAGE_DURATION: Span = Span::from_seconds(60);

/// The current band and past bands. A band bounds the offset by the exchanges between two steps or suspected jumps of
/// the clocks.
///
/// A suspected jump happened at some time between two exchanges. The earlier band holds before the first of these
/// exchanges, and the later band holds after the second. Between the two exchanges either band may hold, so the
/// interval is the hull of the intervals of both bands.
#[derive(Clone, Debug)]
pub(super) struct Bands {
    drift: DriftModel,
    /// The setting [`RelationSettings::window`].
    window_length: Span,
    retention: Span,
    current: Band,
    past_bands: VecDeque<PastBand>,
    /// Time from which it is known which bands hold. Before this time no band bounds the offset. `None` if the
    /// oldest band holds at any earlier time.
    known_from: Option<RawTime>,
    shortest_round_trips: ShortestRoundTrips,
}

/// A band that a suspected jump ended.
#[derive(Clone, Debug)]
struct PastBand {
    band: Band,
    /// Time until which this band certainly holds.
    holds_until: RawTime,
    /// Time after which the next band certainly holds.
    next_holds_from: RawTime,
    /// Time at which the first exchange of the next band was sent.
    next_sent: RawTime,
}

impl Bands {
    pub(super) fn new(settings: &RelationSettings) -> Self {
        let limit = DriftLimit::new(settings.max_drift_ppm);
        // A time daemon may change the rate of a wall clock at once, so no limit holds for the change of the drift.
        let are_free_running = settings.clocks.are_free_running();
        let change_limit =
            are_free_running.then(|| DriftChangeLimit::new(settings.max_drift_change_ppm_per_s, limit));
        let drift = DriftModel { limit, change_limit };
        let (window_length, retention) = (settings.window, settings.retention);
        Self {
            drift,
            window_length,
            retention,
            current: Band::new(drift, window_length, retention),
            past_bands: VecDeque::new(),
            known_from: None,
            shortest_round_trips: ShortestRoundTrips::default(),
        }
    }

    /// Returns the limit of drift.
    pub(super) fn limit(&self) -> DriftLimit {
        self.drift.limit
    }

    /// Returns the current band.
    pub(super) fn current(&self) -> &Band {
        &self.current
    }

    /// Returns a band without exchanges.
    pub(super) fn new_band(&self) -> Band {
        Band::new(self.drift, self.window_length, self.retention)
    }

    /// Returns the assumption that an exchange contradicts.
    pub(super) fn contradiction(&self, bounds: &Bounds) -> Option<Contradiction> {
        self.current.contradiction(bounds)
    }

    /// Returns whether the exchange that showed the last suspected jump overtook this exchange, which may therefore be
    /// from before the jump.
    pub(super) fn may_precede_jump(&self, exchange: &Exchange) -> bool {
        self.past_bands.back().is_some_and(|past| exchange.sent < past.next_sent)
    }

    /// Inserts an exchange that contradicts nothing and was sent after the last suspected jump. If a jump is suspected
    /// before the exchange, the exchange is the first of a new band, and the movement of the offset is returned.
    pub(super) fn insert(&mut self, exchange: &Exchange, bounds: &Bounds) -> Option<Span> {
        let suspected_jump = self.shortest_round_trips.suspected_jump(exchange, self.drift.limit);
        if let Some(SuspectedJump { last_exchange_before: (sent, returned), .. }) = suspected_jump {
            let new_band = self.new_band();
            let mut band = std::mem::replace(&mut self.current, new_band);
            // Exchanges that returned later may be from after the jump: their bounds can be too wide to show it.
            band.truncate(sent, returned);
            // If the edge's own clock jumped back, the second exchange has the earlier stamps. Therefore the
            // minimum and the maximum are taken.
            let (holds_until, next_holds_from) = (sent.min(exchange.sent), returned.max(exchange.returned));
            self.past_bands.push_back(PastBand {
                band,
                holds_until,
                next_holds_from,
                next_sent: exchange.sent,
            });
            // No query needs a band that ended before `start`.
            let start = exchange.returned - self.retention - MAX_MESSAGE_DURATION;
            while self.past_bands.len() > MAX_PAST_BANDS
                || self.past_bands.front().is_some_and(|past| past.next_holds_from < start)
            {
                let removed = self.past_bands.pop_front();
                // The bands that stay do not hold at the time of the removed one.
                self.known_from = removed.map(|past| past.next_holds_from).or(self.known_from);
            }
            self.shortest_round_trips.clear();
        }
        self.current.insert(bounds);
        self.shortest_round_trips.insert(exchange, self.window_length);
        suspected_jump.map(|jump| jump.movement)
    }

    /// Replaces all bands by one band without exchanges, after a step of a clock that a host reported.
    pub(super) fn restart(&mut self) {
        self.current = self.new_band();
        // A step makes all earlier bounds invalid. After a suspected jump, past bands stay valid, because the time of
        // the jump is known.
        self.past_bands.clear();
        self.known_from = None;
        self.shortest_round_trips.clear();
    }

    /// Replaces all bands by one band, which has the exchanges of `band`, after a step that no host reported. The
    /// first of these exchanges was sent at `first_sent`; which messages before it are from before the step, no epoch
    /// shows.
    pub(super) fn restart_at(&mut self, band: Band, first_sent: RawTime) {
        self.restart();
        self.current = band;
        self.known_from = Some(first_sent);
    }

    /// Returns the interval at a time; `None` without an exchange that bounds the offset at this time.
    pub(super) fn interval(&self, at: RawTime) -> Option<OffsetInterval> {
        let hull = |a: OffsetInterval, b: OffsetInterval| OffsetInterval {
            interval: a.interval.hull(b.interval),
            is_consistent: a.is_consistent && b.is_consistent,
        };
        self.bands_at(at).filter_map(|band| band.interval(at)).reduce(hull)
    }

    /// Returns the estimate at a time, within the interval of that time.
    pub(super) fn estimate(&self, at: RawTime, interval: OffsetInterval) -> Span {
        let band = self.bands_at(at).next().unwrap_or(&self.current);
        band.estimate(at, interval.interval)
    }

    /// Returns the estimated change of the offset between two neighbouring times.
    pub(super) fn offset_change(&self, from: RawTime, to: RawTime) -> Span {
        self.current.offset_change(from, to)
    }

    /// Returns whether a jump is suspected at a time, or before it by at most the length of the window. Delays are then
    /// `limited`.
    pub(super) fn is_near_suspected_jump(&self, at: RawTime) -> bool {
        self.past_bands
            .iter()
            .any(|past| past.holds_until <= at && at <= past.next_holds_from + self.window_length)
    }

    /// Returns the number of exchanges of the current band, and of the band before it if a suspected jump separates
    /// them.
    pub(super) fn exchange_count(&self) -> u64 {
        // If only the current band counted, delays would be `stale` after a suspected jump, although both bands bound
        // them.
        self.current.exchange_count() + self.past_bands.back().map_or(0, |past| past.band.exchange_count())
    }

    pub(super) fn memory_bytes(&self) -> usize {
        let past: usize =
            self.past_bands.iter().map(|past| size_of::<PastBand>() + past.band.memory_bytes()).sum();
        self.current.memory_bytes() + past + self.shortest_round_trips.memory_bytes()
    }

    /// Returns the bands that may hold at a time, the latest first.
    fn bands_at(&self, at: RawTime) -> impl Iterator<Item = &Band> {
        let past = self.past_bands.iter().rev();
        let starts = past.clone().map(|past| Some(past.holds_until)).chain([None]);
        let ends = [None].into_iter().chain(past.clone().map(|past| Some(past.next_holds_from)));
        let bands = [&self.current].into_iter().chain(past.map(|past| &past.band));
        let is_known = self.known_from.is_none_or(|known_from| known_from <= at);
        bands.zip(starts.zip(ends)).filter_map(move |(band, (start, end))| {
            let may_hold = start.is_none_or(|start| start < at) && end.is_none_or(|end| at < end);
            (is_known && may_hold).then_some(band)
        })
    }
}
