//! What is asked of the spool, and what became of it.

use peernet_clock::{MonoTime, Span, Stamp};

use super::super::Chain;
use super::backlog::Freed;
use super::job::Job;
use super::{Action, Notice, Sending, StreamId};
use crate::spool::{SpoolState, SpooledBatch};
use crate::totals::{Reached, Totals};

/// Batches of one transaction, and their bytes, at most: what waits behind it is not kept waiting for long.
const MOST_APPENDED: usize = 256;
const MOST_APPENDED_BYTES: u64 = 4 << 20;

/// Batches that are stored over there are deleted together, when there are so many or after so long: a deletion is
/// a write, and the medium is often a memory card.
const MOST_UNDELETED: u64 = 64;
const DELETED_AFTER: Span = Span::from_seconds(1);

/// How often it is written down how much was dropped, while nothing else is written.
const LOSSES_EVERY: Span = Span::from_seconds(1);

/// The file, as far as it is known, and the work under way on it.
#[derive(Clone, Debug)]
pub(super) struct Spooling {
    /// Bytes of the bodies in the file.
    pub(super) bytes: u64,
    /// Up to and including this number nothing is in the file.
    deleted: u64,
    /// Bytes in the file of what is stored over there, and since when there are such.
    undeleted: (u64, Option<MonoTime>),
    /// The totals that were last written.
    pub(super) written: Totals,
    append: Job<Appending>,
    delete: Job<Deleting>,
    pub(super) load: Job<Loading>,
    renew: Job<StreamId>,
    trouble: Option<(Kind, String)>,
    /// Whether the last attempt to append failed.
    degraded: bool,
    /// Batches were refused: how much was dropped is written down by itself before they are tried again.
    refused: bool,
    /// When something was last to be written.
    begun: MonoTime,
}

/// A transaction under way.
#[derive(Clone, Debug)]
struct Appending {
    last: Option<(u64, Chain)>,
    bytes: u64,
    /// Of those, bytes of batches that were stored over there meanwhile.
    freed: u64,
    /// What is counted up to the last of them, without what [`Totals::with`] adds.
    totals: Totals,
    resolves: bool,
}

#[derive(Clone, Debug)]
struct Deleting {
    through: (u64, Chain),
    bytes: u64,
}

/// Why batches are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Loading {
    /// To be sent, from this number on.
    Ahead(u64),
    /// To be compared and counted.
    Skim(u64),
    /// To find the end of a hole.
    Probe(u64),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Append,
    Delete,
    Load,
    Renew,
}

impl Spooling {
    pub(super) fn new(spool: &SpoolState, deleted: u64, totals: Totals) -> Self {
        Self {
            bytes: spool.held.bytes,
            deleted,
            undeleted: (0, None),
            written: totals,
            append: Job::default(),
            delete: Job::default(),
            load: Job::default(),
            renew: Job::default(),
            trouble: None,
            degraded: false,
            refused: false,
            begun: MonoTime::default(),
        }
    }

    pub(super) fn trouble(&self) -> Option<String> {
        self.trouble.as_ref().map(|(_, reason)| reason.clone())
    }

    pub(super) const fn fails_to_write(&self) -> bool {
        self.degraded
    }

    pub(super) const fn is_appending(&self) -> bool {
        self.append.is_under_way()
    }

    /// The newest batch that is being written; 0 when none is.
    pub(super) fn writing(&mut self) -> u64 {
        self.append.under_way().and_then(|appending| appending.last).map_or(0, |(number, _)| number)
    }

    /// Batches were stored over there.
    pub(super) fn freed(&mut self, freed: Freed, now: MonoTime) {
        if let Some(appending) = self.append.under_way() {
            appending.freed += freed.writing_bytes;
        }
        self.undeleted.0 += freed.spooled_bytes;
        self.undeleted.1.get_or_insert(now);
    }

    /// Batches in the file are given up.
    pub(super) fn skipped(&mut self, now: MonoTime) {
        self.undeleted.1.get_or_insert(now);
    }

    /// So many bytes are not in the file after all.
    pub(super) const fn vanished(&mut self, bytes: u64) {
        self.bytes = self.bytes.saturating_sub(bytes);
    }
}

impl Sending {
    /// The batches of the last [`Action::Append`] are in the spool.
    pub fn appended(&mut self, now: Stamp) -> Option<Notice> {
        let appending = self.spooling.append.end()?;
        let reached = appending.totals.reached.or(self.spooling.written.reached);
        self.spooling.written = Totals { reached, ..appending.totals };
        if appending.resolves {
            self.resolution_written();
        }
        if let Some((last, chain)) = appending.last {
            self.backlog.appended(last, chain);
            self.spooling.bytes += appending.bytes;
            self.spooling.undeleted.0 += appending.freed;
        }
        // That there was room for a few numbers says nothing of the batches that wait for it.
        if appending.last.is_some() || !self.spooling.degraded || self.backlog.pending().events == 0 {
            self.spooling.degraded = false;
            self.recovered(Kind::Append);
        }
        let room = self.room();
        self.intake.report_losses(&room, now);
        self.number();
        self.notice()
    }

