//! From events to numbered batches that are safe in the spool until they are stored over there.

use bytes::Bytes;
use peernet_clock::{MonoTime, Stamp, WallTime};
use peernet_logger::{HostId, RunId};

use super::appends::Appends;
use super::backlog::Backlog;
use super::deletions::Deletions;
use super::earlier_process::EarlierProcess;
use super::intake::{Intake, Room};
use super::spool_reader::ScanResult;
use super::{Action, SendingConfig};
use crate::spool::{SpoolState, SpooledBatch};
use crate::totals::{Reached, Totals};
use crate::{Accounting, BatchHead, Chain, Event, Gap, HandedIn, SentUnspooled, StreamId};

/// Batches of one transaction, and their bytes, at most: what waits behind it is not kept waiting for long.
const MOST_APPENDED: usize = 256;
const MOST_APPENDED_BYTES: u64 = 4 << 20;

/// Takes in events, numbers their batches, and says what is to be written to the spool and deleted from it.
#[derive(Clone, Debug)]
pub(super) struct EventSpooler {
    config: SendingConfig,
    process: u64,
    intake: Intake,
    pub(super) backlog: Backlog,
    appends: Appends,
    deletions: Deletions,
    /// Bytes of the bodies in the file.
    file_bytes: u64,
    /// What became of the end of an earlier process.
    earlier: EarlierProcess,
    /// Whether the aggregator took this process in with the stream at hand.
    is_met: bool,
    /// Whether everything is to be made safe now.
    is_closing: bool,
}

impl EventSpooler {
    /// Goes on from what the spool holds; `budget` bytes of batches are kept in memory to be sent.
    pub(super) fn new(config: SendingConfig, process: u64, budget: u64, spool: SpoolState) -> Self {
        let backlog = Backlog::new(&spool, budget);
        let Totals { produced, dropped, .. } = spool.totals;
        // What is held was produced, whatever the file says.
        let produced = produced.max(dropped.saturating_add(backlog.held().events));
        let totals =
            Totals { produced, reached: None, handed_in: HandedIn::default(), ..spool.totals.clone() };
        Self {
            appends: Appends::new(totals.clone()),
            deletions: Deletions::new(backlog.acknowledged().0),
            file_bytes: spool.held.bytes,
            intake: Intake::new(config, totals, spool.unreported, spool.unresolved.is_some()),
            backlog,
            earlier: EarlierProcess::new(spool.unresolved),
            is_met: false,
            is_closing: false,
            config,
            process,
        }
    }

    /// The number that this process made at its start.
    pub(super) const fn process(&self) -> u64 {
        self.process
    }

    pub(super) fn offer(&mut self, event: &Event, now: Stamp) {
        let room = self.room();
        self.intake.offer(event, &room, now);
        self.number();
    }

    pub(super) fn lost(&mut self, gap: &Gap, now: Stamp) {
        self.intake.lost(gap, now);
    }

    pub(super) fn tick(&mut self, now: Stamp) {
        let room = self.room();
        self.intake.tick(&room, now);
        self.number();
    }

    pub(super) fn flush(&mut self, now: WallTime) {
        let room = self.room();
        self.intake.flush(&room, now);
        self.number();
        self.is_closing = true;
    }

    /// When something is to be cut, reported, written or deleted without anything else happening.
    pub(super) fn deadline(&self) -> Option<MonoTime> {
        let deletion = self.may_delete().then(|| self.deletions.due_at()).flatten();
        let writes = [self.appends.again(), self.deletions.again(), deletion, self.losses_due()];
        writes.into_iter().chain([self.intake.deadline(&self.room())]).flatten().min()
    }

    pub(super) fn give_up(&mut self) -> Totals {
        let lost = self.backlog.give_up();
        self.intake.give_up(lost, &self.backlog.settled().handed_in.taken);
        let unreported = self.earlier.unwritten().cloned();
        Totals { unreported, ..self.safe_totals().with(self.earlier.resolved()) }
    }

