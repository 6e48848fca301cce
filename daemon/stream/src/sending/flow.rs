//! How much may be on its way at once, so that what is sent next is not old when it arrives.
//!
//! What was handed to the connection can no longer be overtaken: on a slow link a window of batches in the socket's
//! buffer is a minute that every live update behind it waits. So both lanes hand over no more than an *allowance*. It
//! begins with a few kilobytes and follows what the way carries: now and then the aggregator is asked for an echo, which
//! says how long the bytes before it took. It is control by delay as in LEDBAT (RFC 6817), with the rate of delivery
//! as in BBR (draft-ietf-ccwg-bbr): as much as crosses in the shortest round trip and a short queue more.

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Span};

/// What may be on its way at first: nothing is known of the way.
const FIRST: u64 = 4 << 10;

/// What may always be: a packet or two.
const LEAST: u64 = 2 << 10;

/// The shortest part of a batch: below that the headers of all layers would be a large share.
const LEAST_PART: u64 = 1 << 10;

/// How long what is handed over should wait for what was handed over before: the price for never leaving the link idle,
/// and the larger part of what live figures are behind on a slow one.
const QUEUE: Span = Span::from_millis(100);

/// Where that is less than some parts, longer; no longer than this.
const LONGEST_QUEUE: Span = Span::from_millis(400);

/// Some parts, bytes.
const LEAST_QUEUED: f64 = (4 << 10) as f64;

/// A wait so short says that the way carries far more: the allowance grows faster.
const NO_QUEUE: Span = Span::from_millis(10);

/// So long, and twice that at most, a rate of delivery counts.
const REMEMBERED: Span = Span::from_seconds(5);

/// So long the shortest round trip is believed. A queue that stands would pass for it in the end, so that the way is
/// left to run nearly empty for a moment that often.
const BELIEVED: Span = Span::from_seconds(30);

/// An echo that did not come for so long is asked for again.
const REMIND: Span = Span::from_seconds(2);

/// Echoes that are waited for at most.
const MOST_ASKED: usize = 64;

/// What the question for an echo takes on its way, bytes.
const QUESTION: u64 = 48;

/// Times in a row that bytes took longer than they should until the link counts as slow: once may be a lost packet.
const LATE: u32 = 2;

/// With an allowance from here on it no longer does.
const FAST: u64 = 64 << 10;

/// An echo that was asked for.
#[derive(Clone, Copy, Debug)]
struct Asked {
    /// Bytes handed over until then; the aggregator sends it back.
    bytes: u64,
    at: MonoTime,
    /// Bytes that were on their way before it.
    ahead: u64,
}

/// What is on its way, and how much may be.
#[derive(Clone, Debug)]
pub(super) struct Flow {
    most: u64,
    allowance: u64,
    /// Bytes that were handed over.
    handed: u64,
    /// Of those, bytes that are known to have arrived.
    arrived: u64,
    /// Where the last echo was asked for.
    question: u64,
    asked: VecDeque<Asked>,
    /// The shortest round trip, and when it was seen.
    shortest: Option<(Span, MonoTime)>,
    /// Nothing of the durable lane is handed over until the way has run nearly empty.
    draining: bool,
    /// The question that was asked on a way that had.
    probe: Option<u64>,
    rates: Rates,
    late: u32,
    slow: bool,
    /// The end of what the durable lane handed over, and when some of that last arrived.
    durable: u64,
    progress: MonoTime,
    /// What the durable lane may hand over before the next live update goes: they share a way that is too narrow for
    /// both.
    owed: u64,
}

impl Flow {
    /// Nothing is on its way; no more than `most` bytes ever will be.
    pub(super) fn new(most: u64) -> Self {
        Self {
            most: most.max(FIRST),
            allowance: FIRST,
            handed: 0,
            arrived: 0,
            question: 0,
            asked: VecDeque::new(),
            shortest: None,
            draining: false,
            probe: None,
            rates: Rates::default(),
            late: 0,
            slow: false,
            durable: 0,
            progress: MonoTime::default(),
            owed: 0,
        }
    }

    /// The connection is another: what was on its way is not, and nothing is known of the way.
    pub(super) fn restart(&mut self) {
        *self = Self { slow: self.slow, ..Self::new(self.most) };
    }

    /// A message was answered at once: there and back took so long.
    pub(super) fn round_trip(&mut self, span: Span, now: MonoTime) {
        if self.shortest.is_none_or(|(shortest, _)| span <= shortest) {
            self.shortest = Some((span, now));
        }
    }

    pub(super) const fn allowance(&self) -> u64 {
        self.allowance
    }

    /// Whether the link was slow when it last was put to use.
    pub(super) const fn is_slow(&self) -> bool {
        self.slow
    }

    /// When some of the durable lane's bytes last arrived.
    pub(super) const fn progress(&self) -> MonoTime {
        self.progress
    }

    /// Bytes of a batch that are handed over at once, at most.
    pub(super) fn part(&self) -> usize {
        usize::try_from((self.allowance / 4).max(LEAST_PART)).unwrap_or(usize::MAX)
    }

    const fn on_the_way(&self) -> u64 {
        self.handed.saturating_sub(self.arrived)
    }

