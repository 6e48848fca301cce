//! Drives the session protocol on the edge: a session over a transport.

use std::sync::{Arc, Mutex, OnceLock, Weak};
use std::time::Duration;

use peernet_clock::{RelatedClocks, SharedClock};
use peernet_logger::{Recorder, stage};
use peernet_sample::Sample;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::client::CloseReason;
use super::completed_request::{
    AbsorbedReply, ArrivedReply, AwaitedEvent, CompletedRequest, MessageSizes, RequestError, absorb,
    request_result,
};
use super::open::{OpenError, OpenedSession, handshake};
use super::partial_answers::{ArrivedPartialAnswers, PartialAnswerHandler};
use super::receiving::ReceivingTask;
use super::remarks::Remarks;
use super::requests_in_flight::{RequestOutcome, RequestsInFlight};
use super::state::{PendingRequest, SessionState, SessionTerms};
use crate::message::{PeerClock, SessionAccepted, SessionHello, SessionId};
use crate::statistics::{ConnectionAddresses, ConnectionStatistics, Counters};
use crate::{Address, SessionSettings};

/// Timeout that replaces a requested timeout whose deadline cannot be represented.
const MAX_REQUEST_TIMEOUT: Duration = Duration::from_secs(10 * 365 * 24 * 3600);

/// An open session with a cloud. All clones belong to one session, which closes when the last clone is dropped.
///
/// A session exists exactly as long as its connection. [`closed`](Self::closed) returns when the session is over; to
/// continue, the caller [opens](Self::open) another session. Transports do not reconnect by themselves. When a
/// connection breaks, the requests in flight therefore end at once as lost, with the reason.
#[derive(Clone, Debug)]
pub struct Session {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    shared: Arc<SessionState>,
    accepted: SessionAccepted,
    /// Token that closes the session. The receiving task ends when the token is cancelled.
    close_token: CancellationToken,
    /// Token that the receiving task cancels when the connection is closed.
    closed_token: CancellationToken,
}

impl Drop for Inner {
    fn drop(&mut self) {
        self.close_token.cancel();
    }
}

impl Session {
    /// Opens a session with the cloud at `address`, over the network that its scheme selects.
    ///
    /// # Errors
    /// If no answer arrives in time, or the cloud refuses.
    pub async fn open(
        address: &Address,
        hello: SessionHello,
        settings: SessionSettings,
        clock: SharedClock,
    ) -> Result<Self, OpenError> {
        let settings = settings.clamped();
        let counters = Counters::default();
        let opening = Box::pin(handshake(address, hello, &settings, &clock, &counters));
        Ok(Self::start(opening.await?, &settings, clock, counters))
    }

    fn start(
        OpenedSession { connection, accepted: acceptance, remarks }: OpenedSession,
        settings: &SessionSettings,
        clock: SharedClock,
        counters: Counters,
    ) -> Self {
        // With a limit of 0, every request would wait until its timeout, and no error would name the limit as the
        // cause.
        let slots = acceptance.max_in_flight.min(settings.max_in_flight).max(1);
        let shared = Arc::new(SessionState {
            terms: SessionTerms {
                session: acceptance.session,
                version: acceptance.protocol,
                // The cloud would refuse a larger message only after the message has crossed the network.
                max_message_bytes: acceptance.max_message_bytes.min(settings.max_message_bytes),
            },
            requests: RequestsInFlight::new(acceptance.session, slots as usize),
            sender: connection.sender,
            clock,
            counters,
            peer_clock: watch::Sender::new(acceptance.accepted.host_clock.clone()),
            peer_statistics: watch::Sender::default(),
            remarks: Remarks::new(remarks),
            cloud: acceptance.accepted.name.clone(),
            log_throttle: Mutex::default(),
            planned_iterations: OnceLock::new(),
        });
        let (close_token, closed_token) = (CancellationToken::new(), CancellationToken::new());
        let task = ReceivingTask {
            shared: shared.clone(),
            close_token: close_token.clone(),
            closed_token: closed_token.clone(),
        };
        tokio::spawn(task.run(connection.receiver, settings.close_timeout()));
        Self { inner: Arc::new(Inner { shared, accepted: acceptance.accepted, close_token, closed_token }) }
    }

    /// Returns the cloud's acceptance of the session.
    pub fn accepted(&self) -> &SessionAccepted {
        &self.inner.accepted
    }

