//! The agent's end of the durable lane, and the flow control of both lanes.
//!
//! [`EventSpooler`] groups events into numbered batches and writes the batches to the spool. [`SpoolReader`] reads
//! batches from the spool. [`DurableLane`] sends batches while the aggregator has accepted the host ([`Session`]).
//! [`StreamRenewal`] moves the spool to a new stream. [`Sending`] calls these components.

mod action;
mod appends;
mod backlog;
mod compression_control;
mod config;
mod connection;
mod deletions;
mod durable_lane;
mod earlier_process;
mod flow;
mod in_flight_batches;
mod intake;
mod job;
mod partial_batch;
mod session;
mod spool_failure;
mod spool_reader;
mod spooler;
mod stream_renewal;

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Stamp, WallTime};

pub use self::action::{Action, Notice};
pub use self::config::{Compression, SendingConfig};
use self::durable_lane::DurableLane;
use self::session::{ConnectionState, Session};
use self::spool_failure::{SpoolFailure, SpoolWork};
use self::spool_reader::SpoolReader;
use self::spooler::EventSpooler;
use self::stream_renewal::StreamRenewal;
use super::spool::{SpoolState, SpooledBatch};
use super::totals::Totals;
use super::{Accounting, Event, Gap, HostDescription, HostSecret, SentUnspooled, ToAggregator, codec};
use peernet_logger::{HostId, RunId};

/// State machine of the agent's end of the durable lane, without I/O.
///
/// The owner calls [`next`](Self::next) after every other call until it returns `None`, and [`tick`](Self::tick) when
/// the [`deadline`](Self::deadline) is reached. The state machine recovers from everything that the transport loses,
/// repeats or reorders. It needs no reports of opened and closed connections for this recovery, but recovers faster
/// with such reports.
///
/// The agent's task for the spool performs the actions on the file, so that neither the queue of events nor a live
/// update waits for a disk. A batch is sent after it was written to the spool. While the spool fails, batches are sent
/// from memory, because it is better that only the aggregator stores the batches than that nobody does.
#[derive(Clone, Debug)]
pub struct Sending {
    config: SendingConfig,
    host: HostDescription,
    secret: HostSecret,
    /// Events and numbered batches, in memory and in the spool.
    spooler: EventSpooler,
    reader: SpoolReader,
    renewal: StreamRenewal,
    failure: SpoolFailure,
    session: Session,
    durable_lane: DurableLane,
    /// Notices that the agent has not received yet.
    notices: VecDeque<Notice>,
}

impl Sending {
    /// Creates the sending end of a host with its `secret`; `process` is a random number drawn at the start of the
    /// process. Nothing is sent before [`on_connected`](Self::on_connected).
    pub fn new(
        config: SendingConfig,
        host: HostDescription,
        secret: HostSecret,
        process: u64,
        mut spool: SpoolState,
    ) -> Self {
        // The budget is twice the window: one window of batches is in flight while the next window of batches is read
        // from the spool.
        let budget = 2 * u64::from(config.window.max(1)) * config.batch_bytes as u64;
        Self {
            renewal: StreamRenewal::new(std::mem::take(&mut spool.newest_sendable)),
            spooler: EventSpooler::new(config, process, budget, spool),
            reader: SpoolReader::default(),
            failure: SpoolFailure::default(),
            session: Session::new(config),
            durable_lane: DurableLane::new(config, budget),
            notices: VecDeque::new(),
            config,
            host,
            secret,
        }
    }

    /// Accepts an event, or drops and counts the event. Never waits and never fails: without capacity, the newest
    /// events are dropped, and a gap is sent in their place as soon as there is capacity.
    pub fn offer(&mut self, event: &Event, now: Stamp) {
        self.spooler.offer(event, now);
    }

    /// Counts submitted events that were dropped before they were offered ([`offer`](Self::offer)).
    pub fn record_loss(&mut self, gap: &Gap, now: Stamp) {
        self.spooler.record_loss(gap, now);
    }

    /// Handles the passage of time: closes the batch under construction if the batch is old enough, reports losses, and
    /// schedules a hello if no acknowledgement arrived for too long.
    pub fn tick(&mut self, now: Stamp) {
        self.spooler.tick(now);
        self.check_ack_timeout(now.mono);
    }

