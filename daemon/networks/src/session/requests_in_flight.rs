//! Requests of a session that are in flight, and the end of the session, which ends all of them.

use std::sync::{Mutex, MutexGuard, PoisonError};

use peernet_logger::{Recorder, stage};
use tokio::sync::{Semaphore, SemaphorePermit, oneshot, watch};

use super::client::{Client, CloseReason, CloudMessage};
use super::exchange::{ArrivedReply, RequestError};
use crate::message::{Header, SessionId};
use crate::statistics::Counters;

/// Outcome of a request.
#[derive(Debug)]
pub(super) enum Answer {
    Reply(Box<ArrivedReply>),
    /// The request or its answer was lost on the way. The text says how much of it arrived.
    Lost(String),
    Over(CloseReason),
}

/// Sender to the task that waits for an answer.
pub(super) type Waiter = oneshot::Sender<Answer>;

/// Requests in flight. When the session is over, all of them end, and no further request or place in flight is granted.
#[derive(Debug)]
pub(super) struct RequestsInFlight {
    client: Mutex<Client<Waiter>>,
    /// Free places in flight; closed when the session is over.
    places: Semaphore,
    over: watch::Sender<Option<CloseReason>>,
}

impl RequestsInFlight {
    /// Allows at most `places` requests in flight at once.
    pub(super) fn new(session: SessionId, places: usize) -> Self {
        Self {
            client: Mutex::new(Client::new(session)),
            places: Semaphore::new(places),
            over: watch::Sender::new(None),
        }
    }

    fn client(&self) -> MutexGuard<'_, Client<Waiter>> {
        self.client.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for a place in flight. Records `send-queue` only if it has to wait.
    ///
    /// # Errors
    /// If the deadline passes, or the session is over.
    pub(super) async fn place(
        &self,
        log: &mut Recorder,
        deadline: tokio::time::Instant,
    ) -> Result<SemaphorePermit<'_>, RequestError> {
        if let Ok(place) = self.places.try_acquire() {
            return Ok(place);
        }
        let waiting = log.start(stage::SEND_QUEUE);
        let place = tokio::time::timeout_at(deadline, self.places.acquire()).await;
        log.stop(waiting);
        place.map_err(|_| RequestError::Timeout)?.map_err(|_| {
            let reason = self.over.borrow().clone().unwrap_or(CloseReason::Local);
            RequestError::Lost(reason.to_string())
        })
    }

    /// Starts a request. Returns its number and the receiver of its answer.
    ///
    /// # Errors
    /// If the session is over.
    pub(super) fn begin(&self) -> Result<(u64, oneshot::Receiver<Answer>), RequestError> {
        let (waiter, answer) = oneshot::channel();
        let request = self.client().begin(waiter).map_err(|reason| RequestError::Lost(reason.to_string()))?;
        Ok((request, answer))
    }

    /// Stops waiting for the answer to a request.
    pub(super) fn give_up(&self, request: u64) {
        self.client().give_up(request);
    }

    /// Handles a message from the cloud.
    pub(super) fn receive(&self, header: Header) -> CloudMessage<Waiter> {
        self.client().receive(header)
    }

    /// Removes a request that was lost, or whose answer was lost. Returns its waiter, if it is still waited for.
    pub(super) fn lose(&self, request: u64) -> Option<Waiter> {
        self.client().lose(request)
    }

    /// Ends the session; the first reason is kept. Requests in flight are counted as lost and end.
    pub(super) fn end(&self, reason: &CloseReason, counters: &Counters) {
        let waiters = self.client().end(reason.clone());
        end_all(reason, waiters, counters);
        self.over.send_if_modified(|over| {
            let first = over.is_none();
            over.get_or_insert_with(|| reason.clone());
            first
        });
        self.places.close();
    }

    /// Waits until the session is over. Returns the reason.
    pub(super) async fn ended(&self) -> CloseReason {
        let mut over = self.over.subscribe();
        match over.wait_for(Option::is_some).await {
            Ok(reason) => reason.clone().unwrap_or(CloseReason::Local),
            Err(_) => CloseReason::Local,
        }
    }
}

/// Counts requests as lost and ends them because the session is over.
pub(super) fn end_all(reason: &CloseReason, waiters: Vec<Waiter>, counters: &Counters) {
    // Counted first, so that a waiter that reads the statistics finds its request counted.
    counters.lost(waiters.len() as u64);
    for waiter in waiters {
        // Fails if the request was given up at this moment; it then needs no answer.
        let _ = waiter.send(Answer::Over(reason.clone()));
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, SystemClock};
    use peernet_logger::HostId;

    use super::*;
    use crate::statistics::TransportStatistics;

    fn log() -> Recorder {
        let clock = Arc::new(SystemClock::new(ClockIdentity::new("edge", "test")));
        Recorder::new(clock, HostId::random())
    }

    #[tokio::test]
    async fn session_end_fails_all_requests() {
        let (requests, counters) = (RequestsInFlight::new(SessionId::random(), 1), Counters::default());
        let soon = tokio::time::Instant::now() + std::time::Duration::from_secs(60);
        let place = requests.place(&mut log(), soon).await.expect("one is free");
        let (_, answer) = requests.begin().expect("open");
        let mut waiting = log();
        let (second, ()) = tokio::join!(requests.place(&mut waiting, soon), async {
            requests.end(&CloseReason::UnknownSession, &counters);
            requests.end(&CloseReason::Local, &counters);
        });
        drop(place);
        let over = CloseReason::UnknownSession.to_string();
        assert_eq!(second.map(drop), Err(RequestError::Lost(over.clone())));
        assert!(matches!(answer.await, Ok(Answer::Over(CloseReason::UnknownSession))));
        assert_eq!(requests.begin().map(drop), Err(RequestError::Lost(over)));
        assert_eq!(requests.ended().await, CloseReason::UnknownSession);
        assert_eq!(counters.statistics(&TransportStatistics::default()).lost_messages, 1);
    }
}