    /// They are not, none of them.
    pub fn append_failed(&mut self, reason: String, now: Stamp) -> Option<Notice> {
        self.spooling.refused = self.spooling.append.end()?.last.is_some();
        self.spooling.append.fail(now.mono, self.config.spool_pause);
        self.spooling.degraded = true;
        self.failed(Kind::Append, reason)
    }

    /// What [`Action::Load`] asked for; a batch that was not found ends the list.
    pub fn loaded(&mut self, batches: Vec<SpooledBatch>, now: Stamp) -> Option<Notice> {
        let loading = self.spooling.load.end()?;
        self.recovered(Kind::Load);
        match loading {
            Loading::Skim(from) => self.skimmed(from, &batches, now),
            Loading::Probe(from) => self.probed(from, &batches, now),
            Loading::Ahead(from) => self.read_ahead(from, batches, now),
        }
        self.notice()
    }

    /// It could not be read.
    pub fn load_failed(&mut self, reason: String, now: Stamp) -> Option<Notice> {
        self.spooling.load.end()?;
        self.spooling.load.fail(now.mono, self.config.spool_pause);
        self.failed(Kind::Load, reason)
    }

    /// The batches of the last [`Action::Delete`] are gone.
    pub fn deleted(&mut self) {
        let Some(Deleting { through, bytes }) = self.spooling.delete.end() else { return };
        self.spooling.deleted = through.0;
        self.spooling.bytes = self.spooling.bytes.saturating_sub(bytes);
        self.backlog.passed(through.0, through.1);
        self.recovered(Kind::Delete);
    }

    /// They are not.
    pub fn delete_failed(&mut self, reason: String, now: Stamp) -> Option<Notice> {
        let deleting = self.spooling.delete.end()?;
        self.spooling.undeleted.0 += deleting.bytes;
        self.spooling.undeleted.1.get_or_insert(now.mono);
        self.spooling.delete.fail(now.mono, self.config.spool_pause);
        self.failed(Kind::Delete, reason)
    }

    /// The spool belongs to the stream of the last [`Action::Renew`].
    pub fn renewed(&mut self, now: Stamp) {
        let Some(stream) = self.spooling.renew.end() else { return };
        self.renewal = None;
        self.backlog.renew(stream);
        // Nobody else ever sent in this stream.
        (self.met, self.reached_before) = (false, Vec::new());
        self.recovered(Kind::Renew);
        self.greet_again(now.mono);
    }

    /// It does not.
    pub fn renew_failed(&mut self, reason: String, now: Stamp) -> Option<Notice> {
        self.spooling.renew.end()?;
        self.spooling.renew.fail(now.mono, self.config.spool_pause);
        self.failed(Kind::Renew, reason)
    }

    fn failed(&mut self, kind: Kind, reason: String) -> Option<Notice> {
        if self.spooling.trouble.is_none() {
            self.spooling.trouble = Some((kind, reason.clone()));
            self.notices.push_back(Notice::SpoolFailed(reason));
        }
        self.notice()
    }

    fn recovered(&mut self, kind: Kind) {
        if self.spooling.trouble.take_if(|(failed, _)| *failed == kind).is_some() {
            self.notices.push_back(Notice::SpoolRecovered);
        }
    }

    pub(super) fn notice(&mut self) -> Option<Notice> {
        self.notices.pop_front()
    }

    /// The batches that may be sent up to which number, and whether that includes those in memory only.
    ///
    /// The file says beforehand which batches may be stored over there, in case it loses what is written later. While
    /// it cannot be written, what is in it is sent all the same: a disk that is full of batches would never have room
    /// again. What is not in it is sent only if there is nothing in the file of which that is not known.
    pub(super) fn sendable(&self) -> (u64, bool) {
        match self.spooling.degraded {
            false => (self.spooling.written.reached.map_or(0, |reached| reached.number), false),
            true if self.is_marked() => (u64::MAX, true),
            true => (self.backlog.spooled(), false),
        }
    }

    /// The next work on the spool.
    pub(super) fn spool_action(&mut self, now: MonoTime) -> Option<Action> {
        self.deletion(now).or_else(|| self.append(now)).or_else(|| self.renew(now)).or_else(|| self.load(now))
    }

    /// When there is work on the spool without anything else happening.
    pub(super) fn spool_deadline(&self) -> Option<MonoTime> {
        let spooling = &self.spooling;
        let deletion =
            self.may_delete().then(|| spooling.undeleted.1.map(|since| since + DELETED_AFTER)).flatten();
        let again =
            [spooling.append.again(), spooling.delete.again(), spooling.load.again(), spooling.renew.again()];
        again.into_iter().chain([deletion, self.losses_due()]).flatten().min()
    }

