//! The task that owns the socket.

use std::time::Duration;

use bytes::Bytes;
use peernet_clock::SharedClock;
use peernet_logger::stream::codec::{self, MAX_MESSAGE_BYTES};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use zeromq::{IdentitySocket, Message, Options, Socket, SocketType};

use super::desk::{Desk, Untaken};
use crate::error::{Failure, StartError};
use crate::live::News;
use crate::store::write::Committed;

/// Frames that wait in the socket for each agent, at most.
const WAITING_FRAMES: u32 = 256;
/// How often silent hosts are looked for and losses are reported.
const AGE_EVERY: Duration = Duration::from_secs(5);
/// A connection without any sign of life for so long is closed.
const HEARTBEAT: Duration = Duration::from_secs(2);
const HEARTBEAT_TIMEOUT: Duration = Duration::from_secs(10);
/// How long the last acknowledgements may take on their way out.
const LINGER: Duration = Duration::from_millis(500);
/// Room in a message for what the library counts beside the payload.
const FRAMING: usize = 4_096;

/// Listens; returns the socket and the address with the port that was really taken.
pub(crate) async fn listen(address: &str) -> Result<(IdentitySocket, String), StartError> {
    let failed = |source| StartError::Listen { address: address.to_owned(), source };
    let options = Options::default()
        .recv_hwm(WAITING_FRAMES)
        .send_hwm(WAITING_FRAMES)
        .max_message_size(MAX_MESSAGE_BYTES + FRAMING)
        .heartbeat_interval(HEARTBEAT)
        .heartbeat_timeout(HEARTBEAT_TIMEOUT)
        .linger(LINGER);
    let socket = Socket::new(SocketType::Router, options);
    let bound = socket.bind(address).await.map_err(failed)?;
    Ok((socket.identity_routing().map_err(failed)?, bound.to_string()))
}

/// What the socket's task is wired to.
pub(crate) struct Wires {
    pub(crate) committed: mpsc::Receiver<Committed>,
    pub(crate) news: mpsc::Sender<News>,
    pub(crate) clock: SharedClock,
    pub(crate) stop: CancellationToken,
}

/// Receives until told to stop, then waits until what was let in is stored and acknowledged.
pub(crate) async fn run(
    socket: IdentitySocket,
    address: String,
    mut desk: Desk,
    mut wires: Wires,
) -> Result<(), Failure> {
    let mut ageing = tokio::time::interval(AGE_EVERY);
    ageing.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut reported = Untaken::default();
    loop {
        tokio::select! {
            () = wires.stop.cancelled() => break,
            received = socket.recv_from() => {
                let (from, message) = received.map_err(|source| Failure::Socket { address: address.clone(), source })?;
                if let Some(frame) = message.part_bytes(0) {
                    desk.frame(&from, &frame, wires.clock.stamp());
                }
            }
            committed = wires.committed.recv() => match committed {
                Some(committed) => desk.committed(committed),
                None => return Err(Failure::TaskEnded("writer")),
            },
            _ = ageing.tick() => {
                desk.age(wires.clock.stamp());
                report(desk.untaken(), &mut reported);
            }
        }
        deliver(&socket, &mut desk, &wires.news).await;
    }
    desk.close();
    while let Some(committed) = wires.committed.recv().await {
        desk.committed(committed);
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

fn report(untaken: Untaken, reported: &mut Untaken) {
    if untaken != *reported {
        tracing::warn!(
            deferred = untaken.deferred - reported.deferred,
            unreadable = untaken.unreadable - reported.unreadable,
            strangers = untaken.strangers - reported.strangers,
            "messages were not taken: without room (sent again), not readable, from hosts that did not say hello"
        );
        *reported = untaken;
    }
}