    /// Whether a write is under way that may make something safe.
    pub(super) const fn is_appending(&self) -> bool {
        self.appends.is_under_way()
    }

    /// Whether something was sent that may be stored, although it is neither in the spool nor acknowledged.
    pub(super) fn has_sent_unspooled(&self) -> bool {
        self.backlog.sent() > self.backlog.spooled().max(self.backlog.oldest() - 1)
    }

    /// Events that are in memory only.
    pub(super) fn unspooled_events(&self) -> u64 {
        self.intake.usage().events + self.backlog.pending().events
    }

    /// Whether everything that was taken in is stored.
    pub(super) fn is_idle(&self) -> bool {
        self.intake.usage().events == 0 && self.backlog.held().events == 0
    }

    pub(super) fn accounting(&self, compressed: bool, trouble: Option<String>) -> Accounting {
        let (open, held, pending) = (self.intake.usage(), self.backlog.held(), self.backlog.pending());
        let (produced, dropped) = self.earlier.count(self.intake.counted());
        let gaps = self.intake.counted().gaps;
        let (waiting, stored) = (open.events + held.events, self.backlog.stored());
        debug_assert_eq!(produced, stored + waiting + dropped, "an event is not accounted for");
        Accounting {
            produced,
            spooled: stored + held.events.saturating_sub(pending.events),
            sent: stored + self.backlog.sent_events(),
            stored,
            waiting,
            dropped,
            gaps,
            spool_bytes: self.file_bytes,
            spool_limit_bytes: self.config.spool_bytes,
            memory_bytes: open.bytes + pending.bytes,
            oldest: if held.events > 0 { self.backlog.since() } else { self.intake.since() },
            compressed,
            trouble,
        }
    }

    pub(super) fn settled_runs(&self) -> Vec<(RunId, u64)> {
        let events = |handed_in: &HandedIn, run| handed_in.taken.of(run) + handed_in.dropped.of(run);
        let (counted, written) = (&self.intake.counted().handed_in, &self.appends.written().handed_in);
        let ended = self.intake.ended().iter().map(|run| (*run, events(counted, *run)));
        ended.filter(|(run, count)| events(written, *run) == *count).collect()
    }

    #[cfg(test)]
    pub(super) fn has_reported_all(&self) -> bool {
        self.intake.has_reported_all()
    }

    pub(super) const fn settled_events(&self) -> u64 {
        let handed_in = &self.appends.written().handed_in;
        handed_in.taken.all + handed_in.dropped.all
    }

    pub(super) fn sent_unspooled(&self) -> Option<SentUnspooled> {
        self.backlog.sent_unspooled().map(|sent| self.earlier.place(sent))
    }

    pub(super) fn forget_run(&mut self, run: RunId) {
        self.intake.forget_run(run);
    }

    /// What was counted, without what is in memory only: true also when that is lost.
    fn safe_totals(&self) -> Totals {
        let (counted, settled) = (self.intake.counted(), self.backlog.settled());
        let only_here = self.unspooled_events();
        let handed_in = HandedIn { dropped: counted.handed_in.dropped.clone(), ..settled.handed_in.clone() };
        Totals {
            produced: counted.produced - only_here,
            dropped: counted.dropped,
            gaps: settled.gaps,
            told: settled.told,
            handed_in,
            reached: self.appends.written().reached,
            unreported: None,
        }
    }

    /// Numbers what was cut.
    fn number(&mut self) {
        for cut in self.intake.take_cut() {
            self.backlog.push(cut);
        }
    }

    /// What may still be taken in.
    fn room(&self) -> Room {
        let pending = self.backlog.pending();
        Room {
            memory: self.config.memory - pending,
            spool_bytes: self
                .config
                .spool_bytes
                .saturating_sub(self.file_bytes)
                .saturating_sub(pending.bytes),
            spool_fails: self.appends.fails(),
        }
    }

    fn report_losses(&mut self, now: Stamp) {
        let room = self.room();
        self.intake.report_losses(&room, now);
        self.number();
    }

