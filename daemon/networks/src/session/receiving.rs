//! The receiving task of an edge, and the handling of the messages that it receives.

use std::sync::Arc;
use std::time::Duration;

use peernet_clock::Stamp;
use tokio_util::sync::CancellationToken;

use super::client::{CloseReason, CloudMessage};
use super::completed_request::{ArrivedReply, MessageSizes};
use super::partial_answers::PartialAnswerHandler;
use super::requests_in_flight::{RequestOutcome, end_all};
use super::state::SessionState;
use crate::message::{Goodbye, Header, PartialAnswersRead, PartialReply};
use crate::transport::{Disconnection, EdgeEvent, EdgeReceiver, Frames, MessageLoss};

impl SessionState {
    /// Handles a message that arrived at `arrival`. Returns the reason if the message ends the session.
    fn receive(&self, frames: Frames, arrival: Stamp) -> Option<CloseReason> {
        self.counters.count_received(MessageSizes::from_frames(&frames).total());
        let header = frames.first().ok_or_else(|| "no frames".to_owned());
        let header = header.and_then(|frame| Header::decode(frame).map_err(|error| error.to_string()));
        let message = match header {
            Ok(header) => self.requests.receive(header),
            Err(problem) => {
                self.report_invalid(&problem);
                return None;
            }
        };
        match message {
            CloudMessage::Answer(waiter, reply) => {
                let (partial_answers, epoch) = (waiter.partial_answers, self.clock.epoch());
                let reply = ArrivedReply { reply, frames, partial_answers, stamp: arrival, epoch };
                // Sending fails if the request is cancelled at the same moment.
                if waiter.outcome.send(RequestOutcome::Reply(Box::new(reply))).is_err() {
                    self.counters.count_late();
                }
                None
            }
            CloudMessage::PartialAnswer(partial_answer) => {
                self.receive_partial_answer(partial_answer, frames, arrival);
                None
            }
            // Nobody reads a partial answer to a request that was cancelled or has ended.
            CloudMessage::LatePartialAnswer => None,
            CloudMessage::Statistics(statistics) => {
                self.peer_statistics.send_replace(Some(*statistics));
                None
            }
            CloudMessage::Clock(clock) => {
                self.peer_clock.send_replace(clock);
                None
            }
            CloudMessage::LateAnswer => {
                self.counters.count_late();
                None
            }
            CloudMessage::Malformed(problem) => {
                self.report_invalid(problem);
                None
            }
            CloudMessage::SessionEnded(reason, waiters) => {
                end_all(&reason, waiters, &self.counters);
                Some(reason)
            }
        }
    }

    /// Handles a partial answer: gives it to the handler, and acknowledges it if an acknowledgement is due.
    fn receive_partial_answer(&self, partial_answer: PartialReply, frames: Frames, arrival: Stamp) {
        let bytes = frames.iter().skip(2).map(|frame| frame.len() as u64).sum();
        let (handler, read_count) = self.requests.add_partial_answer(&partial_answer, bytes, arrival);
        let request = partial_answer.request;
        match partial_answer.sample.into_sample(frames.into_iter().skip(2)) {
            Ok(sample) => {
                if let Some(PartialAnswerHandler(handler)) = handler {
                    handler(&sample);
                }
            }
            Err(problem) => self.report_invalid(&format!("a partial answer: {problem}")),
        }
        if let Some(read_count) = read_count {
            let session = self.terms.session;
            self.send_control(&Header::PartialAnswersRead(PartialAnswersRead {
                session,
                request,
                read_count,
            }));
        }
    }

    /// Ends a request that was lost, or whose answer was lost. `description` says which of the two was lost.
    fn end_lost_request(&self, loss: MessageLoss, description: &str) {
        let waiter = loss.tag.and_then(|request| self.requests.remove_lost_request(request));
        if let Some(waiter) = waiter {
            self.counters.count_lost(1);
            // Sending fails if the request is cancelled at the same moment. It then needs no outcome.
            let _ = waiter
                .outcome
                .send(RequestOutcome::Lost(format!("{description}: {loss}"), waiter.partial_answers));
        }
    }
}

/// The task that receives messages from the network. The session ends when the task ends, for any reason.
pub(super) struct ReceivingTask {
    pub(super) shared: Arc<SessionState>,
    /// Token that closes the session when it is cancelled.
    pub(super) close_token: CancellationToken,
    /// Token that this task cancels when the session is closed.
    pub(super) closed_token: CancellationToken,
}

impl ReceivingTask {
    /// Receives messages until the session is over. Then ends all requests and closes the connection.
    pub(super) async fn run(self, mut receiver: Box<dyn EdgeReceiver>, close_timeout: Duration) {
        let reason = {
            let mut close_request = std::pin::pin!(self.close_token.cancelled());
            loop {
                tokio::select! {
                    // Closing takes precedence over messages that have arrived.
                    biased;
                    () = &mut close_request => break CloseReason::Local,
                    message = receiver.receive() => match message {
                        Ok(EdgeEvent::Message(frames)) => {
                            let arrival = self.shared.clock.stamp();
                            if let Some(reason) = self.shared.receive(frames, arrival) {
                                break reason;
                            }
                        }
                        Ok(EdgeEvent::IncomingLost(loss)) => {
                            self.shared.end_lost_request(loss, "the answer was lost on the way from the cloud");
                        }
                        Ok(EdgeEvent::OutgoingLost(loss)) => {
                            self.shared.end_lost_request(loss, "the request was lost on the way to the cloud");
                        }
                        Ok(EdgeEvent::InvalidData(problem)) => {
                            tracing::debug!(problem, "dropped invalid data from the cloud's address");
                            self.shared.counters.count_malformed();
                        }
                        Ok(EdgeEvent::Remark(text)) => self.shared.remarks.add(text),
                        Err(Disconnection(reason)) => break CloseReason::Broken(reason),
                    },
                }
            }
        };
        // A goodbye is sent only if this end closes the session. In all other cases the cloud knows already that the
        // session is over, or the cloud cannot be reached.
        if reason == CloseReason::Local {
            self.send_goodbye();
        }
        self.shared.requests.end(&reason, &self.shared.counters);
        receiver.close(close_timeout).await;
    }

    fn send_goodbye(&self) {
        let goodbye = Goodbye {
            session: self.shared.terms.session,
            reason: "the edge closed the session".into(),
            planned_iterations: self.shared.planned_iterations.get().copied(),
        };
        self.shared.send_control(&Header::Goodbye(goodbye));
    }
}

impl Drop for ReceivingTask {
    fn drop(&mut self) {
        // If the task panics or its runtime ends, the requests end here. Otherwise they have ended already.
        let reason = CloseReason::Broken("the task that receives answers has ended".into());
        self.shared.requests.end(&reason, &self.shared.counters);
        self.closed_token.cancel();
    }
}