    /// Whether the durable lane may hand over so many bytes.
    pub(super) fn has_room(&self, bytes: usize) -> bool {
        let on_the_way = self.on_the_way();
        on_the_way == 0 || !self.draining && on_the_way + bytes as u64 <= self.allowance
    }

    /// Whether the live lane may hand over an update.
    pub(super) const fn may_show(&self) -> bool {
        self.owed == 0 && self.on_the_way() < self.allowance
    }

    /// The live lane handed over so many bytes.
    pub(super) const fn shown(&mut self, bytes: u64) {
        self.handed += bytes;
        self.owed = bytes;
    }

    /// The durable lane did. Returns what is handed over with them.
    pub(super) const fn hand_over(&mut self, bytes: u64) -> u64 {
        self.handed += bytes;
        self.durable = self.handed;
        self.owed = self.owed.saturating_sub(bytes);
        self.handed
    }

    /// The durable lane has nothing to hand over: the way is the live lane's.
    pub(super) const fn is_spared(&mut self) {
        self.owed = 0;
    }

    /// The number of an echo that is to be asked for now; `waits` says whether something waits for room on the way, and
    /// `begins` that a batch is about to be handed over.
    pub(super) fn ask(&mut self, waits: bool, begins: bool, now: MonoTime) -> Option<u64> {
        let (on_the_way, unasked) = (self.on_the_way(), self.handed - self.question.max(self.arrived));
        let is_old = self.is_old(now) && self.probe.is_none();
        if is_old && waits && !self.draining {
            // A live update must not wait for this.
            self.owed = 0;
        }
        self.draining = is_old && (waits || self.draining);
        let is_wanted = self.draining || begins && is_old;
        let probes = is_wanted && on_the_way <= self.allowance / 3;
        let due = probes
            || unasked >= self.allowance / 4
            || waits && self.asked.is_empty() && on_the_way > 0
            || self.remind_at().is_some_and(|at| now >= at);
        if !due {
            return None;
        }
        if probes {
            self.draining = false;
            self.probe = Some(self.handed + QUESTION);
        }
        if self.asked.len() == MOST_ASKED {
            self.asked.pop_front();
        }
        self.handed += QUESTION;
        self.question = self.handed;
        self.asked.push_back(Asked { bytes: self.handed, at: now, ahead: on_the_way });
        Some(self.handed)
    }

    /// When an echo that did not come is to be asked for again.
    pub(super) fn remind_at(&self) -> Option<MonoTime> {
        self.asked.back().map(|asked| asked.at + REMIND)
    }

    /// All that was handed over up to here has arrived.
    pub(super) fn arrived(&mut self, bytes: u64, now: MonoTime) {
        if bytes > self.arrived && bytes <= self.handed {
            if self.arrived < self.durable {
                self.progress = now;
            }
            self.arrived = bytes;
        }
    }

    /// An echo came.
    pub(super) fn echoed(&mut self, bytes: u64, now: MonoTime) {
        let mut found = None;
        while let Some(asked) = self.asked.pop_front_if(|asked| asked.bytes <= bytes) {
            found = (asked.bytes == bytes).then_some(asked);
        }
        self.arrived(bytes, now);
        let Some(Asked { at, ahead, .. }) = found else { return };
        let took = (now - at).max(Span::from_millis(1));
        if self.probe.take_if(|probe| *probe <= bytes) == Some(bytes) && self.is_old(now) {
            self.shortest = Some((took, now));
        }
        self.round_trip(took, now);
        if ahead > 0 {
            self.measured(ahead, took, now);
        }
    }

    /// Whether the shortest round trip is to be measured again.
    fn is_old(&self, now: MonoTime) -> bool {
        self.shortest.is_some_and(|(_, at)| now - at > BELIEVED)
    }

    /// So many bytes took so long to arrive, with the way back.
    fn measured(&mut self, bytes: u64, took: Span, now: MonoTime) {
        let shortest = self.shortest.map_or(took, |(shortest, _)| shortest);
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
            let less = fair(best).max(self.allowance / 2).max(LEAST);
            self.allowance = self.allowance.min(less);
        } else {
            // One part less than was allowed does not mean that there is room for no more.
            let full = bytes + self.part() as u64;
            let doubled = if took <= shortest + NO_QUEUE { 2 * full } else { 2 * bytes };
            let more = fair(full as f64 / took.seconds()).min(doubled).min(self.most);
            self.allowance = self.allowance.max(more);
        }
        self.slow = self.late >= LATE || self.slow && self.allowance < FAST;
    }
}

/// The best rate of delivery of late, bytes a second: a way that is not full carries more than it shows.
#[derive(Clone, Copy, Debug, Default)]
struct Rates {
    since: MonoTime,
    now: f64,
    before: f64,
}

impl Rates {
    /// Was seen; `alone` says that what was seen before does not count any more.
    fn add(&mut self, rate: f64, now: MonoTime, alone: bool) {
        if alone {
            *self = Self { since: now, now: rate, before: 0.0 };
        } else if now - self.since > REMEMBERED {
            *self = Self { since: now, now: rate, before: self.now };
        } else {
            self.now = self.now.max(rate);
        }
    }

    fn best(&self) -> f64 {
        self.now.max(self.before)
    }
}