    /// Returns the time at which [`tick`](Self::tick) or [`next`](Self::next) must be called even if nothing else
    /// happens.
    pub fn deadline(&self) -> Option<MonoTime> {
        let retry_times = [self.reader.retry_at(), self.renewal.retry_at()];
        let times = [self.spooler.deadline(), self.connection_deadline()].into_iter().chain(retry_times);
        times.flatten().min()
    }

    /// Returns the next action; `None` if nothing is to be done.
    pub fn next(&mut self, now: MonoTime) -> Option<Action> {
        self.spooler
            // Writes come before sends: a batch is safe once it is in the file.
            .next(self.renewal.is_requested(), now)
            .or_else(|| self.renewal.next(&self.spooler, now))
            .or_else(|| self.reader.next(&self.session.state, &self.spooler.backlog, now))
            .or_else(|| self.frame(now).map(Action::Send))
    }

    /// Reports losses and closes the batch under construction, before the agent stops. Everything is in the spool when
    /// [`is_spooled`](Self::is_spooled) returns `true`.
    pub fn flush(&mut self, now: WallTime) {
        self.spooler.flush(now);
    }

    /// Returns whether a write to the spool is in progress.
    pub const fn is_appending(&self) -> bool {
        self.spooler.is_appending()
    }

    /// Counts all events that are in memory only as dropped, because the process ends without writing these events to
    /// the spool. The returned totals are to be written to the spool, so that the next process reports how many events
    /// are missing. Such events count as dropped even if they were sent, because it is unknown whether the aggregator
    /// stored them.
    pub fn give_up(&mut self) -> Totals {
        self.spooler.give_up()
    }

    /// Returns whether batches were sent that may be stored although they are neither in the spool nor acknowledged.
    pub fn has_sent_unspooled(&self) -> bool {
        self.spooler.has_sent_unspooled()
    }

    /// Returns the number of events that are in memory only.
    pub fn unspooled_events(&self) -> u64 {
        self.spooler.unspooled_events()
    }

    /// Returns the goodbye frame; `None` if the aggregator has not accepted this agent, so that a refused second agent
    /// with the same host id cannot end the session of the first.
    pub fn goodbye(&mut self) -> Option<Vec<u8>> {
        // This is read before `on_disconnected` discards the state of the connection.
        let was_accepted = self.is_up();
        self.on_disconnected();
        was_accepted.then(|| codec::encode(&ToAggregator::Goodbye(self.host.id)))
    }

    /// Returns whether the aggregator has accepted this host, so live updates are useful.
    pub const fn is_up(&self) -> bool {
        self.session.is_up()
    }

    /// Returns whether a live update may be sent now: the update would not wait for long in the connection, and on a
    /// link that is too slow for both lanes, the durable lane has had its share. If an update is skipped, the next
    /// update contains everything that the skipped update would have contained.
    pub fn may_send_live(&self) -> bool {
        // The durable lane limits the bytes in flight of both lanes.
        self.is_up() && self.durable_lane.may_send_live()
    }

    /// Returns whether messages should be compressed.
    pub const fn is_compressing(&self) -> bool {
        self.durable_lane.is_compressing()
    }

    /// Returns the version of the event stream that was chosen for the connection; before it is chosen, the oldest
    /// supported version.
    pub const fn version(&self) -> u16 {
        self.session.version()
    }

    /// Records that a live update was sent.
    pub const fn record_live_sent(&mut self, bytes: usize) {
        self.durable_lane.record_live_sent(bytes as u64);
    }

    /// Returns whether all events are in the spool or stored.
    pub fn is_spooled(&self) -> bool {
        self.spooler.unspooled_events() == 0
    }

    /// Returns whether no event waits: each event is stored or was dropped.
    pub fn is_idle(&self) -> bool {
        self.spooler.is_idle()
    }

    /// Returns the numbers of events by state.
    pub fn accounting(&self) -> Accounting {
        self.spooler.accounting(self.durable_lane.is_compressing(), self.failure.reason())
    }

