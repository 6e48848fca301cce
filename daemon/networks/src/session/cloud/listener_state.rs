//! State that a listener shares with all answers in progress.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_clock::{LogThrottle, MonoTime, SharedClock};
use peernet_logger::{HostId, Recorder, Unit};
use peernet_sample::Sample;

use super::answers::{AnswerContent, AnswersBeingSent, encode_answer, encode_partial_answer};
use super::output::ListenerOutput;
use crate::SessionSettings;
use crate::message::{Header, PeerClock, SessionAccepted, SessionId, StatisticsReport};
use crate::session::budget::RequestBudget;
use crate::session::incoming::{Failure, RequestKey};
use crate::session::partial_answer_sender::FULL_QUEUE_RETRY;
use crate::session::partial_answers::PARTS_SENT;
use crate::session::request_control::RequestControl;
use crate::session::server::{FinishedRequest, Route, Server};
use crate::transport::{CloudSender, ConnectionId, Peer, SendFailure};

/// State that a listener shares with all answers in progress. The senders of answers hold weak references to the state,
/// so that the connections are closed when the listener is dropped.
#[derive(Debug)]
pub(crate) struct ListenerState {
    server: Mutex<Server>,
    pub(super) budget: Arc<RequestBudget>,
    pub(super) output: ListenerOutput,
    pub(super) clock: SharedClock,
    pub(super) host: HostId,
    log_throttle: Mutex<LogThrottle>,
    answers: AnswersBeingSent,
}

impl ListenerState {
    pub(super) fn new(
        settings: &SessionSettings,
        sender: Box<dyn CloudSender>,
        clock: SharedClock,
        host: HostId,
    ) -> Self {
        Self {
            server: Mutex::new(Server::new(settings)),
            budget: RequestBudget::new(settings.max_in_flight_bytes),
            output: ListenerOutput::new(sender),
            clock,
            host,
            log_throttle: Mutex::default(),
            answers: AnswersBeingSent::default(),
        }
    }

    /// Locks the state machine of the sessions. The lock is held for microseconds and never while sending.
    pub(super) fn lock_server(&self) -> MutexGuard<'_, Server> {
        self.server.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells the transport what the edge may send on the connection from now on.
    pub(super) fn update_admission(&self, connection: ConnectionId) {
        let admission = self.lock_server().admission(connection);
        self.output.set_admission(connection, admission);
    }

    /// Accepts a session that an edge asked for. Returns whether the acceptance was handed to the network.
    pub(crate) fn accept(&self, session: SessionId, accepted: SessionAccepted) -> bool {
        let Some((peer, header)) = self.lock_server().accept(session, accepted) else { return false };
        // The admission changes before the acceptance is sent, because the edge's first request may be large.
        self.update_admission(peer.connection);
        self.send_message(&peer, &header)
    }

    /// Refuses a session that an edge asked for, and sends the reason to the edge.
    pub(crate) fn refuse(&self, session: SessionId, reason: String) {
        let refusal = self.lock_server().refuse(session, reason);
        if let Some((peer, header)) = refusal {
            self.update_admission(peer.connection);
            self.send_message(&peer, &header);
        }
    }

    /// Sends the state of this host's clocks to all edges with an open session, and keeps it for later sessions.
    pub(crate) fn send_clock_to_edges(&self, clock: PeerClock) {
        let headers = self.lock_server().update_clock(clock);
        for (peer, header) in headers {
            self.send_message(&peer, &header);
        }
    }

    /// Sends to the edge of each open session the statistics of this end of the connection.
    pub(crate) fn report_statistics(&self) {
        let sessions = self.lock_server().sessions_with_statistics();
        for (session, peer, counters) in sessions {
            let statistics = self.output.statistics(peer.connection, &counters);
            let header = Header::Statistics(Box::new(StatisticsReport { session, statistics }));
            self.send_message(&peer, &header);
        }
    }

