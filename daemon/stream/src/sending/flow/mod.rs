//! How much may be on its way at once, so that what is sent next is not old when it arrives.
//!
//! What was handed to the connection can no longer be overtaken: on a slow link a window of batches in the socket's
//! buffer is a minute that every live update behind it waits. So both lanes hand over no more than an *allowance*. It
//! begins with a few kilobytes and follows what the way carries: now and then the aggregator is asked for an echo, which
//! says how long the bytes before it took. It is control by delay as in LEDBAT (RFC 6817), with the rate of delivery
//! as in BBR (draft-ietf-ccwg-bbr): as much as crosses in the shortest round trip and a short queue more.

mod allowance;
mod echoes;
mod in_flight_bytes;
mod min_round_trip;

use peernet_clock::{MonoTime, Span};

use self::allowance::Allowance;
use self::echoes::{EchoRequest, PendingEchoes};
use self::in_flight_bytes::InFlightBytes;
use self::min_round_trip::MinRoundTrip;

/// Bytes that the request for an echo takes on its way.
const REQUEST_BYTES: u64 = 48;

/// What is on its way, and how much may be.
#[derive(Clone, Debug)]
pub(super) struct FlowControl {
    in_flight: InFlightBytes,
    echoes: PendingEchoes,
    round_trip: MinRoundTrip,
    allowance: Allowance,
    /// Bytes that the durable lane may hand over before the next live update goes: they share a way that is too narrow for
    /// both.
    owed: u64,
}

impl FlowControl {
    /// Nothing is on its way; no more than `most` bytes ever will be.
    pub(super) fn new(most: u64) -> Self {
        Self::with(Allowance::new(most, false))
    }

    /// The connection is another: what was on its way is not, and nothing is known of the way.
    pub(super) fn restart(&mut self) {
        *self = Self::with(self.allowance.restarted());
    }

    fn with(allowance: Allowance) -> Self {
        Self {
            in_flight: InFlightBytes::default(),
            echoes: PendingEchoes::default(),
            round_trip: MinRoundTrip::default(),
            allowance,
            owed: 0,
        }
    }

    /// A message was answered at once: there and back took so long.
    pub(super) fn round_trip(&mut self, span: Span, now: MonoTime) {
        self.round_trip.observe(span, now);
    }

    /// Bytes that may be on the way.
    pub(super) const fn allowance(&self) -> u64 {
        self.allowance.bytes()
    }

    /// Whether the link was slow when it last was put to use.
    pub(super) const fn is_slow(&self) -> bool {
        self.allowance.is_slow()
    }

    /// When some of the durable lane's bytes last arrived.
    pub(super) const fn progress(&self) -> MonoTime {
        self.in_flight.progress()
    }

    /// Bytes of a batch that are handed over at once, at most.
    pub(super) fn part(&self) -> usize {
        usize::try_from(self.allowance.part()).unwrap_or(usize::MAX)
    }

    /// Whether the durable lane may hand over so many bytes.
    pub(super) const fn has_room(&self, bytes: usize) -> bool {
        let on_the_way = self.in_flight.len();
        on_the_way == 0
            || !self.round_trip.is_draining() && on_the_way + bytes as u64 <= self.allowance.bytes()
    }

    /// Whether the live lane may hand over an update.
    pub(super) const fn may_show(&self) -> bool {
        self.owed == 0 && self.in_flight.len() < self.allowance.bytes()
    }

    /// The live lane handed over so many bytes.
    pub(super) const fn shown(&mut self, bytes: u64) {
        self.in_flight.add(bytes);
        self.owed = bytes;
    }

    /// The durable lane did. Returns what is handed over with them.
    pub(super) const fn hand_over(&mut self, bytes: u64) -> u64 {
        self.owed = self.owed.saturating_sub(bytes);
        self.in_flight.add_durable(bytes)
    }

    /// The durable lane has nothing to hand over: the way is the live lane's.
    pub(super) const fn is_spared(&mut self) {
        self.owed = 0;
    }

    /// The number of an echo that is to be asked for now; `waits` says whether something waits for room on the way, and
    /// `begins` that a batch is about to be handed over.
    pub(super) fn ask(&mut self, waits: bool, begins: bool, now: MonoTime) -> Option<u64> {
        let on_the_way = self.in_flight.len();
        let unasked = self.in_flight.handed() - self.echoes.last().max(self.in_flight.arrived());
        let is_old = self.round_trip.is_due(now);
        if is_old && waits && !self.round_trip.is_draining() {
            // A live update must not wait for this.
            self.owed = 0;
        }
        self.round_trip.set_draining(is_old && (waits || self.round_trip.is_draining()));
        let is_wanted = self.round_trip.is_draining() || begins && is_old;
        let probes = is_wanted && on_the_way <= self.allowance() / 3;
        let due = probes
            || unasked >= self.allowance() / 4
            || waits && self.echoes.is_empty() && on_the_way > 0
            || self.remind_at().is_some_and(|at| now >= at);
        if !due {
            return None;
        }
        let bytes = self.in_flight.add(REQUEST_BYTES);
        if probes {
            self.round_trip.begin_probe(bytes);
        }
        self.echoes.push(EchoRequest { bytes, at: now, ahead: on_the_way });
        Some(bytes)
    }

    /// When an echo that did not come is to be asked for again.
    pub(super) fn remind_at(&self) -> Option<MonoTime> {
        self.echoes.remind_at()
    }

    /// All that was handed over up to here has arrived.
    pub(super) const fn arrived(&mut self, bytes: u64, now: MonoTime) {
        self.in_flight.acknowledge(bytes, now);
    }

    /// An echo came.
    pub(super) fn echoed(&mut self, bytes: u64, now: MonoTime) {
        let answered = self.echoes.answer(bytes);
        self.arrived(bytes, now);
        let Some(EchoRequest { at, ahead, .. }) = answered else { return };
        let took = (now - at).max(Span::from_millis(1));
        self.round_trip.observe_echo(bytes, took, now);
        if ahead > 0 {
            let shortest = self.round_trip.get().unwrap_or(took);
            self.allowance.observe(ahead, took, shortest, now);
        }
    }
}
