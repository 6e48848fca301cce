//! Encoding of events into batches, before the batches are numbered.

mod losses;
mod run_tracker;
mod unreported;

use bytes::Bytes;
use peernet_clock::{MonoTime, Stamp, WallTime};

use self::run_tracker::RunTracker;
use self::unreported::UnreportedLosses;
use super::SendingConfig;
use crate::spool::Usage;
use crate::totals::Totals;
use crate::unresolved::ResolvedBatches;
use crate::{Event, Gap, RunCounts, UnresolvedBatches, codec};
use peernet_logger::limits::MAX_TREE_BYTES;
use peernet_logger::{RunId, Slug};

/// Size reserved for the report of a loss.
const GAP_REPORT: Usage = Usage { events: 1, bytes: 512 };

/// Longest event: the largest tree and the fields around it.
const MAX_EVENT_BYTES: usize = MAX_TREE_BYTES + 16 * 1024;

/// Maximum length of a batch's body. A larger configured value has no effect, because the aggregator must be able to
/// read the batch's frame.
const MAX_BATCH_BYTES: usize = codec::MAX_MESSAGE_BYTES - codec::BATCH_HEAD_BYTES;

/// State machine that accepts events, counts them, and groups them into batches without numbers.
#[derive(Clone, Debug)]
pub(super) struct Intake {
    config: SendingConfig,
    totals: Totals,
    open_batch: OpenBatch,
    /// Closed batches that were not collected yet.
    unnumbered: Vec<UnnumberedBatch>,
    unnumbered_usage: Usage,
    /// Encoded form of the current event; kept to reuse its memory.
    encoded: Vec<u8>,
    losses: UnreportedLosses,
    runs: RunTracker,
}

/// A batch under construction.
#[derive(Clone, Debug, Default)]
struct OpenBatch {
    body: Vec<u8>,
    events: u32,
    nodes: usize,
    /// Time of the first event.
    since: Option<Stamp>,
}

/// A batch without a number.
#[derive(Clone, Debug)]
pub(super) struct UnnumberedBatch {
    /// Time of the first event.
    pub(super) since: WallTime,
    pub(super) events: u32,
    pub(super) body: Bytes,
    /// Totals up to the last event.
    pub(super) totals: Totals,
}

/// Capacity for further events.
#[derive(Clone, Debug)]
pub(super) struct EventCapacity {
    /// Capacity in memory.
    pub(super) memory: Usage,
    /// Capacity in the spool, bytes.
    pub(super) spool_bytes: u64,
    /// `true` if the spool cannot be written.
    pub(super) spool_fails: bool,
}

impl EventCapacity {
    fn fits(&self, usage: Usage) -> bool {
        usage.fits(self.memory) && usage.bytes <= self.spool_bytes
    }

    fn drop_reason(&self, usage: Usage) -> &'static str {
        match () {
            () if usage.bytes > self.spool_bytes => "the agent's spool was full",
            () if self.spool_fails => "the agent's spool could not be written and its memory was full",
            () => {
                "the agent's memory was full: events arrived faster than they could be written to the spool"
            }
        }
    }
}

impl Intake {
    /// Creates an intake that continues the counts of the spool. `earlier_gaps` are the gaps of earlier processes that
    /// are not reported yet. `is_unresolved` is `true` if only the aggregator knows which batches of an earlier process
    /// are stored.
    pub(super) fn new(
        config: SendingConfig,
        totals: Totals,
        earlier_gaps: Vec<Gap>,
        is_unresolved: bool,
    ) -> Self {
        let drops_in_gaps = earlier_gaps
            .iter()
            .fold(totals.reported_drops, |drops_in_gaps, gap| drops_in_gaps.saturating_add(gap.count));
        // Earlier processes dropped these events, and neither a reported gap nor one of `earlier_gaps` contains them.
        let earlier_drops = totals.dropped.saturating_sub(drops_in_gaps);
        Self {
            losses: UnreportedLosses::new(earlier_gaps, earlier_drops, is_unresolved),
            config,
            totals,
            open_batch: OpenBatch::default(),
            unnumbered: Vec::new(),
            unnumbered_usage: Usage::default(),
            encoded: Vec::new(),
            runs: RunTracker::default(),
        }
    }

