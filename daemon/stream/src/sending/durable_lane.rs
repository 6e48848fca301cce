//! The durable lane: chooses the next frame, and limits the bytes in flight of both lanes.

use peernet_clock::{MonoTime, Span};
use peernet_logger::HostId;

use super::SendingConfig;
use super::compression_control::CompressionControl;
use super::flow::FlowControl;
use super::in_flight_batches::InFlightBatches;
use super::partial_batch::PartialBatch;
use super::spooler::EventSpooler;
use crate::{ToAggregator, batch_weight, codec};

/// Maximum number of bytes of batches that are sent and not stored, in units of the allowance. The number is larger
/// than 1, because storing takes time, and because the allowance counts compressed bytes.
const UNSTORED_PER_ALLOWANCE: u64 = 8;

/// The batches in flight to the aggregator, and the flow control of both lanes.
#[derive(Clone, Debug)]
pub(super) struct DurableLane {
    config: SendingConfig,
    /// Window in units of batches, as stated by the aggregator.
    window: u32,
    compression: CompressionControl,
    flow: FlowControl,
    in_flight: InFlightBatches,
    /// Remaining bytes of the batch that was sent last.
    partial: Option<PartialBatch>,
}

/// Output of the durable lane.
#[derive(Clone, Debug, Default)]
pub(super) struct LaneOutput {
    /// Frame to be sent; `None` if nothing can be sent now.
    pub(super) frame: Option<Vec<u8>>,
    /// `true` if the frame begins a batch.
    pub(super) starts_batch: bool,
}

impl DurableLane {
    /// Creates a lane with nothing in flight. At most `max_bytes` bytes will be in flight.
    pub(super) fn new(config: SendingConfig, max_bytes: u64) -> Self {
        Self {
            config,
            // The welcome states the window before the first batch is sent.
            window: 1,
            compression: CompressionControl::new(config.compression),
            flow: FlowControl::new(max_bytes),
            in_flight: InFlightBatches::default(),
            partial: None,
        }
    }

    /// Returns the next frame of the durable lane: batch `next` or its first part, a further part of the previous
    /// batch, or a request for an echo.
    pub(super) fn next(
        &mut self,
        next: u64,
        spooler: &mut EventSpooler,
        host: HostId,
        now: MonoTime,
    ) -> LaneOutput {
        let without_batch_start = |frame| LaneOutput { frame, starts_batch: false };
        let part_bytes = self.flow.part_bytes();
        let frame_bytes = |bytes: usize| bytes.min(part_bytes) + PartialBatch::OVERHEAD;
        if let Some(remaining) = self.partial.as_ref().map(PartialBatch::len) {
            // A batch that was begun is completed first, because the receiver assembles one batch per host at a time.
            let (is_waiting, starts_batch) = (!self.flow.has_capacity(frame_bytes(remaining)), false);
            let echo_request = self.request_echo(host, is_waiting, starts_batch, now);
            return without_batch_start(echo_request.or_else(|| self.next_part(host, part_bytes)));
        }
        let (through, include_unspooled) = spooler.sendable();
        let batch = spooler.backlog.get(next, include_unspooled).filter(|_| next <= through);
        let Some(body_bytes) = batch.map(|batch| batch.body.len()) else {
            // Nothing waits, so the link is faster than the events.
            self.compression.record_idle(self.flow.is_slow(), now);
            self.flow.clear_durable_share();
            return without_batch_start(self.request_echo_without_batch(host, now));
        };
        if self.in_flight.is_full(body_bytes, self.max_weight_in_flight()) {
            self.compression.record_full_window(now);
            self.flow.clear_durable_share();
            return without_batch_start(self.request_echo_without_batch(host, now));
        }
        let is_waiting = !self.flow.has_capacity(frame_bytes(body_bytes));
        if is_waiting {
            self.compression.record_full_window(now);
        }
        if let echo_request @ Some(_) = self.request_echo(host, is_waiting, !is_waiting, now) {
            return without_batch_start(echo_request);
        }
        // While the batch has to wait, only echo requests are sent: an echo frees the allowance.
        let sent = if is_waiting { None } else { spooler.send(next, include_unspooled, host) };
        let Some((head, body)) = sent else { return without_batch_start(None) };
        let frame = codec::encode_batch(&head, &body, self.compression.is_compressing());
        self.in_flight.push(head.number, body.len(), frame.len());
        self.partial = Some(PartialBatch::new(head.number, frame.into()));
        LaneOutput { frame: self.next_part(host, part_bytes), starts_batch: true }
    }

