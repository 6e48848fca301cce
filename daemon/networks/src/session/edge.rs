//! The edge's driver of the session protocol: a session over a transport.

use std::sync::{Arc, OnceLock, Weak};
use std::time::Duration;

use peernet_clock::{RelatedClocks, SharedClock};
use peernet_logger::{Recorder, stage};
use peernet_sample::Sample;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::client::CloseReason;
use super::exchange::{ArrivedReply, Exchange, RequestError, Sizes, absorb, result};
use super::open::{OpenError, OpenedSession, handshake};
use super::receiving::ReceivingTask;
use super::remarks::Remarks;
use super::requests_in_flight::{Answer, RequestsInFlight};
use super::state::{PendingRequest, SessionState, SessionTerms};
use crate::message::{PeerClock, SessionAccepted, SessionHello, SessionId};
use crate::statistics::{ConnectionAddresses, ConnectionStatistics, Counters};
use crate::{Address, SessionSettings};

/// Replaces a timeout that the clock cannot represent.
const FAR_FUTURE: Duration = Duration::from_secs(10 * 365 * 24 * 3600);

/// An open session with a cloud. Clones are the same session; it closes when the last one is dropped.
///
/// A session exists exactly as long as its connection. [`closed`](Self::closed) returns when it is over; to continue,
/// the caller [opens](Self::open) another session. Transports do not reconnect by themselves, so that requests in
/// flight are lost at once and with the reason.
#[derive(Clone, Debug)]
pub struct Session {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    shared: Arc<SessionState>,
    accepted: SessionAccepted,
    /// Token that closes the session; the receiving task waits for it.
    stop: CancellationToken,
    /// Token that the receiving task cancels when the connection is closed.
    stopped: CancellationToken,
}

impl Drop for Inner {
    fn drop(&mut self) {
        self.stop.cancel();
    }
}

