//! The task that owns the socket.

use std::time::Duration;

use bytes::Bytes;
use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_logger::stream::codec::{self, MAX_MESSAGE_BYTES};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use zeromq::{
    IdentitySocket, Message, MonitorEvent, MonitorStream, MonitorTryRecvError, Options, Socket, SocketType,
};

use super::committing::StoreEvent;
use super::desk::{Desk, Untaken};
use crate::error::{Failure, StartError};
use crate::live::News;

/// Frames that wait in the socket, at most, each way and of each agent: the desk takes them at once, so few are enough,
/// and a thousand agents' fit into memory.
const WAITING_FRAMES: u32 = 16;
/// How often silent hosts are looked for and losses are reported.
const AGE_EVERY: Duration = Duration::from_secs(5);
/// A connection without any sign of life for so long is closed.
const HEARTBEAT: Duration = Duration::from_secs(2);
const HEARTBEAT_TIMEOUT: Duration = Duration::from_secs(10);
/// How long a connection may take to say who it is, and how many may be at it at once: whoever connects and keeps
/// silent must not keep agents out.
const HANDSHAKE: Duration = Duration::from_secs(2);
const HANDSHAKES: usize = 4_096;
/// So many that failed at it are worth a warning, at most once a minute.
const SILENT: u64 = 64;
const WARN_EVERY: Span = Span::from_seconds(60);
/// How long the last acknowledgements may take on their way out.
const LINGER: Duration = Duration::from_millis(500);
/// Room in a message for what the library counts beside the payload.
const FRAMING: usize = 4_096;

/// Listens; returns the socket and the address with the port that was really taken.
pub(crate) async fn listen(address: &str) -> Result<(Listening, String), StartError> {
    let failed = |source| StartError::Listen { address: address.to_owned(), source };
    let options = Options::default()
        .recv_hwm(WAITING_FRAMES)
        .send_hwm(WAITING_FRAMES)
        .max_message_size(MAX_MESSAGE_BYTES + FRAMING)
        .heartbeat_interval(HEARTBEAT)
        .heartbeat_timeout(HEARTBEAT_TIMEOUT)
        .handshake_timeout(HANDSHAKE)
        .max_pending_handshakes(handshakes())
        .linger(LINGER);
    let socket = Socket::new(SocketType::Router, options);
    let events = socket.monitor();
    let bound = socket.bind(address).await.map_err(failed)?;
    let socket = socket.identity_routing().map_err(failed)?;
    Ok((Listening { socket, events }, bound.to_string()))
}

/// A socket that listens, and what it tells of its connections.
pub(crate) struct Listening {
    socket: IdentitySocket,
    events: MonitorStream,
}

/// Connections that may be saying who they are at once: at most half of the files that this process may open.
fn handshakes() -> usize {
    let files = rustix::process::getrlimit(rustix::process::Resource::Nofile).current;
    files.and_then(|files| usize::try_from(files / 2).ok()).map_or(HANDSHAKES, |half| half.min(HANDSHAKES))
}

/// What the socket's task is wired to.
pub(crate) struct Wires {
    pub(crate) stored: mpsc::Receiver<StoreEvent>,
    pub(crate) news: mpsc::Sender<News>,
    pub(crate) clock: SharedClock,
    pub(crate) stop: CancellationToken,
}

/// Receives until told to stop, then waits until what was let in is stored and acknowledged.
pub(crate) async fn run(
    Listening { socket, mut events }: Listening,
    address: String,
    mut desk: Desk,
    mut wires: Wires,
) -> Result<(), Failure> {
    let mut ageing = tokio::time::interval(AGE_EVERY);
    ageing.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut reported = Untaken::default();
    let mut silent = Silent::default();
    loop {
        tokio::select! {
            () = wires.stop.cancelled() => break,
            received = socket.recv_from() => {
                let (from, message) = received.map_err(|source| Failure::Socket { address: address.clone(), source })?;
                if let Some(frame) = message.part_bytes(0) {
                    desk.frame(&from, &frame, wires.clock.stamp());
                }
            }
            event = wires.stored.recv() => match event {
                Some(event) => desk.store_event(event),
                None => return Err(Failure::TaskEnded("writer")),
            },
            _ = ageing.tick() => {
                let now = wires.clock.stamp();
                desk.age(now);
                report(desk.untaken(), &mut reported);
                silent.count(&mut events, now.mono);
            }
        }
        deliver(&socket, &mut desk, &wires.news).await;
    }
    desk.close();
    while let Some(event) = wires.stored.recv().await {
        desk.store_event(event);
        deliver(&socket, &mut desk, &wires.news).await;
    }
    if let Err(error) = socket.into_inner().close_with_linger(Some(LINGER)).await {
        tracing::debug!(%error, "the last acknowledgements may not have been sent");
    }
    Ok(())
}

/// Sends replies and passes on news. Neither waits for the other side: a reply that finds no room is repeated when
/// the agent asks again, and the live picture's task waits for nothing.
async fn deliver(socket: &IdentitySocket, desk: &mut Desk, news: &mpsc::Sender<News>) {
    for (to, reply) in desk.take_replies() {
        let message = Message::single(Bytes::from(codec::encode(&reply)));
        if let Err(error) = socket.try_send_to(&to, message) {
            tracing::debug!(%error, "a reply was not sent; its agent will ask again");
        }
    }
    for item in desk.take_news() {
        // Closed only while everything ends.
        let _ended = news.send(item).await;
    }
}

/// Connections that never said who they are.
#[derive(Debug, Default)]
struct Silent {
    /// Those that were seen; when more happens at once than the socket remembers, there were others.
    count: u64,
    warned: Option<MonoTime>,
}

impl Silent {
    /// Counts what the socket told of since the last time, and warns once a minute.
    fn count(&mut self, events: &mut MonitorStream, now: MonoTime) {
        loop {
            match events.try_recv() {
                Ok(MonitorEvent::HandshakeFailed { .. }) => self.count += 1,
                Ok(_) => {}
                // The oldest were overwritten, whatever they told of.
                Err(MonitorTryRecvError::Lagged(_)) => {}
                Err(_) => break,
            }
        }
        if self.count >= SILENT && self.warned.is_none_or(|at| now - at >= WARN_EVERY) {
            tracing::warn!(
                at_least = self.count,
                "many connections never said who they are: is something scanning the agents' port?"
            );
            (self.count, self.warned) = (0, Some(now));
        }
    }
}

fn report(untaken: Untaken, reported: &mut Untaken) {
    if untaken != *reported {
        tracing::warn!(
            deferred = untaken.deferred - reported.deferred,
            damaged = untaken.damaged - reported.damaged,
            unreadable = untaken.unreadable - reported.unreadable,
            strangers = untaken.strangers - reported.strangers,
            "messages were not taken: without room (asked for again), damaged on their way (asked for again), not \
             readable, from hosts that did not say hello"
        );
        *reported = untaken;
    }
}
