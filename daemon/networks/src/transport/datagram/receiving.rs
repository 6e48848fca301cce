//! The receiving half of a virtual connection: fragments that arrive, and reports about them to the other end.

mod watermark;

use std::sync::Arc;

use bytes::Bytes;
use peernet_clock::{MonoTime, Span};

use self::watermark::SentWatermark;
use super::false_claim::FalseClaim;
use super::packet::{Fragment, Packet};
use super::reassembly::{LostMessage, MAX_SPAN, Reassembly, ReassemblyLimits, ReassemblyOutcome};
use super::sending::decode_tag;
use super::window::PROGRESS_INTERVAL_BYTES;
use crate::transport::MessageLoss;
use crate::transport::memory::{MemoryBudget, Reservation};

/// Maximum number of lost messages whose loss the other end has not confirmed.
const MAX_LOSS_REPORTS: usize = MAX_SPAN as usize;

/// Maximum number of lost messages that are reported at once.
const MAX_REPORTS_AT_ONCE: usize = 32;

/// Maximum number of reports of one lost message.
const MAX_REPORT_ATTEMPTS: u32 = 12;

/// Interval after the first report. The interval doubles with each report, up to eight times this value.
const REPORT_INTERVAL: Span = Span::from_millis(50);

/// The receiving half of a connection.
#[derive(Debug)]
pub(crate) struct ReceivingHalf {
    connection: u64,
    reassembly: Reassembly,
    watermark: SentWatermark,
    /// Furthest end of a fragment since the last report of progress: message number, and offset of the end in the
    /// message. The furthest end is reset after each report, so that a number that was altered on the way is not kept.
    furthest_end: (u64, u32),
    /// Bytes that arrived since the last report of progress.
    unreported_bytes: u32,
    reports: Vec<LossReport>,
}

/// A lost message whose loss the other end has not confirmed.
#[derive(Debug)]
struct LossReport {
    lost: LostMessage,
    attempts: u32,
    next_at: MonoTime,
}

/// Outcome of a fragment.
#[derive(Debug)]
pub(crate) enum FragmentOutcome {
    /// A whole message, and the reservation of its memory.
    Message(Bytes, Reservation),
    /// No message is complete.
    Nothing,
    /// The fragment is invalid, for this reason.
    InvalidData(String),
}

impl ReceivingHalf {
    pub(crate) fn new(connection: u64, limits: ReassemblyLimits, budget: Arc<MemoryBudget>) -> Self {
        Self {
            connection,
            reassembly: Reassembly::new(limits, budget),
            watermark: SentWatermark::default(),
            furthest_end: (0, 0),
            unreported_bytes: 0,
            reports: Vec::new(),
        }
    }

    pub(crate) fn set_limits(&mut self, limits: ReassemblyLimits, budget: Arc<MemoryBudget>) {
        self.reassembly.set_limits(limits, budget);
    }

    /// Handles a fragment that arrived in the datagram with this number.
    pub(crate) fn receive(&mut self, number: u32, fragment: &Fragment<'_>, now: MonoTime) -> FragmentOutcome {
        // All earlier messages have been sent, because a sender sends one message after the other.
        self.record_claim(fragment.sequence, number.into(), now);
        let outcome = self.reassembly.receive(fragment, now);
        if !matches!(outcome, ReassemblyOutcome::TooFarAhead) {
            let end = fragment.offset + fragment.bytes.len() as u32;
            self.furthest_end = self.furthest_end.max((fragment.sequence, end));
            self.unreported_bytes = self.unreported_bytes.saturating_add(fragment.bytes.len() as u32);
        }
        match outcome {
            ReassemblyOutcome::Message { bytes, reserved } => FragmentOutcome::Message(bytes, reserved),
            ReassemblyOutcome::Stored | ReassemblyOutcome::Duplicate => FragmentOutcome::Nothing,
            ReassemblyOutcome::Inconsistent => {
                FragmentOutcome::InvalidData("a fragment that contradicts its message".into())
            }
            ReassemblyOutcome::TooFarAhead => {
                FragmentOutcome::InvalidData(FalseClaim::TooFarAhead.to_string())
            }
        }
    }