impl Session {
    /// Opens a session with the cloud at `address`, over the network that its scheme selects.
    ///
    /// # Errors
    /// If no answer comes in time, or the cloud refuses.
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
        OpenedSession { dialled, accepted, remarks }: OpenedSession,
        settings: &SessionSettings,
        clock: SharedClock,
        counters: Counters,
    ) -> Self {
        // Without a place, every request would wait until its timeout and give no other reason.
        let places = accepted.max_in_flight.min(settings.max_in_flight).max(1);
        let shared = Arc::new(SessionState {
            terms: SessionTerms {
                session: accepted.session,
                version: accepted.protocol,
                max_message_bytes: accepted.max_message_bytes.min(settings.max_message_bytes),
            },
            requests: RequestsInFlight::new(accepted.session, places as usize),
            sender: dialled.sender,
            clock,
            counters,
            peer_clock: watch::Sender::new(accepted.accepted.host_clock.clone()),
            peer_statistics: watch::Sender::default(),
            remarks: Remarks::new(remarks),
            ordered: OnceLock::new(),
        });
        let (stop, stopped) = (CancellationToken::new(), CancellationToken::new());
        let task = ReceivingTask { shared: shared.clone(), stop: stop.clone(), stopped: stopped.clone() };
        tokio::spawn(task.run(dialled.receiver, settings.close_timeout()));
        Self { inner: Arc::new(Inner { shared, accepted: accepted.accepted, stop, stopped }) }
    }

    /// Returns the cloud's acceptance of the session.
    pub fn accepted(&self) -> &SessionAccepted {
        &self.inner.accepted
    }

    /// Returns the id of the session. Only its two ends know it, unless a third party reads the connection.
    pub fn id(&self) -> SessionId {
        self.inner.shared.terms.session
    }

    /// Returns the clocks of the stamps in its exchanges. The cloud's clock is the free-running one if the version of
    /// the session supports it.
    pub fn clocks(&self) -> RelatedClocks {
        self.inner.shared.terms.clocks()
    }

    /// Returns a reader of the state of the cloud's clocks. The first state is that of the acceptance.
    pub fn peer_clock(&self) -> watch::Receiver<PeerClock> {
        self.inner.shared.peer_clock.subscribe()
    }

    /// Returns a text that says why the connection is worse than it could be, and what to do about it. `None` if there
    /// is no such reason.
    pub fn caveat(&self) -> Option<&str> {
        self.inner.shared.sender.caveat()
    }

    /// Returns a reader of further such texts, as the reasons are noticed. Each text names the object and says what to
    /// do. The list only grows.
    pub fn remarks(&self) -> watch::Receiver<Vec<String>> {
        self.inner.shared.remarks.subscribe()
    }

    /// Returns a reader of the statistics of the cloud's end of the connection: `None` before its first report.
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

    /// Sends a sample and waits for the answer. Any number of requests may be in progress at once.
    ///
    /// Records in `log`: `send-queue` if the request waited for a free place in flight, `encode`, `upload`, `download`,
    /// their sizes, and the nodes of the cloud. `timeout` covers all of it. Dropping the future gives the request up.
    pub async fn request(&self, log: Recorder, sample: &Sample, timeout: Duration) -> Exchange {
        let shared = &*self.inner.shared;
        let mut exchange = Exchange {
            log,
            result: Err(RequestError::Timeout),
            arrived: None,
            up: None,
            down: None,
            observation: None,
        };
        let now = tokio::time::Instant::now();
        let deadline = now.checked_add(timeout).unwrap_or(now + FAR_FUTURE);
        let _place = match shared.requests.place(&mut exchange.log, deadline).await {
            Ok(place) => place,
            Err(error) => return Exchange { result: Err(error), ..exchange },
        };
        let mut pending = match shared.send(&mut exchange.log, sample, deadline) {
            Ok(pending) => pending,
            Err(error) => return Exchange { result: Err(error), ..exchange },
        };
        exchange.up = Some(pending.departed.upload);
        let answer = tokio::time::timeout_at(deadline, &mut pending.answer).await;
        match answer {
            Ok(Ok(Answer::Reply(arrived))) => self.take(&mut exchange, &pending, *arrived),
            Ok(Ok(Answer::Lost(reason))) => exchange.result = Err(RequestError::Lost(reason)),
            Ok(Ok(Answer::Over(reason))) => exchange.result = Err(RequestError::Lost(reason.to_string())),
            Ok(Err(_)) => exchange.result = Err(RequestError::Lost("the receiving task is gone".into())),
            // The result remains the timeout.
            Err(_) => {}
        }
        // After an answer, the sizes have been recorded behind the nodes of the cloud.
        if exchange.arrived.is_none() {
            pending.sizes.record(&mut exchange.log, stage::UPLOAD_BYTES, stage::UPLOAD_LOGGER_BYTES);
        }
        exchange
    }

    /// Handles an answer. The cloud extended the tree as it was sent, so nothing may be added to the tree before the
    /// tree delta is absorbed.
    fn take(&self, exchange: &mut Exchange, sent: &PendingRequest<'_>, arrived: ArrivedReply) {
        let shared = &*self.inner.shared;
        let sizes = Sizes::of(&arrived.frames);
        let log = &mut exchange.log;
        exchange.arrived = Some(arrived.at);
        let raw = shared.terms.has_raw_stamps();
        let absorbed = absorb(log, self.inner.accepted.host, raw, &sent.departed, &arrived);
        sent.sizes.record(log, stage::UPLOAD_BYTES, stage::UPLOAD_LOGGER_BYTES);
        sizes.record(log, stage::DOWNLOAD_BYTES, stage::DOWNLOAD_LOGGER_BYTES);
        exchange.result = match absorbed {
            Ok(absorbed) => {
                exchange.down = absorbed.map(|(down, _)| down);
                exchange.observation = absorbed.and_then(|(_, observation)| observation);
                result(arrived.reply.outcome, arrived.frames)
            }
            Err(problem) => {
                shared.counters.malformed();
                Err(RequestError::Failed(format!("the answer makes no sense: {problem}")))
            }
        };
    }

    /// Waits until the session is over. Returns the reason.
    pub async fn closed(&self) -> CloseReason {
        self.inner.shared.requests.ended().await
    }

    /// Says goodbye and closes the connection; requests in flight are lost. Closing a closed session has no effect.
    pub async fn close(&self) {
        self.inner.stop.cancel();
        self.inner.stopped.cancelled().await;
    }

    /// [Closes](Self::close) the session at the end of a run that was to have `ordered` iterations, so that the cloud
    /// does not wait for missing ones.
    pub async fn close_after(&self, ordered: u64) {
        self.inner.shared.ordered.get_or_init(|| ordered);
        self.close().await;
    }
}

/// Reads the statistics of a session's connection from any thread. It does not keep the session open.
#[derive(Clone, Debug)]
pub struct StatisticsReader(Weak<SessionState>);

impl StatisticsReader {
    /// Returns the addresses of both ends of the connection. `None` if the transport has none or the session is over.
    pub fn addresses(&self) -> Option<ConnectionAddresses> {
        self.0.upgrade()?.sender.addresses()
    }

    /// Returns the statistics so far. `None` if the session is over. Asks the system, so calling it once a second is
    /// often enough.
    pub fn read(&self) -> Option<ConnectionStatistics> {
        Some(self.0.upgrade()?.statistics())
    }

    /// Returns the cloud's last report of the statistics of its end. `None` before the first report; clouds before 0.3
    /// send none.
    pub fn peer(&self) -> Option<ConnectionStatistics> {
        *self.0.upgrade()?.peer_statistics.borrow()
    }
}
