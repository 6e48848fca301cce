//! The outbox task. It connects the event queue, the sending end of the event stream, the spool, and the connection.

mod event_intake;
mod live_lane;
mod reactions;

use std::collections::VecDeque;
use std::pin::pin;
use std::time::Duration;

use peernet_clock::SharedClock;
use peernet_networks::Address;
use peernet_stream::{Accounting, Sending};
use tokio::sync::{oneshot, watch};
use tokio::time::{Instant, MissedTickBehavior};

use self::event_intake::EventIntake;
use self::live_lane::LiveLane;
use super::connection_state::{ConnectionEvent, ConnectionState};
use super::live_sources::LiveSources;
use super::reports::Reports;
use super::shutdown::Shutdown;
use super::spool::{Done, Order, SpoolTask, SpoolTaskError};
use crate::event_queue::QueueReceiver;
use crate::live;
use crate::reconnect_backoff::ReconnectBackoff;
use crate::runs::Runs;

/// Interval at which the queue is emptied while events come. It is polled, because waking the task for each event
/// would cost the pipeline more.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Longest wait for the aggregator's answer to the hello. Its machine may be busy, but not for longer.
const WELCOME_TIMEOUT: Duration = Duration::from_secs(5);

/// Longest wait for room for the last update and the goodbye, and then for their being sent.
const LAST_FRAMES_TIMEOUT: Duration = Duration::from_millis(250);

/// Longest time for closing the spool. Its content is safe without it.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

/// State of the outbox task.
#[derive(Debug)]
pub(super) struct Sender {
    machine: Sending,
    spool: SpoolTask,
    intake: EventIntake,
    live: LiveLane,
    accounting: watch::Sender<Accounting>,
    clock: SharedClock,
    reports: Reports,
    /// Frames for which the connection had no room: a window of batches at most.
    held: VecDeque<Vec<u8>>,
    /// `true` if the last attempt to reach the aggregator failed.
    away: bool,
}

impl Sender {
    pub(super) fn new(
        machine: Sending,
        spool: SpoolTask,
        receiver: QueueReceiver,
        accounting: watch::Sender<Accounting>,
        reports: Reports,
        clock: SharedClock,
        (runs, live): (Runs, LiveSources),
    ) -> Self {
        let intake = EventIntake::new(receiver, runs, clock.mono());
        let (live, held) = (LiveLane::new(live), VecDeque::new());
        Self { machine, spool, intake, live, accounting, clock, reports, held, away: false }
    }

    /// Sends until `stop` names a deadline. Then the remaining events are written to the spool, and sent as long as
    /// the aggregator stores them.
    ///
    /// # Errors
    /// When the spool's task has ended.
    pub(super) async fn run(
        mut self,
        address: Address,
        mut reconnect_backoff: ReconnectBackoff,
        stop: oneshot::Receiver<Instant>,
    ) -> Result<(), SpoolTaskError> {
        let mut polls = tokio::time::interval(POLL_INTERVAL);
        let mut shows = tokio::time::interval(live::INTERVAL);
        for ticks in [&mut polls, &mut shows] {
            // One tick is enough after a stall, because each empties the queue completely.
            ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        }
        let mut stopping = pin!(deadline_of(stop));
        let mut shutdown: Option<Shutdown> = None;
        let mut alarm = pin!(tokio::time::sleep(Duration::ZERO));
        let mut welcome = pin!(tokio::time::sleep(Duration::ZERO));
        // Whether a connection is open on which nothing has been received yet.
        let mut unanswered = false;
        let mut connection_state = ConnectionState::dial(&address, Duration::ZERO);
        loop {
            let blocked = self.live.is_blocked() || !self.held.is_empty();
            let quiet = self.intake.is_quiet(self.clock.mono());
            tokio::select! {
                biased;
                deadline = &mut stopping, if shutdown.is_none() => {
                    shutdown = Some(Shutdown::begin(Instant::now(), deadline, self.machine.accounting().stored));
                    self.take();
                }
                _ = shows.tick() => {
                    self.live.fall_due();
                    self.intake.keep_counter();
                    self.take();
                }
                done = self.spool.done() => {
                    self.spooled(done.ok_or(SpoolTaskError::Ended)?);
                }
                event = connection_state.next(blocked) => match event {
                    ConnectionEvent::Connected(connection) => {
                        unanswered = true;
                        welcome.as_mut().reset(Instant::now() + WELCOME_TIMEOUT);
                        self.away = false;
                        self.machine.connected(self.clock.mono());
                        connection_state = ConnectionState::Open(connection);
                    }
                    ConnectionEvent::Failed(reason) => {
                        self.lost();
                        self.reports.away(&address, &reason);
                        connection_state = ConnectionState::dial(&address, reconnect_backoff.next_pause());
                    }
                    ConnectionEvent::Gone(reason) => {
                        unanswered = false;
                        self.lost();
                        self.reports.away(&address, &reason);
                        connection_state = ConnectionState::dial(&address, reconnect_backoff.next_pause());
                    }
                    ConnectionEvent::Message(frame) => {
                        // Only a valid message proves that an aggregator answers: other programs may accept
                        // connections as well.
                        if self.handle_frame(&frame) {
                            unanswered = false;
                            reconnect_backoff.reset();
                        }
                    }
                    // Frames are sent below.
                    ConnectionEvent::Room => {}
                },
                () = &mut welcome, if unanswered => {
                    unanswered = false;
                    self.lost();
                    self.reports.silent(&address);
                    connection_state = ConnectionState::dial(&address, reconnect_backoff.next_pause());
                }
                _ = polls.tick(), if !quiet => self.take(),
                Some(event) = self.intake.next(), if quiet => {
                    self.intake.offer(&mut self.machine, &event, self.clock.stamp());
                    self.take();
                }
                () = &mut alarm, if shutdown.is_some() => {}
            }
            if shutdown.is_some() {
                // During shutdown an event does not wait for its batch to fill.
                self.take();
                self.machine.flush(self.clock.wall());
            }
            self.act(&connection_state)?;
            self.publish();
            if let Some(shutdown) = &mut shutdown {
                match shutdown.next(Instant::now(), self.state()) {
                    Some(until) => alarm.as_mut().reset(until),
                    None => break,
                }
            }
        }
        self.leave(connection_state).await;
        Ok(())
    }