    /// Sends an answer with the nodes that `recorder` recorded here. `recorder` is `None` if no model computed the
    /// answer; the reply then has neither tree delta nor departure. If partial answers to the request were sent
    /// before, waits while the send queue is full. Never waits otherwise.
    pub(crate) fn answer(
        &self,
        key: RequestKey,
        mut recorder: Option<Recorder>,
        result: Result<Sample, Failure>,
    ) {
        // The answer is counted before its request stops being in flight, so that `wait_until_idle` always sees the
        // answer or the request. Otherwise the listener could close in between and send the goodbye before the answer.
        self.answers.count_while(|| {
            let Some((mut route, mut control)) = self.finish_request(key) else { return };
            if let (Some(recorder), Some(sent)) = (&mut recorder, control.sent_partial_answers()) {
                recorder.record_value(PARTS_SENT, f64::from(sent.get()), Unit::NONE);
            }
            let mut content = AnswerContent::new(&route, recorder, result);
            loop {
                // An answer is sent again only after partial answers, which may have filled the queue themselves.
                let retry = control.sent_partial_answers().map(|_| content.clone());
                match (self.send_answer(&route, key, content), retry) {
                    (Ok(()), _) => return,
                    (Err(SendFailure::Full), Some(retry)) => content = retry,
                    (Err(reason), _) => {
                        tracing::debug!(%reason, "the network did not accept an answer; it is dropped");
                        self.output.counters.count_lost(1);
                        route.counters.count_lost(1);
                        return;
                    }
                }
                self.lock_server().restore_request(key.session, key.request, Arc::clone(&control));
                // A cancellation ends the wait early. `finish_request` then returns `None`.
                let _ = control.wait(FULL_QUEUE_RETRY);
                match self.finish_request(key) {
                    Some(finished) => (route, control) = finished,
                    None => return,
                }
            }
        });
    }

    /// Ends a request. Returns the destination of its answer; `None` if the answer must not be sent.
    fn finish_request(&self, key: RequestKey) -> Option<(Route, Arc<RequestControl>)> {
        let finished = self.lock_server().finish_request(key.session, key.request);
        match finished {
            FinishedRequest::Send(route, control) => Some((route, control)),
            FinishedRequest::Cancelled => None,
            FinishedRequest::Unknown => {
                self.output.counters.count_lost(1);
                None
            }
        }
    }

    fn send_answer(&self, route: &Route, key: RequestKey, content: AnswerContent) -> Result<(), SendFailure> {
        let frames = encode_answer(&*self.clock, route, key, content).map_err(|error| {
            tracing::warn!(%error, "cannot encode an answer; it is dropped");
            // `Gone` is not retried: a second attempt to encode the answer would fail, too.
            SendFailure::Gone(error.to_string())
        })?;
        self.output.send(&route.peer, frames, Some(key.request), Some(&route.counters))
    }

    /// Returns the destination of partial answers. `None` if the session is gone or its version has no partial answers.
    pub(crate) fn route_of_partial_answers(&self, session: SessionId) -> Option<Route> {
        self.lock_server().route_of_partial_answers(session)
    }

    /// Sends a partial answer with its number; the request was received at `received`.
    ///
    /// # Errors
    /// If the partial answer cannot be encoded, or the network did not accept it.
    pub(crate) fn send_partial_answer(
        &self,
        route: &Route,
        key: RequestKey,
        (number, received): (u32, MonoTime),
        partial_answer: &Sample,
    ) -> Result<(), SendFailure> {
        let frames = encode_partial_answer(&*self.clock, key, (number, received), partial_answer)
            // As in `send_answer`, `Gone` prevents a second attempt.
            .map_err(|error| SendFailure::Gone(error.to_string()))?;
        // The partial answer has no tag: a lost partial answer must not end its request.
        self.output.send(&route.peer, frames, None, Some(&route.counters))
    }

    /// Sends a message without payload. Returns whether the transport accepted it.
    pub(super) fn send_message(&self, peer: &Peer, header: &Header) -> bool {
        let counters = self.lock_server().connection_counters(peer.connection);
        match header.encode() {
            Ok(header) => self
                .output
                .send(peer, vec![header], None, counters.as_deref())
                .inspect_err(|reason| {
                    tracing::debug!(%reason, "the network did not accept a message to an edge; it is dropped");
                })
                .is_ok(),
            Err(error) => {
                tracing::warn!(%error, "cannot encode a message to an edge; it is dropped");
                false
            }
        }
    }

    /// Counts a malformed message. Logs it at a limited rate.
    pub(super) fn report_malformed(&self, from: &Peer, problem: &str) {
        self.output.counters.count_malformed();
        if let Some(counters) = self.lock_server().connection_counters(from.connection) {
            counters.count_malformed();
        }
        let from = from.address;
        let now = self.clock.mono();
        let mut throttle = self.log_throttle.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(times) = throttle.count_event("malformed", from.map(|address| address.ip()), now) {
            let from = from.map_or_else(|| "an unknown peer".into(), |address| address.to_string());
            tracing::warn!(from, problem, times, "dropped an invalid message");
        }
    }

    /// Waits until no request is in flight and no answer is being sent.
    pub(super) async fn wait_until_idle(&self) {
        self.answers.wait_until_idle(|| self.lock_server().in_flight_count()).await;
    }
}