    pub(super) fn offer(&mut self, event: &Event, capacity: &EventCapacity, now: Stamp) {
        // Earlier drops are added before the event, so that losses are reported in the order in which they happened.
        self.losses.add_earlier_drops(now);
        // The event is encoded before the decision, because the size of the encoded event decides whether it fits.
        self.encoded.clear();
        codec::encode_into(&mut self.encoded, event);
        let run = event.run();
        match self.reason_to_drop(event, capacity) {
            None => {
                self.report_losses(capacity, now);
                // The run's losses are reported before its end, so that they belong to the run.
                if let Event::RunEnded(ended) = event {
                    self.report_ended(Some(ended.run), capacity, now);
                }
                self.append_event(node_count(event), now);
                self.totals.submitted.batched.add(run, 1);
            }
            Some(reason) => {
                self.totals.produced += 1;
                self.totals.submitted.dropped.add(run, 1);
                self.count_lost(self.runs.scope(event), 1, reason, now);
            }
        }
        self.totals.submitted.last = Some(now.wall);
        // This comes last: the end of a run removes the run's pipeline, which `count_lost` above needs.
        self.runs.observe(event);
    }

    /// Counts events that were accepted or offered and are lost. `scope` is their pipeline and their run.
    pub(super) fn count_lost(
        &mut self,
        scope: (Option<Slug>, Option<RunId>),
        count: u64,
        reason: String,
        now: Stamp,
    ) {
        self.totals.dropped += count;
        self.losses.add(scope, count, reason, now);
    }

    /// Counts submitted events that were dropped before they were offered.
    pub(super) fn record_loss(&mut self, gap: &Gap, now: Stamp) {
        self.totals.produced += gap.count;
        self.totals.dropped += gap.count;
        self.totals.submitted.dropped.add(gap.run, gap.count);
        self.totals.submitted.last = Some(now.wall);
        self.losses.add_gap(gap.clone(), now);
    }

    /// Returns the reason to drop the current event; `None` if the event is accepted.
    fn reason_to_drop(&self, event: &Event, capacity: &EventCapacity) -> Option<String> {
        let mut added_usage = Usage { events: 1, bytes: self.encoded.len() as u64 };
        if let Event::Iteration(iteration) = event {
            // An iteration that the aggregator would refuse must not block later events.
            let first_node = 0;
            if let Err(error) = iteration.tree.check(first_node) {
                return Some(format!("the iteration cannot be sent: {error}"));
            }
            // An iteration is accepted only if the reserve for other events stays free.
            added_usage = added_usage + self.reserved_usage();
        }
        if self.encoded.len() > MAX_EVENT_BYTES {
            return Some(format!("the event is longer than {MAX_EVENT_BYTES} bytes"));
        }
        // Capacity for the reports of losses is reserved: an agent with a full spool must still be able to report
        // losses.
        let needed = self.usage() + added_usage + self.report_usage();
        (!capacity.fits(needed)).then(|| capacity.drop_reason(needed).to_owned())
    }

    /// Returns the capacity that is reserved for events other than iterations.
    fn reserved_usage(&self) -> Usage {
        let events = self.config.reserve_events;
        // The same share of the bytes and of the events is reserved, so that neither is exhausted before the other. The
        // share of the bytes is at most an eighth, so that a small configuration still has capacity for iterations.
        let share = |bytes: u64| bytes / (self.config.memory.events / events.max(1)).max(8);
        let bytes = share(self.config.memory.bytes).min(share(self.config.spool_bytes));
        Usage { events, bytes: if events > 0 { bytes } else { 0 } }
    }

    /// Adds gaps in place of lost events: all gaps that are due, while there is capacity.
    pub(super) fn report_losses(&mut self, capacity: &EventCapacity, now: Stamp) {
        while self.has_capacity_for_report(capacity)
            && let Some(gap) = self.losses.take_due(now.mono)
        {
            self.report(gap, now);
        }
    }

    /// Reports all losses of a run that ends, or of all runs.
    fn report_ended(&mut self, run: Option<RunId>, capacity: &EventCapacity, now: Stamp) {
        while self.has_capacity_for_report(capacity)
            && let Some(gap) = self.losses.take_ended(run, now.mono)
        {
            self.report(gap, now);
        }
    }

    /// Returns whether gaps have reported all losses.
    #[cfg(test)]
    pub(super) fn has_reported_all(&self) -> bool {
        self.losses.is_empty()
    }

    fn has_capacity_for_report(&self, capacity: &EventCapacity) -> bool {
        self.losses.may_report() && capacity.fits(self.usage() + GAP_REPORT)
    }

    /// Records which batches of an earlier process are stored. Returns the losses of all earlier processes that no gap
    /// reports. These losses are reported after the spool contains them ([`Self::record_resolution_written`]).
    pub(super) fn resolve(&mut self, unresolved: &UnresolvedBatches, resolved: &ResolvedBatches) -> Vec<Gap> {
        self.losses.resolve(unresolved, resolved)
    }

    pub(super) const fn record_resolution_written(&mut self) {
        self.losses.record_resolution_written();
    }

    fn report(&mut self, gap: Gap, now: Stamp) {
        // The buffer may hold an accepted event, which is appended after this report.
        let event = std::mem::take(&mut self.encoded);
        let count = gap.count;
        codec::encode_into(&mut self.encoded, &Event::Gap(gap));
        self.append_event(1, now);
        self.totals.gaps += 1;
        self.totals.reported_drops += count;
        self.encoded = event;
    }