    /// Returns the id of the session. Only the two ends of the session know the id, unless a third party reads the
    /// connection.
    pub fn id(&self) -> SessionId {
        self.inner.shared.terms.session
    }

    /// Returns the clocks whose stamps the session's exchanges contain. The cloud's clock is the free-running one if
    /// the version of the session supports it.
    pub fn clocks(&self) -> RelatedClocks {
        self.inner.shared.terms.clocks()
    }

    /// Returns a reader of the state of the cloud's clocks. The first state comes with the acceptance.
    pub fn peer_clock(&self) -> watch::Receiver<PeerClock> {
        self.inner.shared.peer_clock.subscribe()
    }

    /// Returns a warning about a limit of the system that slows the connection down, and what to do about it. `None` if
    /// there is no such limit.
    pub fn caveat(&self) -> Option<&str> {
        self.inner.shared.sender.caveat()
    }

    /// Returns a reader of further warnings that occur while the session is open, oldest first. Each text says what
    /// slows the connection down and what to do about it. The list only grows.
    pub fn remarks(&self) -> watch::Receiver<Vec<String>> {
        self.inner.shared.remarks.subscribe()
    }

    /// Returns a reader of the statistics of the cloud's end of the connection. The value is `None` before the cloud's
    /// first report.
    pub fn peer_statistics(&self) -> watch::Receiver<Option<ConnectionStatistics>> {
        self.inner.shared.peer_statistics.subscribe()
    }

    /// Returns the statistics of the connection so far, including the messages that opened the session.
    pub fn statistics(&self) -> ConnectionStatistics {
        self.inner.shared.statistics()
    }

    /// Returns a reader of the statistics that does not keep the session open.
    pub fn statistics_reader(&self) -> StatisticsReader {
        StatisticsReader(Arc::downgrade(&self.inner.shared))
    }

    /// Sends a sample and waits for the answer. Any number of requests may be in progress at the same time.
    ///
    /// Records in `recorder`: `send-queue` if the request had to wait because too many were in flight, `encode`,
    /// `upload`, `download`, the sizes of request and answer, and the nodes of the cloud. `timeout` is the time limit
    /// for everything, including the wait in the queue. The request is cancelled if the future is dropped or `timeout`
    /// ends. The cloud then stops computing if the model allows it.
    pub async fn request(&self, recorder: Recorder, sample: &Sample, timeout: Duration) -> CompletedRequest {
        self.request_with_partial_answers(recorder, sample, timeout, None).await
    }

    /// Sends a sample as [`request`](Self::request) does. `handler` takes each partial answer that arrives before the
    /// answer is complete.
    ///
    /// If any partial answer arrived, also records `first-part` and `parts`, and `first-part-download` if the whole
    /// answer arrives.
    pub async fn request_with_partial_answers(
        &self,
        recorder: Recorder,
        sample: &Sample,
        timeout: Duration,
        handler: Option<PartialAnswerHandler>,
    ) -> CompletedRequest {
        let shared = &*self.inner.shared;
        let mut completed = CompletedRequest {
            recorder,
            result: Err(RequestError::Timeout(AwaitedEvent::Answer)),
            arrived_at: None,
            upload: None,
            download: None,
            first_partial_answer: None,
            observation: None,
        };
        let now = tokio::time::Instant::now();
        let deadline = now.checked_add(timeout).unwrap_or(now + MAX_REQUEST_TIMEOUT);
        // The slot is held until the function returns, with the answer or without.
        let _slot = match shared.requests.acquire_slot(&mut completed.recorder, deadline).await {
            Ok(slot) => slot,
            Err(error) => return CompletedRequest { result: Err(error), ..completed },
        };
        let mut pending = match shared.send(&mut completed.recorder, sample, deadline, handler) {
            Ok(pending) => pending,
            Err(error) => return CompletedRequest { result: Err(error), ..completed },
        };
        completed.upload = Some(pending.departed.upload);
        // Partial answers of an answer that does not arrive completely.
        let mut partial_answers = ArrivedPartialAnswers::default();
        let outcome = tokio::time::timeout_at(deadline, &mut pending.outcome).await;
        match outcome {
            Ok(Ok(RequestOutcome::Reply(arrived))) => self.handle_reply(&mut completed, &pending, *arrived),
            Ok(Ok(RequestOutcome::Lost(reason, arrived))) => {
                partial_answers = arrived;
                completed.result = Err(RequestError::Lost(reason));
            }
            Ok(Ok(RequestOutcome::SessionEnded(reason, arrived))) => {
                partial_answers = arrived;
                completed.result = Err(RequestError::Lost(reason.to_string()));
            }
            Ok(Err(_)) => {
                completed.result = Err(RequestError::Lost("the task that receives answers has ended".into()));
            }
            // The deadline has passed. The result is a timeout from the start; only its event may change.
            Err(_) => {
                partial_answers = shared.requests.take_partial_answers(pending.request).unwrap_or_default();
                if let Some(count) = partial_answers.count() {
                    completed.result = Err(RequestError::Timeout(AwaitedEvent::RestOfAnswer(count)));
                }
            }
        }
        // If an answer arrived, `handle_reply` has recorded the sizes after the nodes of the cloud.
        if completed.arrived_at.is_none() {
            pending.sizes.record(&mut completed.recorder, stage::UPLOAD_BYTES, stage::UPLOAD_LOGGER_BYTES);
            partial_answers.record(&mut completed.recorder, pending.departed.stamp.mono);
        }
        completed
    }

