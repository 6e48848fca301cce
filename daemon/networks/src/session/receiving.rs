//! The receiving task of an edge, and the handling of what it receives.

use std::sync::Arc;
use std::time::Duration;

use peernet_clock::Stamp;
use tokio_util::sync::CancellationToken;

use super::client::{CloseReason, CloudMessage};
use super::exchange::{ArrivedReply, Sizes};
use super::requests_in_flight::{Answer, end_all};
use super::state::SessionState;
use crate::message::{Goodbye, Header};
use crate::transport::{Disconnected, EdgeArrival, EdgeReceiver, Frames, MessageLoss, SendOptions};

impl SessionState {
    /// Handles a message that arrived at `arrived`. Returns the reason if the session is over now.
    fn receive(&self, frames: Frames, arrived: Stamp) -> Option<CloseReason> {
        self.counters.received(Sizes::of(&frames).total());
        let header = frames.first().ok_or_else(|| "no frames".to_owned());
        let header = header.and_then(|frame| Header::decode(frame).map_err(|error| error.to_string()));
        let message = match header {
            Ok(header) => self.requests.receive(header),
            Err(problem) => {
                tracing::debug!(problem, "dropped a message from the cloud");
                self.counters.malformed();
                return None;
            }
        };
        match message {
            CloudMessage::Answer(waiter, reply) => {
                let reply = ArrivedReply { reply, frames, at: arrived, epoch: self.clock.epoch() };
                // Fails if the request was given up at this moment.
                if waiter.send(Answer::Reply(Box::new(reply))).is_err() {
                    self.counters.late();
                }
                None
            }
            CloudMessage::Statistics(statistics) => {
                self.peer_statistics.send_replace(Some(*statistics));
                None
            }
            CloudMessage::Clock(clock) => {
                self.peer_clock.send_replace(clock);
                None
            }
            CloudMessage::Late => {
                self.counters.late();
                None
            }
            CloudMessage::Malformed(problem) => {
                tracing::debug!(problem, "dropped a message from the cloud");
                self.counters.malformed();
                None
            }
            CloudMessage::Over(reason, waiters) => {
                end_all(&reason, waiters, &self.counters);
                Some(reason)
            }
        }
    }

    /// Ends the request whose message did not arrive as a whole in either direction.
    fn lose(&self, loss: MessageLoss, what: &str) {
        let waiter = loss.tag.and_then(|request| self.requests.lose(request));
        if let Some(waiter) = waiter {
            self.counters.lost(1);
            // Fails if the request was given up at this moment; it then needs no answer.
            let _ = waiter.send(Answer::Lost(format!("{what}: {loss}")));
        }
    }
}

/// The task that receives messages from the network. However it ends, the session ends with it.
pub(super) struct ReceivingTask {
    pub(super) shared: Arc<SessionState>,
    /// Cancelled by users of the session who want to close it.
    pub(super) stop: CancellationToken,
    /// Cancelled by this task when the session is closed.
    pub(super) stopped: CancellationToken,
}

impl ReceivingTask {
    pub(super) async fn run(self, mut receiver: Box<dyn EdgeReceiver>, linger: Duration) {
        let reason = {
            let mut stop = std::pin::pin!(self.stop.cancelled());
            loop {
                tokio::select! {
                    biased;
                    () = &mut stop => break CloseReason::Local,
                    message = receiver.receive() => match message {
                        Ok(EdgeArrival::Message(frames)) => {
                            let arrived = self.shared.clock.stamp();
                            if let Some(reason) = self.shared.receive(frames, arrived) {
                                break reason;
                            }
                        }
                        Ok(EdgeArrival::Incomplete(loss)) => {
                            self.shared.lose(loss, "the answer was lost on the way");
                        }
                        Ok(EdgeArrival::Lost(loss)) => {
                            self.shared.lose(loss, "it was lost on the way to the cloud");
                        }
                        Ok(EdgeArrival::Garbage(problem)) => {
                            tracing::debug!(problem, "dropped what came from where the cloud is");
                            self.shared.counters.malformed();
                        }
                        Ok(EdgeArrival::Remark(text)) => self.shared.remarks.add(text),
                        Err(Disconnected(reason)) => break CloseReason::Broken(reason),
                    },
                }
            }
        };
        // A goodbye is only sent if this side closes; in all other cases the other end knows that the session is over.
        if reason == CloseReason::Local {
            self.send_goodbye();
        }
        self.shared.requests.end(&reason, &self.shared.counters);
        receiver.close(linger).await;
    }

    fn send_goodbye(&self) {
        let goodbye = Goodbye {
            session: self.shared.terms.session,
            reason: "the edge closed the session".into(),
            ordered: self.shared.ordered.get().copied(),
        };
        let sent = Header::Goodbye(goodbye).encode().map_err(|error| error.to_string()).and_then(|header| {
            let bytes = header.len() as u64;
            self.shared
                .sender
                .send(vec![header], SendOptions::default())
                .map_err(|error| error.to_string())?;
            Ok(bytes)
        });
        match sent {
            Ok(bytes) => self.shared.counters.sent(bytes),
            Err(error) => tracing::debug!(error, "could not say goodbye to the cloud"),
        }
    }
}

impl Drop for ReceivingTask {
    fn drop(&mut self) {
        let reason = CloseReason::Broken("the receiving task ended early".into());
        self.shared.requests.end(&reason, &self.shared.counters);
        self.stopped.cancel();
    }
}