    /// Whether something is to be deleted, sooner or later.
    fn may_delete(&self) -> bool {
        let (through, _) = self.backlog.acknowledged();
        // What is being written may not be there yet.
        let settled = through <= self.backlog.spooled() || !self.spooling.append.is_under_way();
        through > self.spooling.deleted
            && settled
            && !self.spooling.delete.is_under_way()
            && self.spooling.delete.again().is_none()
    }

    fn deletion(&mut self, now: MonoTime) -> Option<Action> {
        if !(self.spooling.delete.is_free(now) && self.may_delete()) {
            return None;
        }
        let (through, chain) = self.backlog.acknowledged();
        let soon = self.is_behind() || self.renewal.is_some() || self.closing;
        let many = through - self.spooling.deleted >= MOST_UNDELETED
            || self.spooling.undeleted.0 >= self.config.spool_bytes / 4;
        let late = self.spooling.undeleted.1.is_none_or(|since| now - since >= DELETED_AFTER);
        (soon || many || late).then(|| {
            let (bytes, _) = std::mem::take(&mut self.spooling.undeleted);
            self.spooling.delete.begin(Deleting { through: (through, chain), bytes });
            Action::Delete { through, chain }
        })
    }

    /// Whether batches were stored over there that never came into the file. What follows them is not written before
    /// the file knows that they are gone, or it would have a hole.
    fn is_behind(&self) -> bool {
        self.backlog.acknowledged().0 > self.backlog.spooled()
    }

    fn append(&mut self, now: MonoTime) -> Option<Action> {
        if !self.spooling.append.is_free(now) || self.is_behind() {
            return None;
        }
        let (batches, totals) = self.to_append(now)?;
        let last = batches.last().map(|batch| (batch.number, batch.chain));
        let bytes = batches.iter().map(|batch| batch.body.len() as u64).sum();
        (self.spooling.begun, self.spooling.refused) = (now, false);
        let unreported = self.earlier.unwritten().cloned();
        let resolves = unreported.is_some();
        self.spooling.append.begin(Appending { last, bytes, freed: 0, totals: totals.clone(), resolves });
        let totals = Totals { unreported, ..totals.with(self.earlier.resolved()) };
        Some(Action::Append { batches, totals })
    }

    /// What is to be written now.
    fn to_append(&self, now: MonoTime) -> Option<(Vec<SpooledBatch>, Totals)> {
        let (written, spooled) = (&self.spooling.written, self.backlog.spooled());
        let resolves = self.earlier.unwritten().is_some();
        if resolves || self.met && !self.is_marked() {
            let reached = self.reaches(spooled).filter(|_| self.met);
            return Some((Vec::new(), Totals { reached, ..written.clone() }));
        }
        if self.spooling.refused && self.intake.counted().dropped != written.dropped {
            return Some((Vec::new(), self.safe_totals()));
        }
        let Some((batches, totals)) = self.backlog.to_append(MOST_APPENDED, MOST_APPENDED_BYTES) else {
            let due = self.closing || self.losses_due().is_some_and(|due| now >= due);
            let totals = due.then(|| self.safe_totals()).filter(|totals| totals != written);
            return totals.map(|totals| (Vec::new(), totals));
        };
        // Before the aggregator is met nothing can be sent.
        let newest = batches.last().map_or(spooled, |batch| batch.number);
        let reached = self.reaches(newest).filter(|_| self.met);
        Some((batches, Totals { reached, ..totals }))
    }

    /// When to write down how much was dropped: a full spool takes no batch that would say so.
    fn losses_due(&self) -> Option<MonoTime> {
        let untold = self.intake.counted().dropped != self.spooling.written.dropped;
        (untold && !self.spooling.append.is_under_way()).then(|| self.spooling.begun + LOSSES_EVERY)
    }

    fn reaches(&self, number: u64) -> Option<Reached> {
        Some(Reached { process: self.process, number })
    }

    /// Whether the file says of everything in it that this process may send it.
    fn is_marked(&self) -> bool {
        self.spooling.written.reached.is_some_and(|reached| reached.number >= self.backlog.spooled())
    }

    fn renew(&mut self, now: MonoTime) -> Option<Action> {
        let stream = self.renewal?;
        let (through, _) = self.backlog.acknowledged();
        // What the new stream does not hold is gone before; and what the old one says of an earlier process is known.
        let waits = through > self.spooling.deleted || self.earlier.unwritten().is_some();
        if waits || !self.spooling.renew.is_free(now) {
            return None;
        }
        self.spooling.renew.begin(stream);
        Some(Action::Renew {
            stream,
            previous: self.backlog.origin.stream,
            first: self.backlog.oldest(),
            events_before_first: self.backlog.stored(),
        })
    }
}
