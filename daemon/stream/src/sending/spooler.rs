//! Spooling of events: numbered batches stay in the spool until the aggregator has stored them.

use bytes::Bytes;
use peernet_clock::{MonoTime, Stamp, WallTime};
use peernet_logger::{HostId, RunId};

use super::appends::Appends;
use super::backlog::Backlog;
use super::deletions::Deletions;
use super::earlier_process::EarlierProcess;
use super::intake::{EventCapacity, Intake};
use super::spool_reader::ScanResult;
use super::{Action, SendingConfig};
use crate::spool::{SpoolState, SpooledBatch};
use crate::totals::{NewestSendableBatch, Totals};
use crate::{Accounting, BatchHead, ChainHash, Event, Gap, SentUnspooled, StreamId, SubmittedEvents};

/// Maximum number of batches in one transaction, so that other work on the spool does not wait for long.
const MAX_APPENDED: usize = 256;
/// Maximum number of bytes in one transaction.
const MAX_APPENDED_BYTES: u64 = 4 << 20;

/// State machine that accepts events, numbers their batches, and decides which batches are written to the spool and
/// which are deleted from the spool.
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
    /// The last batches of an earlier process, until the spool records which of these batches are stored.
    earlier: EarlierProcess,
    /// `true` if the aggregator has accepted this process with the current stream.
    is_accepted: bool,
    /// `true` if everything is to be written to the spool now.
    is_closing: bool,
}

impl EventSpooler {
    /// Continues from the content of the spool; `budget` bytes of batches are kept in memory for sending.
    pub(super) fn new(config: SendingConfig, process: u64, budget: u64, spool: SpoolState) -> Self {
        let backlog = Backlog::new(&spool, budget);
        let Totals { produced, dropped, .. } = spool.totals;
        // All events in the spool were produced, even if the counts in the spool state fewer events.
        let produced = produced.max(dropped.saturating_add(backlog.waiting_usage().events));
        // `newest_sendable` and `submitted` concern the current process, which has sent and submitted nothing yet.
        let totals = Totals {
            produced,
            newest_sendable: None,
            submitted: SubmittedEvents::default(),
            ..spool.totals.clone()
        };
        Self {
            appends: Appends::new(totals.clone()),
            deletions: Deletions::new(backlog.acknowledged().0),
            file_bytes: spool.waiting_usage.bytes,
            intake: Intake::new(config, totals, spool.unreported, spool.unresolved.is_some()),
            backlog,
            earlier: EarlierProcess::new(spool.unresolved),
            is_accepted: false,
            is_closing: false,
            config,
            process,
        }
    }

    /// Returns the random number of this process.
    pub(super) const fn process(&self) -> u64 {
        self.process
    }

    pub(super) fn offer(&mut self, event: &Event, now: Stamp) {
        let capacity = self.capacity();
        self.intake.offer(event, &capacity, now);
        self.number_batches();
    }

    pub(super) fn record_loss(&mut self, gap: &Gap, now: Stamp) {
        self.intake.record_loss(gap, now);
    }

    pub(super) fn tick(&mut self, now: Stamp) {
        let capacity = self.capacity();
        self.intake.tick(&capacity, now);
        self.number_batches();
    }

    pub(super) fn flush(&mut self, now: WallTime) {
        let capacity = self.capacity();
        self.intake.flush(&capacity, now);
        self.number_batches();
        self.is_closing = true;
    }

    /// Returns the time at which a batch is closed, a loss is reported, or batches are written to or deleted from the
    /// file.
    pub(super) fn deadline(&self) -> Option<MonoTime> {
        let deletion = self.may_delete().then(|| self.deletions.due_at()).flatten();
        let writes = [self.appends.retry_at(), self.deletions.retry_at(), deletion, self.losses_due_at()];
        writes.into_iter().chain([self.intake.deadline(&self.capacity())]).flatten().min()
    }

    pub(super) fn give_up(&mut self) -> Totals {
        let lost = self.backlog.give_up();
        self.intake.give_up(lost, &self.backlog.settled_totals().submitted.batched);
        let unreported = self.earlier.unwritten_gaps().cloned();
        Totals { unreported, ..self.persistent_totals().with_resolved(self.earlier.resolved()) }
    }

    /// Returns whether a write to the spool is in progress.
    pub(super) const fn is_appending(&self) -> bool {
        self.appends.is_in_progress()
    }

    /// Returns whether batches were sent that may be stored although they are neither in the spool nor acknowledged.
    pub(super) fn has_sent_unspooled(&self) -> bool {
        self.backlog.newest_sent() > self.backlog.spooled().max(self.backlog.oldest() - 1)
    }

