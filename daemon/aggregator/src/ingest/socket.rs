//! The ingest task, the only owner of the socket. It never waits for the database, because live updates have to arrive
//! while a commit syncs or the database is closed.

use std::time::Duration;

use bytes::Bytes;
use peernet_clock::SharedClock;
use peernet_networks::descriptors::DescriptorShare;
use peernet_networks::zmtp::{ListenerLimits, ZmtpListener, ZmtpSender};
use peernet_networks::{Address, ListenerEvent};
use peernet_stream::codec::{self, MAX_MESSAGE_BYTES};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::committing::StoreEvent;
use super::routes::Admission;
use super::session::{IngestSession, RejectedCounts};
use crate::config::AggregatorConfig;
use crate::error::{Failure, Problem, StartError};
use crate::live::LiveEvent;

/// Longest queue of replies to one agent. A reply that does not fit into the queue is dropped; the agent repeats its
/// request and gets the reply then.
const MAX_QUEUED_REPLIES: usize = 16;
/// Interval of dropping silent hosts and of reporting rejected messages.
const EXPIRY_INTERVAL: Duration = Duration::from_secs(5);
/// Interval of ZeroMQ's heartbeats.
const HEARTBEAT_INTERVAL: Duration = Duration::from_secs(2);
/// Time without any frame after which a connection is closed.
const HEARTBEAT_TIMEOUT: Duration = Duration::from_secs(10);
/// Longest time for sending the last acknowledgements at the end.
const LINGER: Duration = Duration::from_millis(500);
/// Number of bytes that a message may have in addition to its payload, for the ZMTP framing.
const FRAMING_BYTES: usize = 4_096;

/// Listens. Returns the socket and its address with the actual port.
pub(crate) async fn listen(config: &AggregatorConfig) -> Result<(ZmtpListener, String), StartError> {
    let listen = &config.listen;
    let address: Address =
        listen.parse().map_err(|error| Problem { key: "listen", message: format!("{error}") })?;
    let limits = ListenerLimits {
        // Agents get a share of the file descriptors, so that agents leave some to the database and the dashboard.
        max_connections: DescriptorShare::EventPort.max_connections(),
        max_message_bytes: MAX_MESSAGE_BYTES + FRAMING_BYTES,
        max_unfinished_bytes: config.max_unfinished_bytes,
        hello_timeout: config.hello_timeout(),
        max_queued_messages: MAX_QUEUED_REPLIES,
        max_queued_bytes: MAX_MESSAGE_BYTES,
        heartbeat_interval: HEARTBEAT_INTERVAL,
        heartbeat_timeout: HEARTBEAT_TIMEOUT,
    };
    let listener = ZmtpListener::bind(&address.authority(), limits)
        .await
        .map_err(|source| StartError::Listen { address: listen.clone(), source })?;
    let bound = listener.address();
    Ok((listener, Address::from_ip(bound.ip(), bound.port()).to_string()))
}

/// The channels and shared objects of the ingest task.
pub(crate) struct TaskContext {
    pub(crate) store_events: mpsc::Receiver<StoreEvent>,
    pub(crate) live_events: mpsc::Sender<LiveEvent>,
    pub(crate) clock: SharedClock,
    pub(crate) stop: CancellationToken,
}

/// Receives until `stop` is cancelled, then waits until the admitted work is stored and acknowledged.
pub(crate) async fn run(
    mut listener: ZmtpListener,
    address: String,
    mut session: IngestSession,
    mut context: TaskContext,
) -> Result<(), Failure> {
    let sender = listener.sender();
    let mut expiry_interval = tokio::time::interval(EXPIRY_INTERVAL);
    // After a stall of this task, the missed ticks need not be made up for.
    expiry_interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    // One line per interval reports all rejected messages. With one line per message a hostile peer could fill the log.
    let mut last_reported = RejectedCounts::default();
    loop {
        tokio::select! {
            () = context.stop.cancelled() => break,
            received = listener.receive() => match received {
                // A message of the event stream has one frame.
                Some(ListenerEvent::Message(from, frames)) => if let Some(frame) = frames.first() {
                    session.handle_frame(&from, frame, context.clock.stamp());
                },
                Some(ListenerEvent::Gone(connection, _)) => session.handle_connection_closed(connection),
                // TCP connections do not report these events.
                Some(
                    ListenerEvent::InvalidData(..)
                    | ListenerEvent::IncomingLost(..)
                    | ListenerEvent::OutgoingLost(..)
                    | ListenerEvent::Moved(..)
                    | ListenerEvent::Remark(..)
                    | ListenerEvent::Refused(..),
                ) => {}
                None => return Err(Failure::Socket { address }),
            },
            event = context.store_events.recv() => match event {
                Some(event) => session.handle_store_event(event),
                // A writer that cannot store ends as soon as `stop` is cancelled, perhaps before this task notices.
                None if context.stop.is_cancelled() => break,
                None => return Err(Failure::TaskEnded("writer")),
            },
            _ = expiry_interval.tick() => {
                session.expire(context.clock.stamp());
                report(session.rejected(), &mut last_reported);
            }
        }
        deliver(&sender, &mut session, &context.live_events).await;
    }
    // This closes the queue to the writer, so that the writer ends after the queued work. Its acknowledgements arrive
    // until then.
    session.close();
    while let Some(event) = context.store_events.recv().await {
        session.handle_store_event(event);
        deliver(&sender, &mut session, &context.live_events).await;
    }
    listener.close(LINGER).await;
    Ok(())
}

/// Sends the replies, and passes on the live events. A reply that does not fit into the queue of its connection is
/// dropped and sent again when the agent asks again. A live event waits for room in the queue of the live state, whose
/// task empties the queue without waiting for anything else.
async fn deliver(sender: &ZmtpSender, session: &mut IngestSession, live_events: &mpsc::Sender<LiveEvent>) {
    // Connections are admitted before the replies are sent, because a welcomed agent sends at once.
    for admission in session.take_admissions() {
        match admission {
            Admission::Admit(connection) => sender.admit(connection),
            Admission::Demote(connection) => sender.demote(connection),
        }
    }
    for (to, reply) in session.take_replies() {
        if let Err(error) = sender.try_send(to, vec![Bytes::from(codec::encode(&reply))]) {
            tracing::debug!(%error, "cannot send a reply; its agent will repeat the request");
        }
    }
    for event in session.take_live_events() {
        // The receiver is closed only while the aggregator ends.
        let _ended = live_events.send(event).await;
    }
}

/// Logs the messages that were rejected since the last report. `last_reported` are the counts at the last report.
fn report(rejected: RejectedCounts, last_reported: &mut RejectedCounts) {
    if rejected != *last_reported {
        tracing::warn!(
            deferred = rejected.deferred - last_reported.deferred,
            damaged = rejected.damaged - last_reported.damaged,
            unreadable = rejected.unreadable - last_reported.unreadable,
            strangers = rejected.strangers - last_reported.strangers,
            "messages were rejected: deferred because the queue was full (requested again), damaged in transit (requested \
             again), unreadable, or from hosts without a session (strangers)"
        );
        *last_reported = rejected;
    }
}
