//! The agent's end of the durable lane, and what both lanes may have on their way.

mod action;
mod backlog;
mod config;
mod durable;
mod earlier;
mod flow;
mod intake;
mod job;
mod link;
mod pace;
mod rest;
mod skim;
mod spooling;
mod under_way;

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Stamp, WallTime};

pub use self::action::{Action, Notice};
use self::backlog::Backlog;
pub use self::config::{Compression, SendingConfig};
use self::earlier::Earlier;
use self::flow::Flow;
use self::intake::{Intake, Room};
use self::link::Link;
use self::pace::Pace;
use self::rest::Rest;
use self::skim::Hole;
use self::spooling::Spooling;
use self::under_way::UnderWay;
use super::spool::SpoolState;
use super::totals::{Reached, Totals};
use super::{
    Accounting, Event, Gap, HandedIn, HostDescription, HostSecret, SentUnspooled, StreamId, ToAggregator,
    codec,
};
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
    process: u64,
    intake: Intake,
    backlog: Backlog,
    spooling: Spooling,
    link: Link,
    /// The stream that is to be gone on in; nothing is sent until the spool belongs to it.
    renewal: Option<StreamId>,
    /// Batches that the spool should hold and does not.
    hole: Option<Hole>,
    /// Whether the aggregator took this process in with the stream at hand.
    met: bool,
    /// How far the processes before this one came.
    reached_before: Vec<Reached>,
    /// What became of the end of one of them.
    earlier: Earlier,
    /// What may be under way, in units of batches, by the aggregator's word.
    window: u32,
    /// The proof that the aggregator asked for, to be sent at once.
    proof: Option<Vec<u8>>,
    /// Greetings since there last was progress.
    greetings: u32,
    /// Greetings on this connection since the last answer, and when the last of them went.
    asked: (u32, MonoTime),
    pace: Pace,
    flow: Flow,
    under_way: UnderWay,
    /// What is left of the batch that was sent last.
    rest: Option<Rest>,
    closing: bool,
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
        spool: SpoolState,
    ) -> Self {
        let budget = 2 * u64::from(config.window.max(1)) * config.batch_bytes as u64;
        let backlog = Backlog::new(&spool, budget);
        let Totals { produced, dropped, .. } = spool.totals;
        // What is held was produced, whatever the file says.
        let held = backlog.held().events;
        let produced = produced.max(dropped.saturating_add(held));
        let totals =
            Totals { produced, reached: None, handed_in: HandedIn::default(), ..spool.totals.clone() };
        Self {
            spooling: Spooling::new(&spool, backlog.acknowledged().0, totals.clone()),
            intake: Intake::new(config, totals, spool.unreported, spool.unresolved.is_some()),
            backlog,
            link: Link::Down,
            renewal: None,
            hole: None,
            met: false,
            reached_before: spool.reached,
            earlier: Earlier::new(spool.unresolved),
            window: 1,
            proof: None,
            greetings: 0,
            asked: (0, MonoTime::default()),
            pace: Pace::new(config.compression),
            flow: Flow::new(budget),
            under_way: UnderWay::default(),
            rest: None,
            closing: false,
            notices: VecDeque::new(),
            config,
            host,
            secret,
            process,
        }
    }

    /// Takes in an event, or drops and counts it. Never waits, never fails: when there is no room the newest events are
    /// dropped, and a gap stands in their place as soon as there is some.
    pub fn offer(&mut self, event: &Event, now: Stamp) {
        let room = self.room();
        self.intake.offer(event, &room, now);
        self.number();
    }

    /// Events were dropped before they came here: counts them, as those that are dropped here.
    pub fn lost(&mut self, gap: &Gap, now: Stamp) {
        self.intake.lost(gap, now);
    }

    /// Time has passed: cuts a batch that is old enough, reports losses, opens the connection anew when no
    /// acknowledgement came for too long.
    pub fn tick(&mut self, now: Stamp) {
        let room = self.room();
        self.intake.tick(&room, now);
        self.number();
        self.lose_patience(now.mono);
    }

    /// When [`tick`](Self::tick) or [`next`](Self::next) has something to do without anything else happening.
    pub fn deadline(&self) -> Option<MonoTime> {
        let times = [self.intake.deadline(&self.room()), self.link_deadline(), self.spool_deadline()];
        times.into_iter().flatten().min()
    }

    /// What to do now; `None` when there is nothing.
    pub fn next(&mut self, now: MonoTime) -> Option<Action> {
        self.spool_action(now).or_else(|| self.frame(now).map(Action::Send))
    }

    /// Reports losses and cuts the batch under construction now: before a stop. All is safe when
    /// [`is_spooled`](Self::is_spooled).
    pub fn flush(&mut self, now: WallTime) {
        let room = self.room();
        self.intake.flush(&room, now);
        self.number();
        self.closing = true;
    }

    /// Whether a write to the spool is under way that may make something safe.
    pub fn is_appending(&self) -> bool {
        self.spooling.is_appending()
    }

    /// The end of a process that could not make everything safe: what is in memory only counts as dropped. The spool is
    /// to keep these totals, so that the next process tells how much is missing. Of what was sent and not acknowledged
    /// nobody knows whether it is stored: it counts as well.
    pub fn give_up(&mut self) -> Totals {
        let lost = self.backlog.give_up();
        self.intake.give_up(lost, &self.backlog.settled().handed_in.taken);
        let unreported = self.earlier.unwritten().cloned();
        Totals { unreported, ..self.safe_totals().with(self.earlier.resolved()) }
    }

    /// Whether something was sent that may be stored, although it is neither in the spool nor acknowledged.
    pub fn has_sent_unspooled(&self) -> bool {
        self.backlog.sent() > self.backlog.spooled().max(self.backlog.oldest() - 1)
    }

    /// Events that are in memory only.
    pub fn unspooled_events(&self) -> u64 {
        self.intake.usage().events + self.backlog.pending().events
    }

    /// The frame that says goodbye; `None` when nobody knows us, so that a refused copy cannot say it in our name.
    pub fn goodbye(&mut self) -> Option<Vec<u8>> {
        let known = self.is_up();
        self.disconnected();
        known.then(|| codec::encode(&ToAggregator::Goodbye(self.host.id)))
    }

    /// Whether the aggregator knows us, and live updates make sense.
    pub const fn is_up(&self) -> bool {
        matches!(self.link, Link::Up { .. })
    }

    /// Whether a live update may go now: it would not wait for long on its way, and the durable lane had its share of a
    /// link that is too narrow for both. What it would have said goes into the next.
    pub fn may_show(&self) -> bool {
        self.is_up() && self.flow.may_show()
    }

    /// Whether what is sent is to be compressed.
    pub const fn compresses(&self) -> bool {
        self.pace.compresses()
    }

    /// A live update of so many bytes was sent.
    pub const fn shown(&mut self, bytes: usize) {
        self.flow.shown(bytes as u64);
    }

    /// Whether nothing is in memory that is neither in the spool nor stored.
    pub fn is_spooled(&self) -> bool {
        self.intake.usage().events == 0 && self.backlog.pending().events == 0
    }

    /// Whether everything that was taken in is stored.
    pub fn is_idle(&self) -> bool {
        self.intake.usage().events == 0 && self.backlog.held().events == 0
    }

    /// What became of the events.
    pub fn accounting(&self) -> Accounting {
        let (open, held, pending, stored) =
            (self.intake.usage(), self.backlog.held(), self.backlog.pending(), self.backlog.stored());
        let (produced, dropped) = self.earlier.count(self.intake.counted());
        let gaps = self.intake.counted().gaps;
        let waiting = open.events + held.events;
        debug_assert_eq!(produced, stored + waiting + dropped, "an event is not accounted for");
        Accounting {
            produced,
            spooled: stored + held.events.saturating_sub(pending.events),
            sent: stored + self.backlog.sent_events(),
            stored: stored,
            waiting,
            dropped,
            gaps,
            spool_bytes: self.spooling.bytes,
            spool_limit_bytes: self.config.spool_bytes,
            memory_bytes: open.bytes + pending.bytes,
            oldest: if held.events > 0 { self.backlog.since() } else { self.intake.since() },
            compressed: self.pace.compresses(),
            trouble: self.spooling.trouble(),
        }
    }

    /// Runs that have ended and whose events are all in the spool or dropped, and how many events that are: who counts
    /// them as well may forget them, and then has them [forgotten](Self::forget_run) here.
    pub fn settled_runs(&self) -> Vec<(RunId, u64)> {
        let events = |handed_in: &HandedIn, run| handed_in.taken.of(run) + handed_in.dropped.of(run);
        let (counted, written) = (&self.intake.counted().handed_in, &self.spooling.written.handed_in);
        let ended = self.intake.ended().iter().map(|run| (*run, events(counted, *run)));
        ended.filter(|(run, count)| events(written, *run) == *count).collect()
    }

    /// Whether no loss is to be reported, now or later.
    #[cfg(test)]
    pub(super) fn has_reported_all(&self) -> bool {
        self.intake.has_reported_all()
    }

    /// Events that were handed in to this process and are in the spool or dropped, by what the spool itself says.
    pub const fn settled_events(&self) -> u64 {
        let handed_in = &self.spooling.written.handed_in;
        handed_in.taken.all + handed_in.dropped.all
    }

    /// The batch that was sent last without being in the spool, because that cannot be written. To be kept where it outlives
    /// the process before its frame goes out.
    pub fn sent_unspooled(&self) -> Option<SentUnspooled> {
        self.backlog.sent_unspooled().map(|sent| self.earlier.place(sent))
    }

    /// A run that has ended is no longer counted separately.
    pub fn forget_run(&mut self, run: RunId) {
        self.intake.forget_run(run);
    }

    /// Whose events these are.
    pub const fn host(&self) -> HostId {
        self.host.id
    }

    /// The host, to be described anew when the connection is next opened.
    pub const fn describe(&mut self) -> &mut HostDescription {
        &mut self.host
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
            reached: self.spooling.written.reached,
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
                .saturating_sub(self.spooling.bytes)
                .saturating_sub(pending.bytes),
            spool_fails: self.spooling.fails_to_write(),
        }
    }

    /// All batches up to and including `through` are stored over there.
    fn acknowledged(&mut self, through: u64, skimmed: Option<skim::Skimmed>, now: Stamp) {
        let writing = self.spooling.writing();
        let freed = self.backlog.free(through, skimmed, writing);
        if skimmed.is_some() {
            // It was passed, or is found again.
            self.hole = None;
        }
        self.spooling.freed(freed, now.mono);
        let (bytes, end) = self.under_way.acknowledged(through);
        self.pace.acknowledged(bytes, now.mono);
        self.flow.arrived(end, now.mono);
        self.rest.take_if(|rest| rest.number() <= through);
        let room = self.room();
        self.intake.report_losses(&room, now);
        self.number();
    }
}

#[cfg(test)]
mod tests;