    /// All batches up to and including `through` are stored over there.
    pub(super) fn acknowledged(&mut self, through: u64, scanned: Option<ScanResult>, now: Stamp) {
        let writing = self.appends.writing();
        let freed = self.backlog.free(through, scanned, writing);
        self.appends.add_freed(freed.writing_bytes);
        self.deletions.add(freed.spooled_bytes, now.mono);
        self.report_losses(now);
    }

    /// The aggregator took this process in with the stream at hand.
    pub(super) const fn meet(&mut self) {
        self.is_met = true;
    }

    /// The batches that are held go on in a new stream.
    pub(super) const fn renew(&mut self, stream: StreamId) {
        self.backlog.renew(stream);
        self.is_met = false;
    }

    /// Whether the spool may be given to a new stream: what that does not hold is gone, and what the old one says of an
    /// earlier process is known.
    pub(super) fn may_renew(&self) -> bool {
        self.backlog.acknowledged().0 <= self.deletions.through() && self.earlier.unwritten().is_none()
    }

    /// The aggregator has all up to this batch, which that process sent: now it is known what became of its end.
    pub(super) fn resolve_earlier(&mut self, number: u64, process: Option<u64>) {
        let Some((unresolved, resolved)) = self.earlier.resolve(number, process) else { return };
        self.backlog.add_stored(resolved.stored);
        let unreported = self.intake.resolve(&unresolved, &resolved);
        self.earlier.write(resolved, unreported);
    }

    /// Goes on with batch `resume`, because those before it are missing from the file; `before` is the chain of the last
    /// of them.
    pub(super) fn skip_to(&mut self, resume: u64, before: Chain, now: MonoTime) {
        self.backlog.skip_to(resume, before);
        self.deletions.add(0, now);
    }

    /// Counts what is not in the file although it was said to be.
    pub(super) fn settle(&mut self, now: Stamp) {
        let missing = self.backlog.settle();
        if missing.events > 0 {
            self.file_bytes = self.file_bytes.saturating_sub(missing.bytes);
            let reason = "batches were missing from the agent's spool file".to_owned();
            self.intake.lose((None, None), missing.events, reason, now);
            self.report_losses(now);
        }
    }

    /// The batches of the last transaction are in the spool: whether it is known now that appending works; `None` when there
    /// was no transaction.
    pub(super) fn appended(&mut self, now: Stamp) -> Option<bool> {
        let appended = self.appends.end()?;
        if appended.resolves {
            self.earlier.written();
            self.intake.resolution_written();
        }
        if let Some((last, chain)) = appended.last {
            self.backlog.appended(last, chain);
            self.file_bytes += appended.bytes;
            self.deletions.add_written(appended.freed);
        }
        // That there was room for a few numbers says nothing of the batches that wait for it.
        let works = appended.last.is_some() || !self.appends.fails() || self.backlog.pending().events == 0;
        if works {
            self.appends.recover();
        }
        self.report_losses(now);
        Some(works)
    }

    /// None of them is; `None` when there was no transaction.
    pub(super) fn append_failed(&mut self, now: MonoTime) -> Option<()> {
        self.appends.fail(now, self.config.spool_pause)
    }

    /// What was to be deleted is gone; `None` when nothing was.
    pub(super) fn deleted(&mut self) -> Option<()> {
        let ((through, chain), bytes) = self.deletions.end()?;
        self.file_bytes = self.file_bytes.saturating_sub(bytes);
        self.backlog.passed(through, chain);
        Some(())
    }

    /// It is not; `None` when nothing was to be deleted.
    pub(super) fn delete_failed(&mut self, now: MonoTime) -> Option<()> {
        self.deletions.fail(now, self.config.spool_pause)
    }

    /// The batches that may be sent up to which number, and whether that includes those in memory only.
    ///
    /// The file says beforehand which batches may be stored over there, in case it loses what is written later. While
    /// it cannot be written, what is in it is sent all the same: a disk that is full of batches would never have room
    /// again. What is not in it is sent only if there is nothing in the file of which that is not known.
    pub(super) fn sendable(&self) -> (u64, bool) {
        match self.appends.fails() {
            false => (self.appends.written().reached.map_or(0, |reached| reached.number), false),
            true if self.is_marked() => (u64::MAX, true),
            true => (self.backlog.spooled(), false),
        }
    }