    /// Handles an answer: adds the cloud's nodes, `download` and the sizes to the tree, and sets the result.
    fn handle_reply(
        &self,
        completed: &mut CompletedRequest,
        pending: &PendingRequest<'_>,
        arrived: ArrivedReply,
    ) {
        let shared = &*self.inner.shared;
        let sizes = MessageSizes::from_frames(&arrived.frames);
        let recorder = &mut completed.recorder;
        completed.arrived_at = Some(arrived.stamp);
        let has_raw_stamps = shared.terms.has_raw_stamps();
        // The delta is added before all other nodes, because its node ids refer to the tree as it was sent.
        let absorbed =
            absorb(recorder, self.inner.accepted.host, has_raw_stamps, &pending.departed, &arrived);
        pending.sizes.record(recorder, stage::UPLOAD_BYTES, stage::UPLOAD_LOGGER_BYTES);
        sizes.record(recorder, stage::DOWNLOAD_BYTES, stage::DOWNLOAD_LOGGER_BYTES);
        arrived.partial_answers.record(recorder, pending.departed.stamp.mono);
        completed.result = match absorbed {
            Ok(absorbed) => {
                if let Some(AbsorbedReply { download, first_partial_answer, observation }) = absorbed {
                    completed.download = Some(download);
                    completed.first_partial_answer = first_partial_answer;
                    completed.observation = observation;
                }
                request_result(arrived.reply.outcome, arrived.frames)
            }
            Err(problem) => {
                shared.counters.count_malformed();
                Err(RequestError::Failed(format!("the answer is invalid: {problem}")))
            }
        };
    }

    /// Waits until the session is over. Returns the reason.
    pub async fn closed(&self) -> CloseReason {
        self.inner.shared.requests.wait_for_end().await
    }

    /// Says goodbye and closes the connection; requests in flight are lost. Closing a closed session has no effect.
    pub async fn close(&self) {
        self.inner.close_token.cancel();
        self.inner.closed_token.cancelled().await;
    }

    /// [Closes](Self::close) the session at the end of a run, and tells the cloud how many iterations were planned.
    /// From this number the cloud knows how many requests never arrived, and does not wait for them.
    pub async fn close_after_run(&self, planned_iterations: u64) {
        self.inner.shared.planned_iterations.get_or_init(|| planned_iterations);
        self.close().await;
    }
}

/// Reads the statistics of a session's connection from any thread. The reader does not keep the session open.
#[derive(Clone, Debug)]
pub struct StatisticsReader(Weak<SessionState>);

impl StatisticsReader {
    /// Returns the addresses of both ends of the connection. `None` if the transport has none or the session is over.
    pub fn addresses(&self) -> Option<ConnectionAddresses> {
        self.0.upgrade()?.sender.addresses()
    }

    /// Returns the statistics so far. `None` if the session is over. Each call queries the operating system, so one
    /// call a second is enough.
    pub fn read(&self) -> Option<ConnectionStatistics> {
        Some(self.0.upgrade()?.statistics())
    }

    /// Returns the cloud's last report of the statistics of its end of the connection. `None` before the first report;
    /// clouds before release 0.3 send no reports.
    pub fn peer(&self) -> Option<ConnectionStatistics> {
        *self.0.upgrade()?.peer_statistics.borrow()
    }
}
