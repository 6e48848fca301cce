//! The agent's end of the durable lane, and what both lanes may have on their way.

mod action;
mod appends;
mod backlog;
mod config;
mod deletions;
mod durable_lane;
mod earlier_process;
mod flow;
mod in_flight_batches;
mod intake;
mod job;
mod link;
mod pace;
mod partial_batch;
mod session;
mod spool_reader;
mod spool_trouble;
mod spooler;
mod stream_renewal;

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Stamp, WallTime};

pub use self::action::{Action, Notice};
pub use self::config::{Compression, SendingConfig};
use self::durable_lane::DurableLane;
use self::session::Session;
use self::spool_reader::SpoolReader;
use self::spool_trouble::{SpoolTrouble, SpoolWork};
use self::spooler::EventSpooler;
use self::stream_renewal::StreamRenewal;
use super::spool::{SpoolState, SpooledBatch};
use super::totals::Totals;
use super::{Accounting, Event, Gap, HostDescription, HostSecret, SentUnspooled, ToAggregator, codec};
use peernet_logger::{HostId, RunId};

/// The agent's end of the durable lane, without I/O: told of events, messages, completed work and time, it says what
/// to do.
///
/// Whoever owns it calls [`next`](Self::next) after every other call until it returns nothing, and
/// [`tick`](Self::tick) when [`deadline`](Self::deadline) has come. It recovers by itself from whatever the transport
/// loses, repeats or reorders; being told of connections only makes that faster.
///
/// A batch is sent after it was written to the spool. While the spool fails, batches are sent from memory: better
/// stored over there than nowhere.
#[derive(Clone, Debug)]
pub struct Sending {
    config: SendingConfig,
    host: HostDescription,
    secret: HostSecret,
    /// Events and numbered batches, in memory and in the spool.
    spooler: EventSpooler,
    reader: SpoolReader,
    renewal: StreamRenewal,
    trouble: SpoolTrouble,
    session: Session,
    lane: DurableLane,
    /// What the agent is still to be told.
    notices: VecDeque<Notice>,
}

impl Sending {
    /// The sending end of a host with its `secret`; `process` is a random number made at process start. Nothing is sent before
    /// [`connected`](Self::connected).
    pub fn new(
        config: SendingConfig,
        host: HostDescription,
        secret: HostSecret,
        process: u64,
        mut spool: SpoolState,
    ) -> Self {
        let budget = 2 * u64::from(config.window.max(1)) * config.batch_bytes as u64;
        Self {
            renewal: StreamRenewal::new(std::mem::take(&mut spool.reached)),
            spooler: EventSpooler::new(config, process, budget, spool),
            reader: SpoolReader::default(),
            trouble: SpoolTrouble::default(),
            session: Session::new(config),
            lane: DurableLane::new(config, budget),
            notices: VecDeque::new(),
            config,
            host,
            secret,
        }
    }

    /// Takes in an event, or drops and counts it. Never waits, never fails: when there is no room the newest events are
    /// dropped, and a gap stands in their place as soon as there is some.
    pub fn offer(&mut self, event: &Event, now: Stamp) {
        self.spooler.offer(event, now);
    }

    /// Events were dropped before they came here: counts them, as those that are dropped here.
    pub fn lost(&mut self, gap: &Gap, now: Stamp) {
        self.spooler.lost(gap, now);
    }

    /// Time has passed: cuts a batch that is old enough, reports losses, opens the connection anew when no
    /// acknowledgement came for too long.
    pub fn tick(&mut self, now: Stamp) {
        self.spooler.tick(now);
        self.lose_patience(now.mono);
    }

    /// When [`tick`](Self::tick) or [`next`](Self::next) has something to do without anything else happening.
    pub fn deadline(&self) -> Option<MonoTime> {
        let again = [self.reader.again(), self.renewal.again()];
        let times = [self.spooler.deadline(), self.link_deadline()].into_iter().chain(again);
        times.flatten().min()
    }

    /// What to do now; `None` when there is nothing.
    pub fn next(&mut self, now: MonoTime) -> Option<Action> {
        self.spooler
            .next(self.renewal.is_wanted(), now)
            .or_else(|| self.renewal.next(&self.spooler, now))
            .or_else(|| self.reader.next(&self.session.link, &self.spooler.backlog, now))
            .or_else(|| self.frame(now).map(Action::Send))
    }

    /// Reports losses and cuts the batch under construction now: before a stop. All is safe when
    /// [`is_spooled`](Self::is_spooled).
    pub fn flush(&mut self, now: WallTime) {
        self.spooler.flush(now);
    }

    /// Whether a write to the spool is under way that may make something safe.
    pub const fn is_appending(&self) -> bool {
        self.spooler.is_appending()
    }

    /// The end of a process that could not make everything safe: what is in memory only counts as dropped. The spool is
    /// to keep these totals, so that the next process tells how much is missing. Of what was sent and not acknowledged
    /// nobody knows whether it is stored: it counts as well.
    pub fn give_up(&mut self) -> Totals {
        self.spooler.give_up()
    }

    /// Whether something was sent that may be stored, although it is neither in the spool nor acknowledged.
    pub fn has_sent_unspooled(&self) -> bool {
        self.spooler.has_sent_unspooled()
    }

    /// Events that are in memory only.
    pub fn unspooled_events(&self) -> u64 {
        self.spooler.unspooled_events()
    }

