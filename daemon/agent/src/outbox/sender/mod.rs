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
use super::spool::{SpoolRequest, SpoolResult, SpoolTask, SpoolTaskError};
use crate::event_queue::QueueReceiver;
use crate::live;
use crate::reconnect_backoff::ReconnectBackoff;
use crate::runs::Runs;

/// Interval at which the queue is emptied while events arrive.
// The queue is polled, because waking the task for each event would cost the pipelines more time.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Longest wait for the aggregator's answer to the hello.
const WELCOME_TIMEOUT: Duration = Duration::from_secs(5);

/// Longest time for passing the last update and the goodbye to the socket. The socket then has the same time again to
/// send them.
const LAST_FRAMES_TIMEOUT: Duration = Duration::from_millis(250);

/// Longest time for three steps together: recording losses, sending the last frames, and closing the spool. The content
/// of the spool is safe even if the spool is not closed.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

/// State of the outbox task.
#[derive(Debug)]
pub(super) struct Sender {
    /// Sending end of the event stream.
    state_machine: Sending,
    spool: SpoolTask,
    intake: EventIntake,
    live_lane: LiveLane,
    accounting_sender: watch::Sender<Accounting>,
    clock: SharedClock,
    reports: Reports,
    /// Frames that the socket could not take yet; at most the frames of one window of batches.
    unsent_frames: VecDeque<Vec<u8>>,
    /// `true` if the latest attempt to reach the aggregator failed, or if the connection was lost.
    is_unreachable: bool,
}

impl Sender {
    pub(super) fn new(
        state_machine: Sending,
        spool: SpoolTask,
        receiver: QueueReceiver,
        accounting_sender: watch::Sender<Accounting>,
        reports: Reports,
        clock: SharedClock,
        (runs, live): (Runs, LiveSources),
    ) -> Self {
        let intake = EventIntake::new(receiver, runs, clock.mono());
        let (live_lane, unsent_frames) = (LiveLane::new(live), VecDeque::new());
        Self {
            state_machine,
            spool,
            intake,
            live_lane,
            accounting_sender,
            clock,
            reports,
            unsent_frames,
            is_unreachable: false,
        }
    }

