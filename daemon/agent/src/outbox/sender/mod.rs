//! The outbox task: between the feed, the sending end of the event stream, the spool, and the connection.

mod account;
mod giving_up;
mod hearing;
mod lanes;

use std::collections::VecDeque;
use std::pin::pin;
use std::time::Duration;

use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_networks::Address;
use peernet_stream::{Accounting, Sending};
use tokio::sync::{oneshot, watch};
use tokio::time::{Instant, MissedTickBehavior};

use super::farewell::Farewell;
use super::line::{Happened, Line};
use super::live_sources::LiveSources;
use super::reports::Reports;
use super::spool::{SpoolTask, SpoolTaskError};
use crate::feed::Exit;
use crate::live;
use crate::pauses::Pauses;
use crate::runs::Runs;

/// How often the feed is emptied while events come. Looking is cheaper than being woken for each event, above all for
/// the pipeline that would have to do the waking.
const LOOK: Duration = Duration::from_millis(20);

/// Without an event for so long, the next one wakes the task, and looks cost nothing until then.
const QUIET: Span = Span::from_millis(500);

/// How long an aggregator may take to answer the hello; its machine may be busy, but not for this long.
const WELCOME: Duration = Duration::from_secs(5);

/// How long the last words may wait for room, and how long they may take to go out then.
const LINGER: Duration = Duration::from_millis(250);

/// How long closing the spool may take: what is in it is safe without.
const CLOSING: Duration = Duration::from_secs(2);

/// What the task works with.
#[derive(Debug)]
pub(super) struct Sender {
    machine: Sending,
    spool: SpoolTask,
    exit: Exit,
    live: LiveSources,
    accounting: watch::Sender<Accounting>,
    clock: SharedClock,
    runs: Runs,
    reports: Reports,
    /// When the feed last held an event.
    fed: MonoTime,
    /// Frames that the connection had no room for: a window of batches at most.
    held: VecDeque<Vec<u8>>,
    /// A live update is due.
    due: bool,
    /// It waits for room on the connection, not for the way to be free.
    blocked: bool,
    /// The last try to reach the aggregator failed.
    away: bool,
}

impl Sender {
    pub(super) fn new(
        machine: Sending,
        spool: SpoolTask,
        exit: Exit,
        accounting: watch::Sender<Accounting>,
        reports: Reports,
        clock: SharedClock,
        (runs, live): (Runs, LiveSources),
    ) -> Self {
        let (fed, held, due, blocked, away) = (clock.mono(), VecDeque::new(), false, false, false);
        Self { machine, spool, exit, live, accounting, clock, runs, reports, fed, held, due, blocked, away }
    }

    /// Sends until it is told to stop, and by when: then what is left is made safe, and sent as long as it is taken.
    ///
    /// # Errors
    /// When the spool's task has gone.
    pub(super) async fn run(
        mut self,
        address: Address,
        mut pauses: Pauses,
        stop: oneshot::Receiver<Instant>,
    ) -> Result<(), SpoolTaskError> {
        let mut looks = tokio::time::interval(LOOK);
        let mut shows = tokio::time::interval(live::INTERVAL);
        for ticks in [&mut looks, &mut shows] {
            ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        }
        let mut stopping = pin!(told(stop));
        let mut farewell: Option<Farewell> = None;
        let mut alarm = pin!(tokio::time::sleep(Duration::ZERO));
        let mut welcome = pin!(tokio::time::sleep(Duration::ZERO));
        // Whether the connection is there, but nothing was heard on it yet.
        let mut unanswered = false;
        let mut line = Line::dial(&address, Duration::ZERO);
        loop {
            let blocked = self.due && self.blocked || !self.held.is_empty();
            let quiet = self.clock.mono() - self.fed >= QUIET;
            tokio::select! {
                biased;
                deadline = &mut stopping, if farewell.is_none() => {
                    farewell = Some(Farewell::begin(Instant::now(), deadline, self.machine.accounting().stored));
                    self.take();
                }
                _ = shows.tick() => {
                    self.due = true;
                    self.exit.counter.keep();
                    self.take();
                }
                done = self.spool.done() => {
                    self.spooled(done.ok_or(SpoolTaskError::Ended)?);
                }
                event = line.next(blocked) => match event {
                    Happened::Connected(connection) => {
                        unanswered = true;
                        welcome.as_mut().reset(Instant::now() + WELCOME);
                        self.away = false;
                        self.machine.connected(self.clock.mono());
                        line = Line::Open(connection);
                    }
                    Happened::Failed(reason) => {
                        self.lost();
                        self.reports.away(&address, &reason);
                        line = Line::dial(&address, pauses.grow());
                    }
                    Happened::Gone(reason) => {
                        unanswered = false;
                        self.lost();
                        self.reports.away(&address, &reason);
                        line = Line::dial(&address, pauses.grow());
                    }
                    Happened::Message(frame) => {
                        if self.hear(&frame) {
                            unanswered = false;
                            pauses.reset();
                        }
                    }
                    // It is filled below.
                    Happened::Room => {}
                },
                () = &mut welcome, if unanswered => {
                    unanswered = false;
                    self.lost();
                    self.reports.mute(&address);
                    line = Line::dial(&address, pauses.grow());
                }
                _ = looks.tick(), if !quiet => self.take(),
                Some(event) = self.exit.queue.recv(), if quiet => {
                    self.offer(&event, self.clock.stamp());
                    self.take();
                }
                () = &mut alarm, if farewell.is_some() => {}
            }
            if farewell.is_some() {
                // What comes in now does not wait for company.
                self.take();
                self.machine.flush(self.clock.wall());
            }
            self.act(&line)?;
            self.publish();
            if let Some(farewell) = &mut farewell {
                match farewell.next(Instant::now(), self.standing()) {
                    Some(until) => alarm.as_mut().reset(until),
                    None => break,
                }
            }
        }
        self.leave(line).await;
        Ok(())
    }

    /// There is no connection.
    fn lost(&mut self) {
        self.machine.disconnected();
        self.held.clear();
        (self.due, self.blocked) = (false, false);
        self.away = true;
    }

    async fn leave(mut self, line: Line) {
        let closed = Instant::now() + CLOSING;
        self.give_up(closed).await;
        let account = self.count();
        if account.waiting > 0 {
            tracing::info!(
                events = account.waiting,
                "stopped; what waits in the spool goes out after the next start"
            );
        }
        if let Line::Open(connection) = line {
            let words = self.last_words();
            if tokio::time::timeout(LINGER, connection.deliver(words)).await.is_err() {
                tracing::debug!("the connection had no room for the last words");
            }
            connection.close(LINGER).await;
        }
        self.publish();
        match tokio::time::timeout_at(closed, self.spool.close()).await {
            Ok(Ok(())) => {
                if self.exit.counter.all() == Some(self.machine.settled_events()) {
                    self.exit.counter.remove();
                }
            }
            Ok(Err(reason)) => tracing::warn!("{reason}"),
            Err(_) => tracing::warn!("not waited for: the spool's disk takes long to close it"),
        }
    }
}

/// By when to end, once somebody says so.
async fn told(stop: oneshot::Receiver<Instant>) -> Instant {
    match stop.await {
        Ok(deadline) => deadline,
        Err(_) => std::future::pending().await,
    }
}
