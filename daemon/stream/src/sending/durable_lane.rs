//! What the durable lane hands over next, and what both lanes may have on their way.

use peernet_clock::{MonoTime, Span};
use peernet_logger::HostId;

use super::SendingConfig;
use super::flow::FlowControl;
use super::in_flight_batches::InFlightBatches;
use super::pace::Pace;
use super::partial_batch::PartialBatch;
use super::spooler::EventSpooler;
use crate::{ToAggregator, batch_weight, codec};

/// What may be under way and not stored, in units of what may be on the way: enough for a store that takes its time and
/// for what compression saves.
const UNSTORED: u64 = 8;

/// The batches on their way to the aggregator.
#[derive(Clone, Debug)]
pub(super) struct DurableLane {
    config: SendingConfig,
    /// What may be under way, in units of batches, by the aggregator's word.
    window: u32,
    pace: Pace,
    flow: FlowControl,
    in_flight: InFlightBatches,
    /// What is left of the batch that was sent last.
    partial: Option<PartialBatch>,
}

/// What the lane hands over.
#[derive(Clone, Debug, Default)]
pub(super) struct LaneOutput {
    pub(super) frame: Option<Vec<u8>>,
    /// Whether it begins a batch.
    pub(super) begins: bool,
}

impl DurableLane {
    /// Nothing is on its way; no more than `most` bytes ever will be.
    pub(super) fn new(config: SendingConfig, most: u64) -> Self {
        Self {
            config,
            window: 1,
            pace: Pace::new(config.compression),
            flow: FlowControl::new(most),
            in_flight: InFlightBatches::default(),
            partial: None,
        }
    }

    /// The next of the durable lane: batch `next` or a part of the one before it, or a question how it goes.
    pub(super) fn next(
        &mut self,
        next: u64,
        spooler: &mut EventSpooler,
        host: HostId,
        now: MonoTime,
    ) -> LaneOutput {
        let only = |frame| LaneOutput { frame, begins: false };
        let part = self.flow.part();
        let fits = |bytes: usize| bytes.min(part) + PartialBatch::OVERHEAD;
        if let Some(rest) = self.partial.as_ref().map(PartialBatch::len) {
            let question = self.ask(host, !self.flow.has_room(fits(rest)), false, now);
            return only(question.or_else(|| self.part(host, part)));
        }
        let (through, unspooled) = spooler.sendable();
        let batch = spooler.backlog.get(next, unspooled).filter(|_| next <= through);
        let Some(body) = batch.map(|batch| batch.body.len()) else {
            self.pace.is_idle(self.flow.is_slow(), now);
            self.flow.is_spared();
            return only(self.ask(host, false, false, now));
        };
        if self.in_flight.is_full(body, self.allowance()) {
            self.pace.is_full(now);
            self.flow.is_spared();
            return only(self.ask(host, false, false, now));
        }
        let waits = !self.flow.has_room(fits(body));
        if waits {
            self.pace.is_full(now);
        }
        if let question @ Some(_) = self.ask(host, waits, !waits, now) {
            return only(question);
        }
        let sent = if waits { None } else { spooler.send(next, unspooled, host) };
        let Some((head, body)) = sent else { return only(None) };
        let frame = codec::batch_frame(&head, &body, self.pace.compresses());
        self.in_flight.push(head.number, body.len(), frame.len());
        self.partial = Some(PartialBatch::new(head.number, frame.into()));
        LaneOutput { frame: self.part(host, part), begins: true }
    }

    /// The next part of a batch, if there is room for it on the way.
    fn part(&mut self, host: HostId, most: usize) -> Option<Vec<u8>> {
        let rest = self.partial.as_mut()?;
        if !self.flow.has_room(rest.len().min(most) + PartialBatch::OVERHEAD) {
            return None;
        }
        let frame = rest.next(host, most);
        let end = self.flow.hand_over(frame.len() as u64);
        if self.partial.take_if(|rest| rest.len() == 0).is_some() {
            self.in_flight.handed_over(end);
        }
        Some(frame)
    }

    /// Asks how long the way is, when that is due.
    fn ask(&mut self, host: HostId, waits: bool, begins: bool, now: MonoTime) -> Option<Vec<u8>> {
        let bytes = self.flow.ask(waits, begins, now)?;
        Some(codec::encode(&ToAggregator::Echo { host, bytes }))
    }

    /// What may be under way and not stored, by weight: what is not stored in the end has to cross a slow link again.
    fn allowance(&self) -> u64 {
        let window = u64::from(self.window) * batch_weight(self.config.batch_bytes);
        if self.flow.is_slow() { window.min(UNSTORED * self.flow.allowance()) } else { window }
    }

    /// The connection is another.
    pub(super) fn restart(&mut self) {
        self.flow.restart();
    }

    /// What is under way counts as not sent.
    pub(super) fn take_back(&mut self) {
        self.in_flight.lost(0);
        self.partial = None;
        self.pace.interrupted();
    }

    /// Batches from this one on did not arrive.
    pub(super) fn lost(&mut self, from: u64) {
        self.in_flight.lost(from);
        self.partial.take_if(|rest| rest.number() >= from);
    }

    /// Batches up to this one are stored.
    pub(super) fn acknowledged(&mut self, through: u64, now: MonoTime) {
        let (bytes, end) = self.in_flight.acknowledged(through);
        self.pace.acknowledged(bytes, now);
        self.flow.arrived(end, now);
        self.partial.take_if(|rest| rest.number() <= through);
    }

    /// The aggregator allows so many batches under way.
    pub(super) fn allowed(&mut self, window: u32) {
        self.window = window.clamp(1, self.config.window.max(1));
    }

    /// An echo came.
    pub(super) fn echoed(&mut self, bytes: u64, now: MonoTime) {
        self.flow.echoed(bytes, now);
        if self.flow.is_slow() {
            self.pace.is_slow();
        }
    }

    /// A message was answered at once: there and back took so long.
    pub(super) fn round_trip(&mut self, span: Span, now: MonoTime) {
        self.flow.round_trip(span, now);
    }

    /// When an echo that did not come is to be asked for again.
    pub(super) fn remind_at(&self) -> Option<MonoTime> {
        self.flow.remind_at()
    }

    /// When some of the lane's bytes last arrived.
    pub(super) const fn progress(&self) -> MonoTime {
        self.flow.progress()
    }

    /// Whether the live lane may hand over an update.
    pub(super) const fn may_show(&self) -> bool {
        self.flow.may_show()
    }

    /// The live lane handed over so many bytes.
    pub(super) const fn shown(&mut self, bytes: u64) {
        self.flow.shown(bytes);
    }

    /// Whether what is sent is to be compressed.
    pub(super) const fn compresses(&self) -> bool {
        self.pace.compresses()
    }
}
