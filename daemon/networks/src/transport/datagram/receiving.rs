//! The receiving half of a virtual connection: arrivals, and the reports of them to the other end.

mod watermark;

use std::sync::Arc;

use bytes::Bytes;
use peernet_clock::{MonoTime, Span};

use self::watermark::SentWatermark;
use super::false_claim::FalseClaim;
use super::packet::{Fragment, Packet};
use super::reassembly::{LostMessage, MAX_SPAN, Reassembly, ReassemblyLimits, ReassemblyOutcome};
use super::sending::read_tag;
use super::window::PROGRESS_BYTES;
use crate::transport::MessageLoss;
use crate::transport::memory::{MemoryBudget, Reservation};

/// Largest number of lost messages that the other end does not know of.
const MAX_REPORTS: usize = MAX_SPAN as usize;

/// Largest number of lost messages that are reported at once.
const REPORTS_AT_ONCE: usize = 32;

/// Largest number of reports of one lost message.
const REPORT_TRIES: u32 = 12;

/// Pause after the first report. It doubles up to eight times this value.
const REPORT_PAUSE: Span = Span::from_millis(50);

/// The receiving half of a connection.
#[derive(Debug)]
pub(crate) struct ReceivingHalf {
    connection: u64,
    reassembly: Reassembly,
    watermark: SentWatermark,
    /// Furthest end of a fragment since the last report of progress: message number, and offset of the end in the
    /// message. It is reset after each report, so that a number that was altered on the way is not kept.
    furthest: (u64, u32),
    /// Bytes that arrived since the last report of progress.
    untold: u32,
    reports: Vec<Report>,
}

/// A lost message whose loss the other end has not confirmed.
#[derive(Debug)]
struct Report {
    lost: LostMessage,
    tries: u32,
    next: MonoTime,
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
            furthest: (0, 0),
            untold: 0,
            reports: Vec::new(),
        }
    }

    pub(crate) fn set_limits(&mut self, limits: ReassemblyLimits, budget: Arc<MemoryBudget>) {
        self.reassembly.set_limits(limits, budget);
    }

    /// Handles a fragment that arrived in the datagram with this number.
    pub(crate) fn receive(&mut self, number: u32, fragment: &Fragment<'_>, now: MonoTime) -> FragmentOutcome {
        // All earlier messages have been sent, because a sender sends one message after the other.
        self.claim(fragment.sequence, number.into(), now);
        let received = self.reassembly.receive(fragment, now);
        if !matches!(received, ReassemblyOutcome::TooFarAhead) {
            let end = fragment.offset + fragment.bytes.len() as u32;
            self.furthest = self.furthest.max((fragment.sequence, end));
            self.untold = self.untold.saturating_add(fragment.bytes.len() as u32);
        }
        match received {
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
    pub(crate) fn progress(&mut self) -> Option<Packet<'static>> {
        if self.untold < PROGRESS_BYTES {
            return None;
        }
        self.untold = 0;
        // Reset, so that a number that was altered on the way goes into one report only.
        let (sequence, end) = std::mem::take(&mut self.furthest);
        Some(Packet::Progress { connection: self.connection, sequence, end })
    }

    /// Handles the claim of a packet that the other end has sent all messages below `next`. `packet` identifies the
    /// packet.
    ///
    /// # Errors
    /// If the number is too far above those that are known to have been sent. The next packet may confirm it.
    pub(crate) fn expect(&mut self, next: u64, packet: u64, now: MonoTime) -> Result<(), FalseClaim> {
        self.claim(next, packet, now);
        let most = self.reassembly.floor().saturating_add(MAX_SPAN);
        if next <= most { Ok(()) } else { Err(FalseClaim::TooFarAhead) }
    }

    /// Notes that a packet claims that all messages below `next` have been sent.
    fn claim(&mut self, next: u64, packet: u64, now: MonoTime) {
        if let Some((confirmed, since)) = self.watermark.claim(next, packet, now) {
            self.reassembly.expect(confirmed, since);
        }
    }

    /// Returns the number below which all messages are settled and the other end knows which of them are lost.
    pub(crate) fn settled(&self) -> u64 {
        let unknown = self.reports.iter().map(|report| report.lost.sequence);
        unknown.chain([self.reassembly.floor()]).min().unwrap_or_default()
    }

    /// Returns whether no message is awaited and the other end knows the losses.
    pub(crate) fn is_settled(&self) -> bool {
        // The last messages before a goodbye may be claimed by the goodbye alone.
        let is_known = self.watermark.claimed() <= self.reassembly.floor();
        is_known && self.reassembly.is_settled() && self.reports.is_empty()
    }

    /// Gives up all awaited messages.
    pub(crate) fn give_up_all(&mut self) {
        self.reassembly.give_up_all();
    }

    /// Starts to report the losses since the last call to the other end. Returns those that can be passed on here at
    /// once.
    pub(crate) fn take_lost(&mut self, now: MonoTime) -> Vec<MessageLoss> {
        let lost = self.reassembly.take_lost();
        let mut known = Vec::new();
        for lost in lost {
            // If no fragment has arrived, the tag is unknown here. The confirmation of the other end brings it.
            if let Some(tag) = lost.tag {
                known.push(MessageLoss { tag: read_tag(tag), received: lost.received, total: lost.total });
            }
            if self.reports.len() < MAX_REPORTS {
                self.reports.push(Report { lost, tries: 0, next: now });
            } else if lost.tag.is_none() {
                known.push(MessageLoss { tag: None, received: 0, total: 0 });
            }
        }
        known
    }

    /// Handles the confirmation of a loss, which says which message it was. Returns the loss to be passed on here, if
    /// it was unknown.
    pub(crate) fn known(&mut self, sequence: u64, tag: u64, total: u32) -> Option<MessageLoss> {
        let at = self.reports.iter().position(|report| report.lost.sequence == sequence)?;
        let report = self.reports.swap_remove(at);
        report.lost.tag.is_none().then(|| MessageLoss { tag: read_tag(tag), received: 0, total })
    }

    /// Gives up messages that have waited too long.
    pub(crate) fn tick(&mut self, now: MonoTime) {
        self.reassembly.tick(now);
    }

    /// Returns the reports of losses that are due, and the losses whose reports are given up.
    pub(crate) fn reports(&mut self, now: MonoTime) -> (Vec<Packet<'static>>, Vec<MessageLoss>) {
        let (mut packets, mut silent) = (Vec::new(), Vec::new());
        let connection = self.connection;
        self.reports.retain_mut(|report| {
            if report.next > now || packets.len() >= REPORTS_AT_ONCE {
                return true;
            }
            let LostMessage { sequence, tag, received, total } = report.lost;
            if report.tries >= REPORT_TRIES {
                if tag.is_none() {
                    silent.push(MessageLoss { tag: None, received, total });
                }
                return false;
            }
            packets.push(Packet::Lost { connection, sequence, received, total });
            report.next = now + Span::from_nanos(REPORT_PAUSE.nanos() << report.tries.min(3));
            report.tries += 1;
            true
        });
        (packets, silent)
    }

    /// Returns the time at which a message is to be given up or reported.
    pub(crate) fn next_timer(&self, now: MonoTime, tick: Span) -> Option<MonoTime> {
        let waiting = (!self.reassembly.is_settled()).then(|| now + tick);
        self.reports.iter().map(|report| report.next).chain(waiting).min()
    }
}