    /// Returns the report of progress if it is due.
    pub(crate) fn take_progress(&mut self) -> Option<Packet<'static>> {
        if self.unreported_bytes < PROGRESS_INTERVAL_BYTES {
            return None;
        }
        self.unreported_bytes = 0;
        // The end is reset, so that a number that was altered on the way is reported only once.
        let (sequence, end) = std::mem::take(&mut self.furthest_end);
        Some(Packet::Progress { connection: self.connection, sequence, end })
    }

    /// Handles a packet that says that the other end has sent all messages below `next`. This claim counts once a second
    /// packet confirms it. `packet` identifies the packet, so that a duplicate does not count as a second packet.
    ///
    /// # Errors
    /// If `next` is too far above the settled messages. The claim is nevertheless recorded and counts once it is
    /// confirmed.
    pub(crate) fn note_sent(&mut self, next: u64, packet: u64, now: MonoTime) -> Result<(), FalseClaim> {
        self.record_claim(next, packet, now);
        let limit = self.reassembly.floor().saturating_add(MAX_SPAN);
        if next <= limit { Ok(()) } else { Err(FalseClaim::TooFarAhead) }
    }

    /// Records that a packet says that the other end has sent all messages below `next`.
    fn record_claim(&mut self, next: u64, packet: u64, now: MonoTime) {
        if let Some((confirmed, since)) = self.watermark.claim(next, packet, now) {
            self.reassembly.note_sent(confirmed, since);
        }
    }

    /// Returns the number below which all messages are settled and the other end has confirmed the losses.
    pub(crate) fn settled_below(&self) -> u64 {
        let unconfirmed = self.reports.iter().map(|report| report.lost.sequence);
        unconfirmed.chain([self.reassembly.floor()]).min().unwrap_or_default()
    }

    /// Returns whether all messages are settled and the other end has confirmed all losses.
    pub(crate) fn is_settled(&self) -> bool {
        // The first goodbye may be the only packet so far that reports the last messages. No second packet has
        // confirmed its claim yet, so the unconfirmed claim counts here.
        let is_claim_settled = self.watermark.last_claimed_number() <= self.reassembly.floor();
        is_claim_settled && self.reassembly.is_settled() && self.reports.is_empty()
    }

    /// Gives up all unfinished messages, and all missing messages that are known to have been sent.
    pub(crate) fn give_up_all(&mut self) {
        self.reassembly.give_up_all();
    }

    /// Starts reports to the other end about the losses since the last call. Returns the losses of which the layer
    /// above can be informed at once: their tag is known, or will never be known.
    pub(crate) fn take_lost(&mut self, now: MonoTime) -> Vec<MessageLoss> {
        let lost_messages = self.reassembly.take_lost();
        let mut reportable_losses = Vec::new();
        for lost in lost_messages {
            // If no fragment has arrived, the tag is unknown here. The confirmation of the other end contains the tag.
            if let Some(tag) = lost.tag {
                reportable_losses.push(MessageLoss {
                    tag: decode_tag(tag),
                    received: lost.received,
                    total: lost.total,
                });
            }
            if self.reports.len() < MAX_LOSS_REPORTS {
                self.reports.push(LossReport { lost, attempts: 0, next_at: now });
            } else if lost.tag.is_none() {
                // Without a report, no confirmation will state the tag.
                reportable_losses.push(MessageLoss { tag: None, received: 0, total: 0 });
            }
        }
        reportable_losses
    }

    /// Handles the confirmation of a loss, which contains the tag of the message. Returns the loss for the layer above
    /// if its tag was unknown.
    pub(crate) fn confirm_loss(&mut self, sequence: u64, tag: u64, total: u32) -> Option<MessageLoss> {
        let index = self.reports.iter().position(|report| report.lost.sequence == sequence)?;
        let report = self.reports.swap_remove(index);
        report.lost.tag.is_none().then(|| MessageLoss { tag: decode_tag(tag), received: 0, total })
    }

    /// Gives up messages whose time limit has passed.
    pub(crate) fn tick(&mut self, now: MonoTime) {
        self.reassembly.tick(now);
    }

    /// Returns the reports of losses that are due, and the losses whose reports are given up.
    pub(crate) fn due_reports(&mut self, now: MonoTime) -> (Vec<Packet<'static>>, Vec<MessageLoss>) {
        let (mut packets, mut given_up) = (Vec::new(), Vec::new());
        let connection = self.connection;
        self.reports.retain_mut(|report| {
            if report.next_at > now || packets.len() >= MAX_REPORTS_AT_ONCE {
                return true;
            }
            let LostMessage { sequence, tag, received, total } = report.lost;
            if report.attempts >= MAX_REPORT_ATTEMPTS {
                // The layer above has already been informed of a loss whose tag is known.
                if tag.is_none() {
                    given_up.push(MessageLoss { tag: None, received, total });
                }
                return false;
            }
            packets.push(Packet::Lost { connection, sequence, received, total });
            report.next_at = now + Span::from_nanos(REPORT_INTERVAL.nanos() << report.attempts.min(3));
            report.attempts += 1;
            true
        });
        (packets, given_up)
    }

    /// Returns the time at which a message may have to be given up, or at which a loss must be reported. `tick` is the
    /// interval at which unfinished messages are checked.
    pub(crate) fn next_timer(&self, now: MonoTime, tick: Span) -> Option<MonoTime> {
        let next_tick = (!self.reassembly.is_settled()).then(|| now + tick);
        self.reports.iter().map(|report| report.next_at).chain(next_tick).min()
    }
}