    /// Returns the number of events that are in memory only.
    pub(super) fn unspooled_events(&self) -> u64 {
        self.intake.usage().events + self.backlog.pending_usage().events
    }

    /// Returns whether no event waits: each event is stored or was dropped.
    pub(super) fn is_idle(&self) -> bool {
        self.intake.usage().events == 0 && self.backlog.waiting_usage().events == 0
    }

    pub(super) fn accounting(&self, compressed: bool, trouble: Option<String>) -> Accounting {
        let (intake_usage, waiting_usage, pending) =
            (self.intake.usage(), self.backlog.waiting_usage(), self.backlog.pending_usage());
        let (produced, dropped) = self.earlier.produced_and_dropped(self.intake.totals());
        let gaps = self.intake.totals().gaps;
        let (waiting, stored) = (intake_usage.events + waiting_usage.events, self.backlog.stored_events());
        debug_assert_eq!(produced, stored + waiting + dropped, "all events are accounted for");
        Accounting {
            produced,
            // Stored events count as spooled, although they were deleted from the file.
            spooled: stored + waiting_usage.events.saturating_sub(pending.events),
            sent: stored + self.backlog.sent_events(),
            stored,
            waiting,
            dropped,
            gaps,
            spool_bytes: self.file_bytes,
            spool_limit_bytes: self.config.spool_bytes,
            memory_bytes: intake_usage.bytes + pending.bytes,
            oldest: if waiting_usage.events > 0 { self.backlog.since() } else { self.intake.since() },
            compressed,
            trouble,
        }
    }

    pub(super) fn settled_runs(&self) -> Vec<(RunId, u64)> {
        let events = |submitted: &SubmittedEvents, run| {
            submitted.batched.events_of(run) + submitted.dropped.events_of(run)
        };
        let (counted, written) = (&self.intake.totals().submitted, &self.appends.written_totals().submitted);
        let ended = self.intake.ended_runs().iter().map(|run| (*run, events(counted, *run)));
        ended.filter(|(run, count)| events(written, *run) == *count).collect()
    }

    #[cfg(test)]
    pub(super) fn has_reported_all(&self) -> bool {
        self.intake.has_reported_all()
    }

    pub(super) const fn settled_events(&self) -> u64 {
        let submitted = &self.appends.written_totals().submitted;
        submitted.batched.total + submitted.dropped.total
    }

    pub(super) fn sent_unspooled(&self) -> Option<SentUnspooled> {
        self.backlog.sent_unspooled().map(|sent| self.earlier.with_earlier_events(sent))
    }

    pub(super) fn forget_run(&mut self, run: RunId) {
        self.intake.forget_run(run);
    }

    /// Returns the totals without the events that are in memory only, so that the totals remain correct if the process
    /// is killed.
    fn persistent_totals(&self) -> Totals {
        let (counted, settled) = (self.intake.totals(), self.backlog.settled_totals());
        let unspooled_events = self.unspooled_events();
        let submitted =
            SubmittedEvents { dropped: counted.submitted.dropped.clone(), ..settled.submitted.clone() };
        Totals {
            produced: counted.produced - unspooled_events,
            dropped: counted.dropped,
            gaps: settled.gaps,
            reported_drops: settled.reported_drops,
            submitted,
            newest_sendable: self.appends.written_totals().newest_sendable,
            unreported: None,
        }
    }

    /// Numbers the closed batches.
    fn number_batches(&mut self) {
        for batch in self.intake.take_unnumbered() {
            self.backlog.push(batch);
        }
    }

    /// Returns the capacity for further events.
    fn capacity(&self) -> EventCapacity {
        let pending = self.backlog.pending_usage();
        EventCapacity {
            memory: self.config.memory - pending,
            spool_bytes: self
                .config
                .spool_bytes
                .saturating_sub(self.file_bytes)
                .saturating_sub(pending.bytes),
            spool_fails: self.appends.has_failed(),
        }
    }

    fn report_losses(&mut self, now: Stamp) {
        let capacity = self.capacity();
        self.intake.report_losses(&capacity, now);
        self.number_batches();
    }

    /// Frees the batches up to `through`, which the aggregator stored.
    pub(super) fn free_acknowledged(&mut self, through: u64, scanned: Option<ScanResult>, now: Stamp) {
        let writing = self.appends.newest_in_progress();
        let freed = self.backlog.free(through, scanned, writing);
        self.appends.add_freed(freed.writing_bytes);
        self.deletions.add(freed.spooled_bytes, now.mono);
        self.report_losses(now);
    }

    /// Records that the aggregator accepted this process with the current stream.
    pub(super) const fn record_acceptance(&mut self) {
        self.is_accepted = true;
    }