    /// Adds the current event to the batch.
    fn append_event(&mut self, nodes: usize, now: Stamp) {
        let max_bytes = self.config.batch_bytes.min(MAX_BATCH_BYTES);
        let is_full = self.open_batch.body.len() + self.encoded.len() > max_bytes
            || self.open_batch.nodes + nodes > self.config.batch_nodes;
        if is_full {
            self.close_batch();
        }
        // The event is counted after the previous batch was closed, because a batch's totals must not include later
        // events.
        self.totals.produced += 1;
        self.open_batch.since.get_or_insert(now);
        self.open_batch.body.extend_from_slice(&self.encoded);
        self.open_batch.events += 1;
        self.open_batch.nodes += nodes;
    }

    /// Reports all losses and closes the batch under construction, before the agent stops.
    pub(super) fn flush(&mut self, capacity: &EventCapacity, now: WallTime) {
        // The monotonic time does not matter here, because all losses are reported, whether they are due or not.
        let since = self.open_batch.since.unwrap_or_default();
        let now = Stamp { wall: now, ..since };
        self.report_ended(None, capacity, now);
        self.close_batch();
    }

    fn close_batch(&mut self) {
        let Some(since) = self.open_batch.since else { return };
        self.unnumbered_usage = self.unnumbered_usage + self.open_usage();
        let OpenBatch { body, events, .. } = std::mem::take(&mut self.open_batch);
        self.unnumbered.push(UnnumberedBatch {
            since: since.wall,
            events,
            // The body has no unused capacity, because the limits of memory count only its length.
            body: Bytes::from(body.into_boxed_slice()),
            totals: self.totals.clone(),
        });
    }

    /// Returns the batches that were closed since the last call.
    pub(super) fn take_unnumbered(&mut self) -> Vec<UnnumberedBatch> {
        self.unnumbered_usage = Usage::default();
        std::mem::take(&mut self.unnumbered)
    }

    pub(super) fn tick(&mut self, capacity: &EventCapacity, now: Stamp) {
        self.losses.add_earlier_drops(now);
        if self.batch_deadline().is_some_and(|deadline| now.mono >= deadline) {
            self.close_batch();
        }
        self.report_losses(capacity, now);
    }

    /// Returns the time at which the batch under construction is closed or a loss is reported.
    pub(super) fn deadline(&self, capacity: &EventCapacity) -> Option<MonoTime> {
        // Without capacity, nothing can be reported before an acknowledgement frees capacity.
        let report = self.has_capacity_for_report(capacity).then(|| self.losses.next_report_at()).flatten();
        self.batch_deadline().into_iter().chain(report).min()
    }

    fn batch_deadline(&self) -> Option<MonoTime> {
        self.open_batch.since.map(|since| since.mono + self.config.batch_age)
    }

    /// Counts the events of the batch under construction and `further_events` other events as dropped; `retained`
    /// counts the accepted events that are kept.
    pub(super) fn give_up(&mut self, further_events: u64, retained: &RunCounts) {
        self.totals.dropped += u64::from(self.open_batch.events) + further_events;
        self.totals.submitted.give_up(retained);
        self.open_batch = OpenBatch::default();
    }

    /// Returns all counts.
    pub(super) const fn totals(&self) -> &Totals {
        &self.totals
    }

    /// Returns the ended runs that are still counted separately.
    pub(super) fn ended_runs(&self) -> &[RunId] {
        self.runs.ended_runs()
    }

    /// Ends the separate count of an ended run.
    pub(super) fn forget_run(&mut self, run: RunId) {
        self.runs.forget(run);
        self.totals.submitted.forget(run);
    }

    /// Returns the time of the first event of the batch under construction.
    pub(super) fn since(&self) -> Option<WallTime> {
        self.open_batch.since.map(|since| since.wall)
    }

    /// Returns the number and bytes of the events in batches without a number.
    pub(super) fn usage(&self) -> Usage {
        self.open_usage() + self.unnumbered_usage
    }

    fn open_usage(&self) -> Usage {
        Usage { events: u64::from(self.open_batch.events), bytes: self.open_batch.body.len() as u64 }
    }

    /// Returns the size that is reserved for the gaps that are not reported yet.
    fn report_usage(&self) -> Usage {
        let gaps = self.losses.len() as u64;
        Usage { events: gaps * GAP_REPORT.events, bytes: gaps * GAP_REPORT.bytes }
    }
}

/// Returns the number of nodes with which an event counts towards [`SendingConfig::batch_nodes`].
fn node_count(event: &Event) -> usize {
    match event {
        Event::Iteration(iteration) => iteration.tree.nodes().len(),
        _ => 1,
    }
}
