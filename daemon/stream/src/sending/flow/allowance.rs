//! Number of bytes that may be in flight, derived from the measured rate of delivery.

use peernet_clock::{MonoTime, Span};

/// Allowance of a new connection, whose path is unknown.
const FIRST: u64 = 4 << 10;

/// Smallest allowance: one or two packets.
const LEAST: u64 = 2 << 10;

/// Shortest part of a batch. In shorter parts the headers of all layers would be a large share.
const LEAST_PART: u64 = 1 << 10;

/// Intended queueing delay. It keeps the link busy at all times, and is most of the age of live figures on a slow link.
const QUEUE: Span = Span::from_millis(100);

/// Longest queueing delay. `QUEUE` grows up to it if the queue would be shorter than [`LEAST_QUEUED`].
const LONGEST_QUEUE: Span = Span::from_millis(400);

/// Minimum number of queued bytes, so that several parts of a batch fit.
const LEAST_QUEUED: f64 = (4 << 10) as f64;

/// Longest queueing delay that indicates a path with much more capacity. The allowance then grows faster.
const NO_QUEUE: Span = Span::from_millis(10);

/// Shortest time for which a rate of delivery counts; it counts for at most twice that time.
const REMEMBERED: Span = Span::from_seconds(5);

/// Number of late echoes in a row after which the link counts as slow. A single one may be due to a lost packet.
const LATE: u32 = 2;

/// Allowance from which on the link no longer counts as slow.
const FAST: u64 = 64 << 10;

/// Number of bytes that may be in flight.
#[derive(Clone, Debug)]
pub(super) struct Allowance {
    bytes: u64,
    most: u64,
    rates: DeliveryRates,
    /// Number of late echoes in a row.
    late: u32,
    is_slow: bool,
}

impl Allowance {
    /// Creates the allowance of a connection over an unknown path. It never exceeds `most`.
    pub(super) fn new(most: u64, is_slow: bool) -> Self {
        Self { bytes: FIRST, most: most.max(FIRST), rates: DeliveryRates::default(), late: 0, is_slow }
    }

    /// Returns the allowance of the next connection.
    pub(super) fn restarted(&self) -> Self {
        Self::new(self.most, self.is_slow)
    }

    pub(super) const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Returns whether the link was slow when it was last used.
    pub(super) const fn is_slow(&self) -> bool {
        self.is_slow
    }

    /// Returns the largest number of bytes of a batch that are handed over at once.
    pub(super) fn part(&self) -> u64 {
        (self.bytes / 4).max(LEAST_PART)
    }

    /// Updates the allowance after `bytes` and the answer to them took `took`; `shortest` is the shortest round trip.
    pub(super) fn observe(&mut self, bytes: u64, took: Span, shortest: Span, now: MonoTime) {
        // The queue alone explains a delay up to this.
        let is_late = took > shortest + LONGEST_QUEUE;
        self.late = if is_late { self.late.saturating_add(1) } else { 0 };
        let rate = bytes as f64 / took.seconds();
        self.rates.add(rate, now, took > shortest + LONGEST_QUEUE + LONGEST_QUEUE);
        let best = self.rates.best();
        // A long path needs a longer queue, or bursts leave it empty.
        let least = QUEUE.max(Span::from_nanos(shortest.nanos() / 2));
        let queue = Span::from_seconds_f64(LEAST_QUEUED / best).max(least).min(LONGEST_QUEUE);
        let aim = shortest + queue;
        let fair = |rate: f64| (rate * aim.seconds()) as u64;
        if took > aim {
            let less = fair(best).max(self.bytes / 2).max(LEAST);
            // At most halved at once: a single late echo may be due to a lost packet.
            self.bytes = self.bytes.min(less);
        } else {
            // An allowance that was used up to one part counts as fully used.
            let full = bytes + self.part();
            let doubled = if took <= shortest + NO_QUEUE { 2 * full } else { 2 * bytes };
            let more = fair(full as f64 / took.seconds()).min(doubled).min(self.most);
            self.bytes = self.bytes.max(more);
        }
        // Hysteresis: a link at the limit does not change between both states.
        self.is_slow = self.late >= LATE || self.is_slow && self.bytes < FAST;
    }
}

/// The best recent rates of delivery in bytes per second. The maximum is used because a path that is not fully used
/// shows less than its capacity.
#[derive(Clone, Copy, Debug, Default)]
struct DeliveryRates {
    since: MonoTime,
    current: f64,
    previous: f64,
}

impl DeliveryRates {
    /// Adds a rate; `alone` discards the earlier ones.
    fn add(&mut self, rate: f64, now: MonoTime, alone: bool) {
        if alone {
            *self = Self { since: now, current: rate, previous: 0.0 };
        } else if now - self.since > REMEMBERED {
            *self = Self { since: now, current: rate, previous: self.current };
        } else {
            self.current = self.current.max(rate);
        }
    }

    fn best(&self) -> f64 {
        self.current.max(self.previous)
    }
}