    /// Continues the unacknowledged batches in a new stream.
    pub(super) const fn renew(&mut self, stream: StreamId) {
        self.backlog.renew(stream);
        self.is_accepted = false;
    }

    /// Returns whether the spool may be moved to a new stream: stored batches are deleted, and the spool records which
    /// batches of an earlier process are stored.
    pub(super) fn may_renew(&self) -> bool {
        self.backlog.acknowledged().0 <= self.deletions.through() && self.earlier.unwritten_gaps().is_none()
    }

    /// Resolves the earlier process. The aggregator has stored all batches up to `number`, which `process` sent.
    pub(super) fn resolve_earlier(&mut self, number: u64, process: Option<u64>) {
        let Some((unresolved, resolved)) = self.earlier.resolve(number, process) else { return };
        self.backlog.add_stored(resolved.stored);
        let unreported = self.intake.resolve(&unresolved, &resolved);
        self.earlier.set_result(resolved, unreported);
    }

    /// Continues with batch `resume`, because the batches before it are missing from the file; `previous_chain` is
    /// the chain hash of the last missing batch.
    pub(super) fn skip_to(&mut self, resume: u64, previous_chain: ChainHash, now: MonoTime) {
        self.backlog.skip_to(resume, previous_chain);
        // A deletion records in the file that the batches are skipped. `drop_missing` subtracts their bytes.
        self.deletions.add(0, now);
    }

    /// Counts the events of batches that should be in the file and are missing as dropped.
    pub(super) fn drop_missing(&mut self, now: Stamp) {
        let missing = self.backlog.remove_missing();
        if missing.events > 0 {
            self.file_bytes = self.file_bytes.saturating_sub(missing.bytes);
            let reason = "batches were missing from the agent's spool file".to_owned();
            self.intake.count_lost((None, None), missing.events, reason, now);
            self.report_losses(now);
        }
    }

    /// Ends the last transaction successfully. Returns whether appending works again; `None` if there was no
    /// transaction.
    pub(super) fn finish_append(&mut self, now: Stamp) -> Option<bool> {
        let appended = self.appends.finish()?;
        if appended.resolves_earlier_process {
            self.earlier.record_written();
            self.intake.record_resolution_written();
        }
        if let Some((last, chain)) = appended.last {
            self.backlog.mark_appended(last, chain);
            self.file_bytes += appended.bytes;
            self.deletions.add_written(appended.freed_bytes);
        }
        // A transaction without batches may succeed even if there is no space for the waiting batches.
        let is_recovered =
            appended.last.is_some() || !self.appends.has_failed() || self.backlog.pending_usage().events == 0;
        if is_recovered {
            self.appends.recover();
        }
        self.report_losses(now);
        Some(is_recovered)
    }

    /// Ends the last transaction as failed; `None` if there was no transaction.
    pub(super) fn fail_append(&mut self, now: MonoTime) -> Option<()> {
        self.appends.fail(now, self.config.spool_pause)
    }

    /// Ends the last deletion successfully; `None` if there was no deletion.
    pub(super) fn finish_delete(&mut self) -> Option<()> {
        let ((through, chain), bytes) = self.deletions.finish()?;
        self.file_bytes = self.file_bytes.saturating_sub(bytes);
        self.backlog.advance_file(through, chain);
        Some(())
    }

    /// Ends the last deletion as failed; `None` if there was no deletion.
    pub(super) fn fail_delete(&mut self, now: MonoTime) -> Option<()> {
        self.deletions.fail(now, self.config.spool_pause)
    }

    /// Returns the number up to which batches may be sent, and whether they may be sent from memory.
    ///
    /// Before batches are sent, the file records that this process is allowed to send them ([`NewestSendableBatch`]),
    /// because later writes may be lost. While the file cannot be written, batches in the file are sent without such a
    /// record: otherwise a disk that is full of batches would never have space again. Batches that are not in the file
    /// are sent only if the file has this record for all its batches.
    pub(super) fn sendable(&self) -> (u64, bool) {
        match self.appends.has_failed() {
            false => (self.appends.written_totals().newest_sendable.map_or(0, |newest| newest.number), false),
            true if self.has_recorded_all_as_sendable() => (u64::MAX, true),
            true => (self.backlog.spooled(), false),
        }
    }

    /// Returns the head and the body of a batch to be sent, and records it as sent.
    pub(super) fn send(
        &mut self,
        number: u64,
        include_unspooled: bool,
        host: HostId,
    ) -> Option<(BatchHead, Bytes)> {
        self.backlog.send(number, include_unspooled, (host, self.process))
    }

