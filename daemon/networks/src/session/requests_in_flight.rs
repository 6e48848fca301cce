//! Requests of a session that are in flight, and the end of the session, which ends all of them.

use std::sync::{Mutex, MutexGuard, PoisonError};

use peernet_clock::Stamp;
use peernet_logger::{Recorder, stage};
use tokio::sync::{Semaphore, SemaphorePermit, oneshot, watch};

use super::client::{ClientSession, CloseReason, CloudMessage};
use super::completed_request::{ArrivedReply, AwaitedEvent, RequestError};
use super::partial_answers::{ArrivedPartialAnswers, PartialAnswerHandler};
use crate::message::{Header, PartialReply, SessionId};
use crate::statistics::Counters;

/// Outcome of a request in flight.
#[derive(Debug)]
pub(super) enum RequestOutcome {
    /// The answer arrived.
    Reply(Box<ArrivedReply>),
    /// The request or its answer was lost on the way, after these partial answers. The text says which of the
    /// two was lost, and how much of it arrived.
    Lost(String, ArrivedPartialAnswers),
    /// The session ended, for this reason, after these partial answers.
    SessionEnded(CloseReason, ArrivedPartialAnswers),
}

/// The channel to the task that waits for an answer, and the partial answers that have arrived.
#[derive(Debug)]
pub(super) struct Waiter {
    pub(super) outcome: oneshot::Sender<RequestOutcome>,
    pub(super) partial_answers: ArrivedPartialAnswers,
    /// Function that takes each partial answer when it arrives.
    handler: Option<PartialAnswerHandler>,
}

/// Requests in flight of a session. When the session is over, all of them end, and no further request can start.
#[derive(Debug)]
pub(super) struct RequestsInFlight {
    client: Mutex<ClientSession<Waiter>>,
    /// Number of requests that may still start; closed when the session is over.
    slots: Semaphore,
    close_reason: watch::Sender<Option<CloseReason>>,
}

impl RequestsInFlight {
    /// Creates an empty set that allows at most `slots` requests in flight at the same time.
    pub(super) fn new(session: SessionId, slots: usize) -> Self {
        Self {
            client: Mutex::new(ClientSession::new(session)),
            slots: Semaphore::new(slots),
            close_reason: watch::Sender::new(None),
        }
    }

