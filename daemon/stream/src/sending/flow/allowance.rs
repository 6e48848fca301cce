//! How many bytes may be on the way at once, by what the path was seen to carry.

use peernet_clock::{MonoTime, Span};

/// What may be on the way at first, when nothing is known of the path.
const FIRST: u64 = 4 << 10;

/// What may always be on the way: a packet or two.
const LEAST: u64 = 2 << 10;

/// The shortest part of a batch: below that the headers of all layers would be a large share.
const LEAST_PART: u64 = 1 << 10;

/// How long what is handed over should wait for what was handed over before: the price for never leaving the link idle,
/// and the larger part of the age of live figures on a slow one.
const QUEUE: Span = Span::from_millis(100);

/// Longest queue. `QUEUE` grows up to it where it would be less than [`LEAST_QUEUED`].
const LONGEST_QUEUE: Span = Span::from_millis(400);

/// Minimum number of queued bytes: some parts of a batch.
const LEAST_QUEUED: f64 = (4 << 10) as f64;

/// A wait so short says that the path carries far more: the allowance grows faster.
const NO_QUEUE: Span = Span::from_millis(10);

/// How long a rate of delivery counts at least; twice that at most.
const REMEMBERED: Span = Span::from_seconds(5);

/// Number of late echoes in a row after which the link counts as slow: a single one may be a lost packet.
const LATE: u32 = 2;

/// Allowance from which on the link no longer counts as slow.
const FAST: u64 = 64 << 10;

/// Number of bytes that may be on the way.
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
    /// The allowance of a connection of which nothing is known; it never exceeds `most`.
    pub(super) fn new(most: u64, is_slow: bool) -> Self {
        Self { bytes: FIRST, most: most.max(FIRST), rates: DeliveryRates::default(), late: 0, is_slow }
    }

    /// The allowance of the connection that follows this one.
    pub(super) fn restarted(&self) -> Self {
        Self::new(self.most, self.is_slow)
    }

    pub(super) const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Whether the link was slow when it last was put to use.
    pub(super) const fn is_slow(&self) -> bool {
        self.is_slow
    }

    /// Bytes of a batch that are handed over at once, at most.
    pub(super) fn part(&self) -> u64 {
        (self.bytes / 4).max(LEAST_PART)
    }

    /// Takes in that `bytes` took so long to arrive, including the way back; `shortest` is the shortest round trip.
    pub(super) fn observe(&mut self, bytes: u64, took: Span, shortest: Span, now: MonoTime) {
        let is_late = took > shortest + LONGEST_QUEUE;
        self.late = if is_late { self.late.saturating_add(1) } else { 0 };
        let rate = bytes as f64 / took.seconds();
        self.rates.add(rate, now, took > shortest + LONGEST_QUEUE + LONGEST_QUEUE);
        let best = self.rates.best();
        // A long way needs more, or what comes in bursts leaves it empty.
        let least = QUEUE.max(Span::from_nanos(shortest.nanos() / 2));
        let queue = Span::from_seconds_f64(LEAST_QUEUED / best).max(least).min(LONGEST_QUEUE);
        let aim = shortest + queue;
        let fair = |rate: f64| (rate * aim.seconds()) as u64;
        if took > aim {
            let less = fair(best).max(self.bytes / 2).max(LEAST);
            self.bytes = self.bytes.min(less);
        } else {
            // One part less than was allowed does not mean that there is room for no more.
            let full = bytes + self.part();
            let doubled = if took <= shortest + NO_QUEUE { 2 * full } else { 2 * bytes };
            let more = fair(full as f64 / took.seconds()).min(doubled).min(self.most);
            self.bytes = self.bytes.max(more);
        }
        self.is_slow = self.late >= LATE || self.is_slow && self.bytes < FAST;
    }
}

/// The best recent rates of delivery, bytes a second: a path that is not full carries more than it shows.
#[derive(Clone, Copy, Debug, Default)]
struct DeliveryRates {
    since: MonoTime,
    current: f64,
    previous: f64,
}

impl DeliveryRates {
    /// Takes in a rate; `alone` says that earlier ones no longer count.
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