    /// The head and body of a batch to be sent; it counts as sent.
    pub(super) fn send(&mut self, number: u64, unspooled: bool, host: HostId) -> Option<(BatchHead, Bytes)> {
        self.backlog.send(number, unspooled, (host, self.process))
    }

    /// What is to be deleted or appended now; `renews` says whether the stream is being left, for which the spool must
    /// hold nothing that is stored.
    pub(super) fn next(&mut self, renews: bool, now: MonoTime) -> Option<Action> {
        self.deletion(renews, now).or_else(|| self.append(now))
    }

    /// Whether something is to be deleted, sooner or later.
    fn may_delete(&self) -> bool {
        let (through, _) = self.backlog.acknowledged();
        // What is being written may not be there yet.
        let settled = through <= self.backlog.spooled() || !self.appends.is_under_way();
        through > self.deletions.through() && settled && self.deletions.may_begin()
    }

    fn deletion(&mut self, renews: bool, now: MonoTime) -> Option<Action> {
        if !(self.deletions.is_free(now) && self.may_delete()) {
            return None;
        }
        let (through, chain) = self.backlog.acknowledged();
        let soon = self.is_behind() || renews || self.is_closing;
        (soon || self.deletions.is_due(through, self.config.spool_bytes / 4, now)).then(|| {
            self.deletions.begin((through, chain));
            Action::Delete { through, chain }
        })
    }

    /// Whether batches were stored over there that never came into the file. What follows them is not written before
    /// the file knows that they are gone, or there would be a gap in it.
    fn is_behind(&self) -> bool {
        self.backlog.acknowledged().0 > self.backlog.spooled()
    }

    fn append(&mut self, now: MonoTime) -> Option<Action> {
        if !self.appends.is_free(now) || self.is_behind() {
            return None;
        }
        let (batches, totals) = self.to_append(now)?;
        let unreported = self.earlier.unwritten().cloned();
        self.appends.begin(&batches, &totals, unreported.is_some(), now);
        let totals = Totals { unreported, ..totals.with(self.earlier.resolved()) };
        Some(Action::Append { batches, totals })
    }

    /// What is to be written now.
    fn to_append(&self, now: MonoTime) -> Option<(Vec<SpooledBatch>, Totals)> {
        let (written, spooled) = (self.appends.written(), self.backlog.spooled());
        let resolves = self.earlier.unwritten().is_some();
        if resolves || self.is_met && !self.is_marked() {
            let reached = self.reaches(spooled);
            return Some((Vec::new(), Totals { reached, ..written.clone() }));
        }
        if self.appends.were_refused() && self.intake.counted().dropped != written.dropped {
            return Some((Vec::new(), self.safe_totals()));
        }
        let Some((batches, totals)) = self.backlog.to_append(MOST_APPENDED, MOST_APPENDED_BYTES) else {
            let due = self.is_closing || self.losses_due().is_some_and(|due| now >= due);
            let totals = due.then(|| self.safe_totals()).filter(|totals| totals != written);
            return totals.map(|totals| (Vec::new(), totals));
        };
        let newest = batches.last().map_or(spooled, |batch| batch.number);
        Some((batches, Totals { reached: self.reaches(newest), ..totals }))
    }

    /// When to write down how much was dropped.
    fn losses_due(&self) -> Option<MonoTime> {
        self.appends.losses_due(self.intake.counted().dropped)
    }

    /// Up to `number` this process may send; nothing before the aggregator is met.
    fn reaches(&self, number: u64) -> Option<Reached> {
        self.is_met.then_some(Reached { process: self.process, number })
    }

    /// Whether the file says of everything in it that this process may send it.
    fn is_marked(&self) -> bool {
        self.appends.is_marked(self.backlog.spooled())
    }
}
