//! Flow control: limits the bytes in flight, so that messages do not wait for long on the path.
//!
//! Data that was handed to the connection cannot be overtaken: on a slow link, a window of batches in the socket's
//! buffer would delay every later live update by a minute. Both lanes therefore hand over no more than an *allowance*.
//! The allowance starts with a few kilobytes and follows the capacity of the path. The agent requests an echo from the
//! aggregator from time to time. The delay of the echo shows how long the bytes before the request took. This is
//! delay-based congestion control as in LEDBAT (RFC 6817), with the rate of delivery as in BBR (draft-ietf-ccwg-bbr):
//! the allowance is the amount that crosses in the shortest round trip plus a short queue.
//!
//! Two connections with small socket buffers would be simpler but are not sufficient (`docs/measurements.md`). On 50
//! kbit/s live figures become up to 15 s old with `SO_SNDBUF` alone, and up to 82 s old with `TCP_NOTSENT_LOWAT` alone.
//! `SO_SNDBUF` also loses most of the throughput on 500 kbit/s with a round trip of 600 ms. Two connections are
//! equivalent only with `TCP_NOTSENT_LOWAT`, Reno congestion control, and live updates that wait for TCP's
//! acknowledgement. The ZeroMQ library supports none of the three. This module can be removed when the library gives
//! access to the socket; the protocol then needs a second connection, and an authentication of the agent
//! ([`Proof`](crate::Proof)) that covers both connections.

mod allowance;
mod echoes;
mod in_flight_bytes;
mod min_round_trip;

use peernet_clock::{MonoTime, Span};

use self::allowance::Allowance;
use self::echoes::{EchoRequest, PendingEchoes};
use self::in_flight_bytes::InFlightBytes;
use self::min_round_trip::MinRoundTrip;

/// Number of bytes that a request for an echo takes.
const REQUEST_BYTES: u64 = 48;
/// A probe is sent when at most this fraction of the allowance is in flight: 1/3.
const PROBE_DIVISOR: u64 = 3;
/// An echo is requested after this fraction of the allowance was handed over: 1/4.
const ECHO_DIVISOR: u64 = 4;

/// Bytes in flight, and the limit on them.
#[derive(Clone, Debug)]
pub(super) struct FlowControl {
    in_flight: InFlightBytes,
    echoes: PendingEchoes,
    round_trip: MinRoundTrip,
    allowance: Allowance,
    /// Number of bytes that the durable lane may hand over before the next live update. On a link that is too slow for
    /// both lanes, the lanes alternate and hand over equal numbers of bytes.
    durable_share: u64,
}

impl FlowControl {
    /// Creates a flow control with nothing in flight. At most `max_bytes` bytes will be in flight.
    pub(super) fn new(max_bytes: u64) -> Self {
        // A link does not count as slow before its echoes were late.
        let is_slow = false;
        Self::from_allowance(Allowance::new(max_bytes, is_slow))
    }

    /// Resets the state for a new connection, whose path is unknown.
    pub(super) fn restart(&mut self) {
        *self = Self::from_allowance(self.allowance.restarted());
    }

    fn from_allowance(allowance: Allowance) -> Self {
        Self {
            in_flight: InFlightBytes::default(),
            echoes: PendingEchoes::default(),
            round_trip: MinRoundTrip::default(),
            allowance,
            durable_share: 0,
        }
    }

    /// Records the round trip of a message that was answered at once.
    pub(super) fn observe_round_trip(&mut self, span: Span, now: MonoTime) {
        self.round_trip.observe(span, now);
    }

    /// Returns the number of bytes that may be in flight.
    pub(super) const fn allowance(&self) -> u64 {
        self.allowance.bytes()
    }

    /// Returns whether the link was slow when it was last used.
    pub(super) const fn is_slow(&self) -> bool {
        self.allowance.is_slow()
    }

    /// Returns the time at which bytes of the durable lane last arrived.
    pub(super) const fn last_arrival_at(&self) -> MonoTime {
        self.in_flight.last_arrival_at()
    }

    /// Returns the maximum number of bytes of a batch that are handed over in one call.
    pub(super) fn part_bytes(&self) -> usize {
        usize::try_from(self.allowance.part_bytes()).unwrap_or(usize::MAX)
    }