    fn client(&self) -> MutexGuard<'_, ClientSession<Waiter>> {
        self.client.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until another request may be in flight. Records `send-queue` only if it has to wait.
    ///
    /// # Errors
    /// If the deadline passes, or the session is over.
    pub(super) async fn acquire_slot(
        &self,
        recorder: &mut Recorder,
        deadline: tokio::time::Instant,
    ) -> Result<SemaphorePermit<'_>, RequestError> {
        if let Ok(slot) = self.slots.try_acquire() {
            return Ok(slot);
        }
        let send_queue = recorder.start(stage::SEND_QUEUE);
        let slot = tokio::time::timeout_at(deadline, self.slots.acquire()).await;
        recorder.stop(send_queue);
        slot.map_err(|_| RequestError::Timeout(AwaitedEvent::Slot))?.map_err(|_| {
            let reason = self.close_reason.borrow().clone().unwrap_or(CloseReason::Local);
            RequestError::Lost(reason.to_string())
        })
    }

    /// Starts a request. Returns its number and the receiver of its outcome.
    ///
    /// # Errors
    /// If the session is over.
    pub(super) fn start_request(
        &self,
        handler: Option<PartialAnswerHandler>,
    ) -> Result<(u64, oneshot::Receiver<RequestOutcome>), RequestError> {
        let (sender, outcome) = oneshot::channel();
        let waiter = Waiter { outcome: sender, partial_answers: ArrivedPartialAnswers::default(), handler };
        let request =
            self.client().start_request(waiter).map_err(|reason| RequestError::Lost(reason.to_string()))?;
        Ok((request, outcome))
    }

    /// Removes and returns the partial answers to a request that have arrived; `None` if the request is not in flight.
    pub(super) fn take_partial_answers(&self, request: u64) -> Option<ArrivedPartialAnswers> {
        self.client().waiter_mut(request).map(|waiter| std::mem::take(&mut waiter.partial_answers))
    }

    /// Stops waiting for the answer to a request. Returns whether the request was still in flight.
    pub(super) fn cancel_request(&self, request: u64) -> bool {
        self.client().cancel_request(request)
    }

    /// Adds a partial answer with `bytes` bytes of payload. Returns the handler of the partial answers. If an
    /// acknowledgement is due, also returns the number of partial answers that count as read.
    pub(super) fn add_partial_answer(
        &self,
        partial_answer: &PartialReply,
        bytes: u64,
        arrival: Stamp,
    ) -> (Option<PartialAnswerHandler>, Option<u32>) {
        let mut client = self.client();
        let Some(waiter) = client.waiter_mut(partial_answer.request) else { return (None, None) };
        let PartialReply { part, departure, .. } = *partial_answer;
        let read_count = waiter.partial_answers.add(part, bytes, departure, arrival);
        (waiter.handler.clone(), read_count)
    }

    /// Handles a message from the cloud.
    pub(super) fn receive(&self, header: Header) -> CloudMessage<Waiter> {
        self.client().receive(header)
    }

    /// Removes a request that was lost on the way, or whose answer was lost. Returns its waiter if the request was in
    /// flight.
    pub(super) fn remove_lost_request(&self, request: u64) -> Option<Waiter> {
        self.client().remove_lost_request(request)
    }

    /// Ends the session, and all requests in flight as lost. If the session has ended already, the first reason is
    /// kept.
    pub(super) fn end(&self, reason: &CloseReason, counters: &Counters) {
        let waiters = self.client().end(reason.clone());
        end_all(reason, waiters, counters);
        self.close_reason.send_if_modified(|close_reason| {
            let is_first = close_reason.is_none();
            close_reason.get_or_insert_with(|| reason.clone());
            is_first
        });
        // The slots are closed last: a request that waits for a slot reads the reason as soon as they are closed.
        self.slots.close();
    }

    /// Waits until the session is over. Returns the reason.
    pub(super) async fn wait_for_end(&self) -> CloseReason {
        let mut close_reason = self.close_reason.subscribe();
        match close_reason.wait_for(Option::is_some).await {
            Ok(reason) => reason.clone().unwrap_or(CloseReason::Local),
            Err(_) => CloseReason::Local,
        }
    }
}

/// Counts requests as lost and ends them because the session is over.
pub(super) fn end_all(reason: &CloseReason, waiters: Vec<Waiter>, counters: &Counters) {
    // The requests are counted first, so that a waiter that reads the statistics finds its request counted.
    counters.count_lost(waiters.len() as u64);
    for waiter in waiters {
        // Sending fails if the request is cancelled at the same moment. It then needs no outcome.
        let _ = waiter.outcome.send(RequestOutcome::SessionEnded(reason.clone(), waiter.partial_answers));
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, SystemClock};
    use peernet_logger::HostId;

    use super::*;
    use crate::statistics::TransportStatistics;

    fn recorder() -> Recorder {
        let clock = Arc::new(SystemClock::new(ClockIdentity::new("edge", "test")));
        Recorder::new(clock, HostId::random())
    }

    #[tokio::test]
    async fn end_of_session_ends_all_requests_as_lost() {
        let (requests, counters) = (RequestsInFlight::new(SessionId::random(), 1), Counters::default());
        let deadline = tokio::time::Instant::now() + std::time::Duration::from_secs(60);
        let slot = requests.acquire_slot(&mut recorder(), deadline).await.expect("a slot is free");
        let (_, outcome) = requests.start_request(None).expect("open");
        let mut waiting_recorder = recorder();
        let (waiting_request, ()) =
            tokio::join!(requests.acquire_slot(&mut waiting_recorder, deadline), async {
                requests.end(&CloseReason::UnknownSession, &counters);
                requests.end(&CloseReason::Local, &counters);
            });
        drop(slot);
        let close_reason = CloseReason::UnknownSession.to_string();
        assert_eq!(waiting_request.map(drop), Err(RequestError::Lost(close_reason.clone())));
        assert!(matches!(outcome.await, Ok(RequestOutcome::SessionEnded(CloseReason::UnknownSession, _))));
        assert_eq!(requests.start_request(None).map(drop), Err(RequestError::Lost(close_reason)));
        assert_eq!(requests.wait_for_end().await, CloseReason::UnknownSession);
        assert_eq!(counters.statistics(&TransportStatistics::default()).lost_messages, 1);
    }
}