    /// Sends events until `stop` receives a deadline. Then writes the remaining events to the spool, and sends them as
    /// long as the aggregator stores events in time.
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
        let mut live_updates = tokio::time::interval(live::INTERVAL);
        for ticks in [&mut polls, &mut live_updates] {
            // After a stall one tick suffices, because each tick empties the queue completely.
            ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        }
        let mut stop_deadline = pin!(deadline_of(stop));
        let mut shutdown: Option<Shutdown> = None;
        let mut shutdown_timer = pin!(tokio::time::sleep(Duration::ZERO));
        let mut welcome_timeout = pin!(tokio::time::sleep(Duration::ZERO));
        // `true` while a connection is open on which no message has been received yet.
        let mut awaits_welcome = false;
        let mut connection_state = ConnectionState::start_connecting(&address, Duration::ZERO);
        loop {
            // While frames or a live update wait, the connection reports when the socket takes frames again.
            let is_blocked = self.live_lane.is_blocked() || !self.unsent_frames.is_empty();
            let is_quiet = self.intake.is_quiet(self.clock.mono());
            tokio::select! {
                // The stop is the first branch and the event queue one of the last, so that a stream of events delays
                // neither the stop nor live updates.
                biased;
                deadline = &mut stop_deadline, if shutdown.is_none() => {
                    shutdown = Some(Shutdown::start(Instant::now(), deadline, self.state_machine.accounting().stored));
                    self.drain_queue();
                }
                _ = live_updates.tick() => {
                    self.live_lane.mark_due();
                    // The counter's file counts queued events in shared memory, where other programs can delete it.
                    self.intake.recreate_counter_if_deleted();
                    self.drain_queue();
                }
                result = self.spool.next_result() => {
                    self.handle_spool_result(result.ok_or(SpoolTaskError::Ended)?);
                }
                event = connection_state.next(is_blocked) => match event {
                    ConnectionEvent::Connected(connection) => {
                        awaits_welcome = true;
                        welcome_timeout.as_mut().reset(Instant::now() + WELCOME_TIMEOUT);
                        self.is_unreachable = false;
                        self.state_machine.on_connected(self.clock.mono());
                        connection_state = ConnectionState::Open(connection);
                    }
                    ConnectionEvent::Failed(reason) => {
                        self.handle_lost_connection();
                        self.reports.report_unreachable(&address, &reason);
                        connection_state = ConnectionState::start_connecting(&address, reconnect_backoff.next_pause());
                    }
                    ConnectionEvent::Lost(reason) => {
                        awaits_welcome = false;
                        self.handle_lost_connection();
                        self.reports.report_unreachable(&address, &reason);
                        connection_state = ConnectionState::start_connecting(&address, reconnect_backoff.next_pause());
                    }
                    ConnectionEvent::Message(frame) => {
                        // Only a valid message proves that an aggregator answers: other programs accept connections as
                        // well.
                        if self.handle_frame(&frame) {
                            awaits_welcome = false;
                            reconnect_backoff.reset();
                        }
                    }
                    // `perform_actions` below sends the unsent frames.
                    ConnectionEvent::SendReady => {}
                },
                () = &mut welcome_timeout, if awaits_welcome => {
                    awaits_welcome = false;
                    self.handle_lost_connection();
                    self.reports.report_silent_peer(&address);
                    connection_state = ConnectionState::start_connecting(&address, reconnect_backoff.next_pause());
                }
                _ = polls.tick(), if !is_quiet => self.drain_queue(),
                Some(event) = self.intake.next(), if is_quiet => {
                    self.intake.offer(&mut self.state_machine, &event, self.clock.stamp());
                    self.drain_queue();
                }
                // The timer wakes the loop; `continue_until` below then decides whether the shutdown is complete.
                () = &mut shutdown_timer, if shutdown.is_some() => {}
            }
            if shutdown.is_some() {
                // During shutdown an event does not wait for its batch to fill.
                self.drain_queue();
                self.state_machine.flush(self.clock.wall());
            }
            self.perform_actions(&connection_state)?;
            self.publish();
            if let Some(shutdown) = &mut shutdown {
                match shutdown.continue_until(Instant::now(), self.outbox_state()) {
                    Some(end) => shutdown_timer.as_mut().reset(end),
                    None => break,
                }
            }
        }
        self.close(connection_state).await;
        Ok(())
    }

    /// Moves all queued events to the state machine, and advances its time.
    fn drain_queue(&mut self) {
        self.intake.drain(&mut self.state_machine, self.clock.stamp());
    }

    /// Handles the loss of the connection, or a failed attempt.
    fn handle_lost_connection(&mut self) {
        self.state_machine.on_disconnected();
        self.unsent_frames.clear();
        self.live_lane.reset();
        self.is_unreachable = true;
    }

    /// Records the losses, sends the last frames, and closes the connection and the spool.
    async fn close(mut self, connection_state: ConnectionState) {
        let close_deadline = Instant::now() + CLOSE_TIMEOUT;
        self.record_losses(close_deadline).await;
        let accounting = self.current_accounting();
        if accounting.waiting > 0 {
            tracing::info!(
                events = accounting.waiting,
                "stopped; the events in the spool are sent after the next start"
            );
        }
        let ended_connections = self.live_lane.unreported_ends();
        // If a session is up, the last update contains the final totals of the ended connections.
        if ended_connections > 0 && !self.state_machine.is_up() {
            tracing::warn!(
                connections = ended_connections,
                "stopped while no aggregator answered; the traffic of these ended connections to clouds since the last live \
                 update is not stored"
            );
        }
        if let ConnectionState::Open(connection) = connection_state {
            let frames = self.last_frames();
            if tokio::time::timeout(LAST_FRAMES_TIMEOUT, connection.deliver(frames)).await.is_err() {
                tracing::debug!("the socket could not take the last frames in time");
            }
            connection.close(LAST_FRAMES_TIMEOUT).await;
        }
        self.publish();
        match tokio::time::timeout_at(close_deadline, self.spool.close()).await {
            Ok(Ok(())) => {
                self.intake.remove_counter(self.state_machine.settled_events());
            }
            Ok(Err(reason)) => tracing::warn!("{reason}"),
            Err(_) => tracing::warn!(
                "the spool was not closed in time, its disk is slow; the agent stopped without waiting any longer, and the \
                 events in the spool are safe"
            ),
        }
    }

    /// Returns the last frames of a session: a live update, then the goodbye. The aggregator shows the state of this
    /// update until the host connects again, including the number of waiting events.
    fn last_frames(&mut self) -> Vec<Vec<u8>> {
        let update =
            || self.live_lane.update(&self.state_machine, self.clock.wall(), self.current_accounting()).0;
        let update = self.state_machine.is_up().then(update);
        update.into_iter().chain(self.state_machine.goodbye()).collect()
    }

    /// Handles the events that are only in memory at the end. If some of these events were sent, the aggregator may
    /// have stored them. The next start of the agent determines which events are stored, and reports the other events
    /// as lost. If no event was sent, all these events are lost. Their number is written to the spool, if the spool can
    /// be written, and the next start of the agent reports this number.
    async fn record_losses(&mut self, deadline: Instant) {
        if self.state_machine.is_spooled() {
            return;
        }
        self.drain_queue();
        if self.state_machine.is_appending() {
            // A write in progress may still succeed.
            let append_result = self.wait_for_append(deadline).await;
            self.handle_spool_result(SpoolResult::Appended(append_result));
        }
        if self.state_machine.is_spooled() {
            return;
        }
        let has_counter_file = self.intake.has_counter_file();
        let unspooled_events = self.state_machine.unspooled_events();
        if has_counter_file && self.state_machine.has_sent_unspooled() {
            // Only the aggregator knows which of these events it stored, so they must not be recorded as lost. The next
            // start computes the losses from the counter's file and the aggregator's answer.
            tracing::warn!(
                events = unspooled_events,
                "stopped before these events were in the spool or known to be stored; after the next start a gap reports the \
                 lost events"
            );
            return;
        }
        let dropped_before = self.state_machine.accounting().dropped;
        let totals = self.state_machine.give_up();
        let events = totals.dropped - dropped_before;
        let request = SpoolRequest::Append { batches: Vec::new(), totals };
        let append_result = match self.spool.request(request) {
            Ok(()) => self.wait_for_append(deadline).await,
            failure => failure,
        };
        match append_result {
            Ok(()) => tracing::warn!(
                events,
                "stopped before these events were in the spool or stored: they are lost; a gap reports them after the next \
                 start"
            ),
            // The spool lacks the number of lost events, but the next start computes it from the counter's file.
            Err(reason) if has_counter_file => tracing::warn!(
                events,
                %reason,
                "stopped before these events were in the spool or stored: they are lost; a gap reports them after the next \
                 start"
            ),
            Err(reason) => tracing::error!(
                events,
                %reason,
                "stopped before these events were in the spool or stored: they are lost, and no gap reports them"
            ),
        }
    }

    /// Waits for the result of the append in progress.
    async fn wait_for_append(&mut self, deadline: Instant) -> Result<(), SpoolTaskError> {
        loop {
            match tokio::time::timeout_at(deadline, self.spool.next_result()).await {
                Ok(Some(SpoolResult::Appended(append_result))) => return append_result,
                Ok(Some(_)) => {}
                Ok(None) => return Err(SpoolTaskError::Ended),
                Err(_) => return Err(SpoolTaskError::Slow),
            }
        }
    }
}

/// Waits for the deadline that `stop` receives. Waits for ever if the sender of `stop` is dropped.
async fn deadline_of(stop: oneshot::Receiver<Instant>) -> Instant {
    match stop.await {
        Ok(deadline) => deadline,
        Err(_) => std::future::pending().await,
    }
}