    /// Returns the next part of a batch if it fits into the allowance.
    fn next_part(&mut self, host: HostId, max_bytes: usize) -> Option<Vec<u8>> {
        let partial_batch = self.partial.as_mut()?;
        if !self.flow.has_capacity(partial_batch.len().min(max_bytes) + PartialBatch::OVERHEAD) {
            return None;
        }
        let frame = partial_batch.next(host, max_bytes);
        let end = self.flow.record_durable_sent(frame.len() as u64);
        if self.partial.take_if(|partial_batch| partial_batch.len() == 0).is_some() {
            self.in_flight.record_handed_over(end);
        }
        Some(frame)
    }

    /// Returns a request for an echo if one is due while the lane has no batch to hand over.
    fn request_echo_without_batch(&mut self, host: HostId, now: MonoTime) -> Option<Vec<u8>> {
        let (is_waiting, starts_batch) = (false, false);
        self.request_echo(host, is_waiting, starts_batch, now)
    }

    /// Returns a request for an echo if one is due. The arguments are those of [`FlowControl::request_echo`].
    fn request_echo(
        &mut self,
        host: HostId,
        is_waiting: bool,
        starts_batch: bool,
        now: MonoTime,
    ) -> Option<Vec<u8>> {
        let bytes = self.flow.request_echo(is_waiting, starts_batch, now)?;
        Some(codec::encode(&ToAggregator::Echo { host, bytes }))
    }

    /// Returns the maximum sum of the weights of the batches in flight. On a slow link this maximum is reduced, because
    /// batches that could not be stored must be sent over the link again.
    fn max_weight_in_flight(&self) -> u64 {
        let window = u64::from(self.window) * batch_weight(self.config.batch_bytes);
        if self.flow.is_slow() { window.min(UNSTORED_PER_ALLOWANCE * self.flow.allowance()) } else { window }
    }

    /// Resets the flow control for a new connection.
    pub(super) fn restart(&mut self) {
        self.flow.restart();
    }

    /// Marks everything in flight as not sent.
    pub(super) fn reset_in_flight(&mut self) {
        self.in_flight.remove_from(0);
        self.partial = None;
        self.compression.record_interruption();
    }

    /// Marks batches from a number on as not arrived.
    pub(super) fn mark_lost(&mut self, from: u64) {
        self.in_flight.remove_from(from);
        self.partial.take_if(|partial| partial.number() >= from);
    }

    /// Records that batches up to a number are stored.
    pub(super) fn record_ack(&mut self, through: u64, now: MonoTime) {
        let (bytes, end) = self.in_flight.remove_through(through);
        self.compression.record_ack(bytes, now);
        self.flow.record_arrival(end, now);
        // If the batch that is being sent is stored already, its remaining parts need not be sent.
        self.partial.take_if(|partial| partial.number() <= through);
    }

    /// Sets the window that the aggregator allows.
    pub(super) fn set_window(&mut self, window: u32) {
        // The window is at least one batch: with a window of 0, no batch would ever be sent again.
        self.window = window.clamp(1, self.config.window.max(1));
    }

    /// Records an echo.
    pub(super) fn record_echo(&mut self, bytes: u64, now: MonoTime) {
        self.flow.record_echo(bytes, now);
        if self.flow.is_slow() {
            self.compression.record_slow_link();
        }
    }

    /// Records the round trip of a message that was answered at once.
    pub(super) fn observe_round_trip(&mut self, span: Span, now: MonoTime) {
        self.flow.observe_round_trip(span, now);
    }

    /// Returns the time at which a missing echo is requested again.
    pub(super) fn echo_retry_at(&self) -> Option<MonoTime> {
        self.flow.echo_retry_at()
    }

    /// Returns the time at which bytes of the durable lane last arrived.
    pub(super) const fn last_arrival_at(&self) -> MonoTime {
        self.flow.last_arrival_at()
    }

    /// Returns whether the live lane may hand over an update.
    pub(super) const fn may_send_live(&self) -> bool {
        self.flow.may_send_live()
    }

    /// Records that the live lane handed over bytes.
    pub(super) const fn record_live_sent(&mut self, bytes: u64) {
        self.flow.record_live_sent(bytes);
    }

    /// Returns whether messages should be compressed.
    pub(super) const fn is_compressing(&self) -> bool {
        self.compression.is_compressing()
    }
}