    /// Returns the next deletion or append. `leaves_stream` is `true` while this agent leaves the stream. Stored
    /// batches must be deleted before that.
    pub(super) fn next(&mut self, leaves_stream: bool, now: MonoTime) -> Option<Action> {
        // Deletions come first: they free space in the file, and some appends may only follow a deletion
        // ([`Self::has_unspooled_stored`]).
        self.start_deletion(leaves_stream, now).or_else(|| self.append(now))
    }

    /// Returns whether a batch is to be deleted, now or later.
    fn may_delete(&self) -> bool {
        let (through, _) = self.backlog.acknowledged();
        // Stored batches beyond the file may be in the transaction that is in progress. They are deleted after it.
        let may_be_in_transaction = through > self.backlog.spooled() && self.appends.is_in_progress();
        through > self.deletions.through() && !may_be_in_transaction && self.deletions.may_be_scheduled()
    }

    fn start_deletion(&mut self, leaves_stream: bool, now: MonoTime) -> Option<Action> {
        if !(self.deletions.may_start(now) && self.may_delete()) {
            return None;
        }
        let (through, chain) = self.backlog.acknowledged();
        let must_delete_now = self.has_unspooled_stored() || leaves_stream || self.is_closing;
        // Batches that wait for their deletion take space in the spool. Deleting starts at a quarter of the limit.
        let max_waiting_bytes = self.config.spool_bytes / 4;
        (must_delete_now || self.deletions.is_due(through, max_waiting_bytes, now)).then(|| {
            self.deletions.start((through, chain));
            Action::Delete { through, chain }
        })
    }

    /// Returns whether the aggregator stored batches that were never written to the file. The batches after them may be
    /// written only after the file has recorded the deletion; otherwise the file would have a gap.
    fn has_unspooled_stored(&self) -> bool {
        self.backlog.acknowledged().0 > self.backlog.spooled()
    }

    fn append(&mut self, now: MonoTime) -> Option<Action> {
        if !self.appends.may_start(now) || self.has_unspooled_stored() {
            return None;
        }
        let (batches, totals) = self.next_append(now)?;
        let unreported = self.earlier.unwritten_gaps().cloned();
        self.appends.start(&batches, &totals, unreported.is_some(), now);
        let totals = Totals { unreported, ..totals.with_resolved(self.earlier.resolved()) };
        Some(Action::Append { batches, totals })
    }

    /// Returns the batches and totals that are to be written now.
    fn next_append(&self, now: MonoTime) -> Option<(Vec<SpooledBatch>, Totals)> {
        let (written, spooled) = (self.appends.written_totals(), self.backlog.spooled());
        let resolves_earlier_process = self.earlier.unwritten_gaps().is_some();
        // The record of batches that may be sent comes first, because no batch may be sent before the file contains it.
        // The result about an earlier process comes first, too, because no loss may be reported before this write.
        if resolves_earlier_process || self.is_accepted && !self.has_recorded_all_as_sendable() {
            let newest_sendable = self.newest_sendable(spooled);
            return Some((Vec::new(), Totals { newest_sendable, ..written.clone() }));
        }
        // After a failure to write batches, the number of dropped events is written alone, because it needs less space.
        if self.appends.has_failed_with_batches() && self.intake.totals().dropped != written.dropped {
            return Some((Vec::new(), self.persistent_totals()));
        }
        let Some((batches, totals)) = self.backlog.next_append(MAX_APPENDED, MAX_APPENDED_BYTES) else {
            let is_due = self.is_closing || self.losses_due_at().is_some_and(|due| now >= due);
            let totals = is_due.then(|| self.persistent_totals()).filter(|totals| totals != written);
            return totals.map(|totals| (Vec::new(), totals));
        };
        let newest = batches.last().map_or(spooled, |batch| batch.number);
        Some((batches, Totals { newest_sendable: self.newest_sendable(newest), ..totals }))
    }

    /// Returns the time at which the number of dropped events is written alone.
    fn losses_due_at(&self) -> Option<MonoTime> {
        self.appends.losses_due_at(self.intake.totals().dropped)
    }

    /// Returns the record that this process is allowed to send batches up to `number`; `None` before the aggregator has
    /// accepted this process.
    fn newest_sendable(&self, number: u64) -> Option<NewestSendableBatch> {
        self.is_accepted.then_some(NewestSendableBatch { process: self.process, number })
    }

    /// Returns whether the file contains the record that this process is allowed to send all batches of the file.
    fn has_recorded_all_as_sendable(&self) -> bool {
        self.appends.has_recorded_sendable(self.backlog.spooled())
    }
}