    /// Moves all queued events to the state machine, and advances its time.
    fn take(&mut self) {
        self.intake.drain(&mut self.machine, self.clock.stamp());
    }

    /// Handles the loss of the connection, or a failed attempt.
    fn lost(&mut self) {
        self.machine.disconnected();
        self.held.clear();
        self.live.reset();
        self.away = true;
    }

    async fn leave(mut self, connection_state: ConnectionState) {
        let closed = Instant::now() + CLOSE_TIMEOUT;
        self.give_up(closed).await;
        let account = self.count();
        if account.waiting > 0 {
            tracing::info!(
                events = account.waiting,
                "stopped; what waits in the spool goes out after the next start"
            );
        }
        let connections = self.live.unreported_ends();
        // If a session is up, the last update contains the ends of these connections.
        if connections > 0 && !self.machine.is_up() {
            tracing::warn!(
                connections,
                "stopped while no aggregator answered: what these connections to clouds sent and received since the last live figures is \
                 not stored"
            );
        }
        if let ConnectionState::Open(connection) = connection_state {
            let frames = self.last_frames();
            if tokio::time::timeout(LAST_FRAMES_TIMEOUT, connection.deliver(frames)).await.is_err() {
                tracing::debug!("the connection had no room for the last words");
            }
            connection.close(LAST_FRAMES_TIMEOUT).await;
        }
        self.publish();
        match tokio::time::timeout_at(closed, self.spool.close()).await {
            Ok(Ok(())) => {
                self.intake.remove_counter(self.machine.settled_events());
            }
            Ok(Err(reason)) => tracing::warn!("{reason}"),
            Err(_) => tracing::warn!("not waited for: the spool's disk takes long to close it"),
        }
    }

    /// Returns the last frames of a session: a live update and the goodbye, in this order. The aggregator shows the
    /// state of that update until the host comes back; from it follows whether the host left with nothing waiting.
    fn last_frames(&mut self) -> Vec<Vec<u8>> {
        let update = || self.live.update(&self.machine, self.clock.wall(), self.count()).0;
        let update = self.machine.is_up().then(update);
        update.into_iter().chain(self.machine.goodbye()).collect()
    }

    /// Handles events that are only in memory at the end: they are lost, and their number goes into the spool, for
    /// the next start to report.
    async fn give_up(&mut self, by: Instant) {
        if self.machine.is_spooled() {
            return;
        }
        self.take();
        if self.machine.is_appending() {
            // A write in progress may still succeed.
            let appended = self.appended(by).await;
            self.spooled(Done::Appended(appended));
        }
        if self.machine.is_spooled() {
            return;
        }
        let counted = self.intake.is_counted();
        let unsafe_events = self.machine.unspooled_events();
        if counted && self.machine.has_sent_unspooled() {
            // Only the aggregator knows which of these it stored. Writing now that all are lost would be wrong.
            tracing::warn!(
                events = unsafe_events,
                "stopped before these events were in the spool or known to be stored; after the next start a gap will say \
                 which are lost"
            );
            return;
        }
        let dropped = self.machine.accounting().dropped;
        let totals = self.machine.give_up();
        let events = totals.dropped - dropped;
        let order = Order::Append { batches: Vec::new(), totals };
        let kept = match self.spool.order(order) {
            Ok(()) => self.appended(by).await,
            refused => refused,
        };
        match kept {
            Ok(()) => tracing::warn!(
                events,
                "stopped before these events were in the spool or stored: they are lost, and a gap will say so after \
                 the next start"
            ),
            Err(reason) if counted => tracing::warn!(
                events,
                %reason,
                "stopped before these events were in the spool or stored: they are lost, and a gap will say so after \
                 the next start"
            ),
            Err(reason) => tracing::error!(
                events,
                %reason,
                "stopped before these events were in the spool or stored: they are lost, and no gap will say so"
            ),
        }
    }

    /// Waits for the result of the append in progress.
    async fn appended(&mut self, by: Instant) -> Result<(), SpoolTaskError> {
        loop {
            match tokio::time::timeout_at(by, self.spool.done()).await {
                Ok(Some(Done::Appended(appended))) => return appended,
                Ok(Some(_)) => {}
                Ok(None) => return Err(SpoolTaskError::Ended),
                Err(_) => return Err(SpoolTaskError::Slow),
            }
        }
    }
}

/// Waits for the deadline that `stop` names; for ever if it is dropped.
async fn deadline_of(stop: oneshot::Receiver<Instant>) -> Instant {
    match stop.await {
        Ok(deadline) => deadline,
        Err(_) => std::future::pending().await,
    }
}