    /// The frame that says goodbye; `None` when nobody knows us, so that a refused copy cannot say it in our name.
    pub fn goodbye(&mut self) -> Option<Vec<u8>> {
        let known = self.is_up();
        self.disconnected();
        known.then(|| codec::encode(&ToAggregator::Goodbye(self.host.id)))
    }

    /// Whether the aggregator knows us, and live updates make sense.
    pub const fn is_up(&self) -> bool {
        self.session.is_up()
    }

    /// Whether a live update may go now: it would not wait for long on its way, and the durable lane had its share of a
    /// link that is too narrow for both. What it would have said goes into the next.
    pub fn may_show(&self) -> bool {
        self.is_up() && self.lane.may_show()
    }

    /// Whether what is sent is to be compressed.
    pub const fn compresses(&self) -> bool {
        self.lane.compresses()
    }

    /// Version of the event stream that was chosen for the connection; the oldest before one was.
    pub const fn version(&self) -> u16 {
        self.session.version()
    }

    /// A live update of so many bytes was sent.
    pub const fn shown(&mut self, bytes: usize) {
        self.lane.shown(bytes as u64);
    }

    /// Whether nothing is in memory that is neither in the spool nor stored.
    pub fn is_spooled(&self) -> bool {
        self.spooler.unspooled_events() == 0
    }

    /// Whether everything that was taken in is stored.
    pub fn is_idle(&self) -> bool {
        self.spooler.is_idle()
    }

    /// What became of the events.
    pub fn accounting(&self) -> Accounting {
        self.spooler.accounting(self.lane.compresses(), self.trouble.reason())
    }

    /// Runs that have ended and whose events are all in the spool or dropped, and how many events that are: who counts
    /// them as well may forget them, and then has them [forgotten](Self::forget_run) here.
    pub fn settled_runs(&self) -> Vec<(RunId, u64)> {
        self.spooler.settled_runs()
    }

    /// Whether no loss is to be reported, now or later.
    #[cfg(test)]
    pub(super) fn has_reported_all(&self) -> bool {
        self.spooler.has_reported_all()
    }

    /// Events that were handed in to this process and are in the spool or dropped, by what the spool itself says.
    pub const fn settled_events(&self) -> u64 {
        self.spooler.settled_events()
    }

    /// The batch that was sent last without being in the spool, because that cannot be written. To be kept where it outlives
    /// the process before its frame goes out.
    pub fn sent_unspooled(&self) -> Option<SentUnspooled> {
        self.spooler.sent_unspooled()
    }

    /// A run that has ended is no longer counted separately.
    pub fn forget_run(&mut self, run: RunId) {
        self.spooler.forget_run(run);
    }

    /// Whose events these are.
    pub const fn host(&self) -> HostId {
        self.host.id
    }

    /// The host, to be described anew when the connection is next opened.
    pub const fn describe(&mut self) -> &mut HostDescription {
        &mut self.host
    }

    /// The batches of the last [`Action::Append`] are in the spool.
    pub fn appended(&mut self, now: Stamp) -> Option<Notice> {
        if self.spooler.appended(now)? {
            self.recovered(SpoolWork::Append);
        }
        self.notice()
    }

    /// They are not, none of them.
    pub fn append_failed(&mut self, reason: String, now: Stamp) -> Option<Notice> {
        self.spooler.append_failed(now.mono)?;
        self.failed(SpoolWork::Append, reason)
    }

    /// What [`Action::Load`] asked for; a batch that was not found ends the list.
    pub fn loaded(&mut self, batches: Vec<SpooledBatch>, now: Stamp) -> Option<Notice> {
        let loading = self.reader.end()?;
        self.recovered(SpoolWork::Load);
        self.read(loading, batches, now);
        self.notice()
    }

    /// It could not be read.
    pub fn load_failed(&mut self, reason: String, now: Stamp) -> Option<Notice> {
        self.reader.fail(now.mono, self.config.spool_pause)?;
        self.failed(SpoolWork::Load, reason)
    }

    /// The batches of the last [`Action::Delete`] are gone.
    pub fn deleted(&mut self) {
        if self.spooler.deleted().is_some() {
            self.recovered(SpoolWork::Delete);
        }
    }

    /// They are not.
    pub fn delete_failed(&mut self, reason: String, now: Stamp) -> Option<Notice> {
        self.spooler.delete_failed(now.mono)?;
        self.failed(SpoolWork::Delete, reason)
    }

    /// The spool belongs to the stream of the last [`Action::Renew`].
    pub fn renewed(&mut self, now: Stamp) {
        let Some(stream) = self.renewal.end() else { return };
        self.spooler.renew(stream);
        self.recovered(SpoolWork::Renew);
        self.greet_again(now.mono);
    }

    /// It does not.
    pub fn renew_failed(&mut self, reason: String, now: Stamp) -> Option<Notice> {
        self.renewal.fail(now.mono, self.config.spool_pause)?;
        self.failed(SpoolWork::Renew, reason)
    }

    fn failed(&mut self, work: SpoolWork, reason: String) -> Option<Notice> {
        self.notices.extend(self.trouble.fail(work, reason));
        self.notice()
    }

    fn recovered(&mut self, work: SpoolWork) {
        self.notices.extend(self.trouble.recover(work));
    }

    fn notice(&mut self) -> Option<Notice> {
        self.notices.pop_front()
    }
}

#[cfg(test)]
mod tests;