    /// Returns whether the durable lane may hand over `bytes`.
    pub(super) const fn has_capacity(&self, bytes: usize) -> bool {
        let bytes_in_flight = self.in_flight.len();
        // With nothing in flight, one message of any size is allowed.
        bytes_in_flight == 0
            || !self.round_trip.is_draining() && bytes_in_flight + bytes as u64 <= self.allowance.bytes()
    }

    /// Returns whether the live lane may hand over an update.
    pub(super) const fn may_send_live(&self) -> bool {
        self.durable_share == 0 && self.in_flight.len() < self.allowance.bytes()
    }

    /// Records that the live lane handed over bytes.
    pub(super) const fn record_live_sent(&mut self, bytes: u64) {
        self.in_flight.add(bytes);
        // The durable lane may now send the same number of bytes before the next update.
        self.durable_share = bytes;
    }

    /// Records that the durable lane handed over bytes. Returns the position after them.
    pub(super) const fn record_durable_sent(&mut self, bytes: u64) -> u64 {
        self.durable_share = self.durable_share.saturating_sub(bytes);
        self.in_flight.add_durable(bytes)
    }

    /// Records that the durable lane has nothing to hand over, so that the live lane does not wait for the durable
    /// lane.
    pub(super) const fn clear_durable_share(&mut self) {
        self.durable_share = 0;
    }

    /// Returns the position of an echo that is to be requested now; `None` if no echo is due. `is_waiting` is `true` if
    /// a frame does not fit into the allowance yet, `starts_batch` if a batch is about to be handed over.
    ///
    /// If the shortest round trip is outdated, the durable lane sends nothing until the path is nearly empty (it
    /// *drains* the path). Then an echo request, the *probe*, measures the shortest round trip again.
    pub(super) fn request_echo(
        &mut self,
        is_waiting: bool,
        starts_batch: bool,
        now: MonoTime,
    ) -> Option<u64> {
        let bytes_in_flight = self.in_flight.len();
        // An echo tells nothing new about bytes that are known to have arrived.
        let bytes_without_request =
            self.in_flight.handed_over() - self.echoes.last_position().max(self.in_flight.arrived());
        let is_probe_due = self.round_trip.is_probe_due(now);
        if is_probe_due && is_waiting && !self.round_trip.is_draining() {
            // The durable lane sends nothing while the path drains. Live updates therefore do not wait for the durable
            // lane's share.
            self.durable_share = 0;
        }
        self.round_trip.set_draining(is_probe_due && (is_waiting || self.round_trip.is_draining()));
        let needs_probe = self.round_trip.is_draining() || starts_batch && is_probe_due;
        let is_probe = needs_probe && bytes_in_flight <= self.allowance() / PROBE_DIVISOR;
        let is_echo_due = is_probe
            || bytes_without_request >= self.allowance() / ECHO_DIVISOR
            || is_waiting && self.echoes.is_empty() && bytes_in_flight > 0
            || self.echo_retry_at().is_some_and(|at| now >= at);
        if !is_echo_due {
            return None;
        }
        let position = self.in_flight.add(REQUEST_BYTES);
        if is_probe {
            self.round_trip.begin_probe(position);
        }
        self.echoes.push(EchoRequest { position, at: now, bytes_ahead: bytes_in_flight });
        Some(position)
    }

    /// Returns the time at which a missing echo is requested again.
    pub(super) fn echo_retry_at(&self) -> Option<MonoTime> {
        self.echoes.echo_retry_at()
    }

    /// Records that all bytes up to a position have arrived.
    pub(super) const fn record_arrival(&mut self, position: u64, now: MonoTime) {
        self.in_flight.acknowledge(position, now);
    }

    /// Records the echo of the request at a position, and updates the allowance.
    pub(super) fn record_echo(&mut self, position: u64, now: MonoTime) {
        let answered = self.echoes.answer(position);
        self.record_arrival(position, now);
        let Some(EchoRequest { at, bytes_ahead, .. }) = answered else { return };
        // Rates are bytes divided by this time, which must therefore not be zero.
        let round_trip = (now - at).max(Span::from_millis(1));
        self.round_trip.observe_echo(position, round_trip, now);
        // If nothing was in flight before the request, the echo shows the round trip of the path, but no rate.
        if bytes_ahead > 0 {
            let shortest = self.round_trip.shortest().unwrap_or(round_trip);
            self.allowance.observe(bytes_ahead, round_trip, shortest, now);
        }
    }
}
