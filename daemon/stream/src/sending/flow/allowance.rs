//! Number of bytes that may be in flight, derived from the measured rate of delivery.

use peernet_clock::{MonoTime, Span};

/// Allowance of a new connection, whose path is unknown.
const INITIAL_ALLOWANCE_BYTES: u64 = 4 << 10;

/// Smallest allowance: one or two packets.
const MIN_ALLOWANCE_BYTES: u64 = 2 << 10;

/// Shortest part of a batch. In shorter parts, the headers of all layers would be a large share of the bytes.
const MIN_PART_BYTES: u64 = 1 << 10;

/// Target queueing delay. A queue of this length keeps the link busy. On a slow link, this delay is most of the age of
/// live figures.
const TARGET_QUEUEING: Span = Span::from_millis(100);

/// Longest queueing delay. The target grows up to this delay if the queue would be shorter than [`MIN_QUEUED_BYTES`].
const MAX_QUEUEING: Span = Span::from_millis(400);

/// Minimum number of queued bytes, so that several parts of a batch fit.
const MIN_QUEUED_BYTES: f64 = (4 << 10) as f64;

/// Longest queueing delay that indicates a path with much more capacity. The allowance then grows faster.
const NEGLIGIBLE_QUEUEING: Span = Span::from_millis(10);

/// A rate of delivery is used for at least this time, and for at most twice this time.
const RATE_LIFETIME: Span = Span::from_seconds(5);

/// Number of late echoes in a row after which the link counts as slow. A single late echo may be due to a lost packet.
const LATE_ECHOES_OF_SLOW_LINK: u32 = 2;

/// Lowest allowance of a link that no longer counts as slow.
const FAST_LINK_BYTES: u64 = 64 << 10;

/// Maximum number of bytes that may be in flight.
#[derive(Clone, Debug)]
pub(super) struct Allowance {
    bytes: u64,
    max_bytes: u64,
    rates: DeliveryRates,
    /// Number of late echoes since the last timely echo.
    late_echoes: u32,
    is_slow: bool,
}

impl Allowance {
    /// Creates the allowance of a connection over an unknown path. It never exceeds `max_bytes`.
    pub(super) fn new(max_bytes: u64, is_slow: bool) -> Self {
        Self {
            bytes: INITIAL_ALLOWANCE_BYTES,
            max_bytes: max_bytes.max(INITIAL_ALLOWANCE_BYTES),
            rates: DeliveryRates::default(),
            late_echoes: 0,
            is_slow,
        }
    }

    /// Returns the allowance of the next connection.
    pub(super) fn restarted(&self) -> Self {
        Self::new(self.max_bytes, self.is_slow)
    }

    pub(super) const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Returns whether the link was slow when it was last used.
    pub(super) const fn is_slow(&self) -> bool {
        self.is_slow
    }

    /// Returns the maximum number of bytes of a batch that are handed over in one call.
    pub(super) fn part_bytes(&self) -> u64 {
        (self.bytes / 4).max(MIN_PART_BYTES)
    }

    /// Updates the allowance. The echo of a request behind `bytes_ahead` bytes in flight arrived after `round_trip`;
    /// `shortest` is the shortest round trip.
    pub(super) fn observe(&mut self, bytes_ahead: u64, round_trip: Span, shortest: Span, now: MonoTime) {
        // The agent's own queue causes a delay of at most `MAX_QUEUEING`; a longer delay has another cause.
        let is_late = round_trip > shortest + MAX_QUEUEING;
        self.late_echoes = if is_late { self.late_echoes.saturating_add(1) } else { 0 };
        let rate = bytes_ahead as f64 / round_trip.seconds();
        // After a delay of more than twice the longest queue, the link may be slower, and the earlier rates too high.
        let discard_earlier = round_trip > shortest + MAX_QUEUEING + MAX_QUEUEING;
        self.rates.add(rate, now, discard_earlier);
        let best = self.rates.best();
        // A path with a long round trip needs a longer queue, or the link is idle between bursts.
        let min_queueing = TARGET_QUEUEING.max(Span::from_nanos(shortest.nanos() / 2));
        let queue = Span::from_seconds_f64(MIN_QUEUED_BYTES / best).max(min_queueing).min(MAX_QUEUEING);
        let target = shortest + queue;
        let bytes_at_rate = |rate: f64| (rate * target.seconds()) as u64;
        if round_trip > target {
            // The allowance is at most halved in one step: a single late echo may be due to a lost packet.
            let reduced = bytes_at_rate(best).max(self.bytes / 2).max(MIN_ALLOWANCE_BYTES);
            self.bytes = self.bytes.min(reduced);
        } else {
            // The allowance counts as fully used if less than one part of it was unused.
            let used = bytes_ahead + self.part_bytes();
            let doubled =
                if round_trip <= shortest + NEGLIGIBLE_QUEUEING { 2 * used } else { 2 * bytes_ahead };
            let increased =
                bytes_at_rate(used as f64 / round_trip.seconds()).min(doubled).min(self.max_bytes);
            self.bytes = self.bytes.max(increased);
        }
        // Hysteresis: a link near the limit does not alternate between slow and fast.
        self.is_slow =
            self.late_echoes >= LATE_ECHOES_OF_SLOW_LINK || self.is_slow && self.bytes < FAST_LINK_BYTES;
    }
}

/// The best recent rates of delivery in bytes per second. The maximum is used because a path that is not fully used
/// shows less than its capacity.
#[derive(Clone, Copy, Debug, Default)]
struct DeliveryRates {
    /// Start of the current period; a period lasts [`RATE_LIFETIME`].
    since: MonoTime,
    /// Best rate of the current period.
    current: f64,
    /// Best rate of the previous period.
    previous: f64,
}

impl DeliveryRates {
    /// Adds a rate; with `discard_earlier`, the earlier rates are discarded.
    fn add(&mut self, rate: f64, now: MonoTime, discard_earlier: bool) {
        if discard_earlier {
            *self = Self { since: now, current: rate, previous: 0.0 };
        } else if now - self.since > RATE_LIFETIME {
            *self = Self { since: now, current: rate, previous: self.current };
        } else {
            self.current = self.current.max(rate);
        }
    }

    fn best(&self) -> f64 {
        self.current.max(self.previous)
    }
}