    /// Returns the ended runs whose events are all in the spool or dropped, and their numbers of events. The agent may
    /// remove its own counts of these runs, and then calls [`forget_run`](Self::forget_run).
    pub fn settled_runs(&self) -> Vec<(RunId, u64)> {
        self.spooler.settled_runs()
    }

    /// Returns whether gaps have reported all losses.
    #[cfg(test)]
    pub(super) fn has_reported_all(&self) -> bool {
        self.spooler.has_reported_all()
    }

    /// Returns the number of events of this process that the spool has in batches or has counted as dropped.
    pub const fn settled_events(&self) -> u64 {
        self.spooler.settled_events()
    }

    /// Returns the newest batch that [`next`](Self::next) returned for sending although it is not in the spool, because
    /// the spool cannot be written. The owner records it outside of the process before it sends the frame.
    pub fn sent_unspooled(&self) -> Option<SentUnspooled> {
        self.spooler.sent_unspooled()
    }

    /// Ends the separate count of an ended run.
    pub fn forget_run(&mut self, run: RunId) {
        self.spooler.forget_run(run);
    }

    /// Returns the id of the host.
    pub const fn host(&self) -> HostId {
        self.host.id
    }

    /// Records that the batches of the last [`Action::Append`] are in the spool.
    pub fn on_appended(&mut self, now: Stamp) -> Option<Notice> {
        if self.spooler.finish_append(now)? {
            self.record_recovery(SpoolWork::Append);
        }
        self.next_notice()
    }

    /// Records that none of the batches of the last [`Action::Append`] is in the spool.
    pub fn on_append_failed(&mut self, reason: String, now: Stamp) -> Option<Notice> {
        self.spooler.fail_append(now.mono)?;
        self.record_failure(SpoolWork::Append, reason)
    }

    /// Handles the batches that [`Action::Load`] requested. The list ends before the first batch that the spool lacks.
    pub fn on_loaded(&mut self, batches: Vec<SpooledBatch>, now: Stamp) -> Option<Notice> {
        let purpose = self.reader.finish()?;
        self.record_recovery(SpoolWork::Load);
        self.handle_loaded(purpose, batches, now);
        self.next_notice()
    }

    /// Records that the batches of the last [`Action::Load`] could not be read.
    pub fn on_load_failed(&mut self, reason: String, now: Stamp) -> Option<Notice> {
        self.reader.fail(now.mono, self.config.spool_pause)?;
        self.record_failure(SpoolWork::Load, reason)
    }

    /// Records that the batches of the last [`Action::Delete`] are deleted.
    pub fn on_deleted(&mut self) {
        if self.spooler.finish_delete().is_some() {
            self.record_recovery(SpoolWork::Delete);
        }
    }

    /// Records that the batches of the last [`Action::Delete`] could not be deleted.
    pub fn on_delete_failed(&mut self, reason: String, now: Stamp) -> Option<Notice> {
        self.spooler.fail_delete(now.mono)?;
        self.record_failure(SpoolWork::Delete, reason)
    }

    /// Records that the spool belongs to the stream of the last [`Action::Renew`].
    pub fn on_renewed(&mut self, now: Stamp) {
        let Some(stream) = self.renewal.finish() else { return };
        self.spooler.renew(stream);
        self.record_recovery(SpoolWork::Renew);
        // Without a connection, no hello may be sent. The next connection begins with a hello.
        if !matches!(self.session.state, ConnectionState::Down) {
            self.schedule_hello(now.mono);
        }
    }

    /// Records that the spool could not be moved to the new stream.
    pub fn on_renew_failed(&mut self, reason: String, now: Stamp) -> Option<Notice> {
        self.renewal.fail(now.mono, self.config.spool_pause)?;
        self.record_failure(SpoolWork::Renew, reason)
    }

    fn record_failure(&mut self, work: SpoolWork, reason: String) -> Option<Notice> {
        self.notices.extend(self.failure.fail(work, reason));
        self.next_notice()
    }

    fn record_recovery(&mut self, work: SpoolWork) {
        self.notices.extend(self.failure.recover(work));
    }

    fn next_notice(&mut self) -> Option<Notice> {
        self.notices.pop_front()
    }
}

#[cfg(test)]
mod tests;
