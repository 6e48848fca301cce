//! The edge's driver: a session over a transport.

use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak};
use std::time::Duration;

use peernet_clock::{RelatedClocks, SharedClock};
use peernet_logger::{Recorder, stage};
use peernet_sample::Sample;
use tokio::sync::{Semaphore, SemaphorePermit, oneshot, watch};
use tokio_util::sync::CancellationToken;

use super::client::{Client, CloseReason};
use super::exchange::{Arrived, Departed, Exchange, RequestError, Sizes, absorb, result};
use super::open::{OpenError, OpenedSession, handshake};
use super::receiving::Receiving;
use crate::message::{
    Departure, Header, HeaderError, PeerClock, RAW_STAMPS_SINCE, Request, SampleHeader, SessionAccepted,
    SessionHello, SessionId, TreeFrameError, encode_tree, put_upload,
};
use crate::statistics::{ConnectionAddresses, ConnectionStatistics, Counters};
use crate::transport::{EdgeSender, SendFailure, SendOptions};
use crate::{Address, SessionSettings};

/// Most remarks of one connection that are kept.
const MAX_REMARKS: usize = 64;

/// Stands for a timeout that the clock cannot hold.
const AGES: Duration = Duration::from_secs(10 * 365 * 24 * 3600);

/// An open session with a cloud. Clones are the same session; it closes when the last one goes.
///
/// It lives and dies with its connection: [`closed`](Self::closed) tells when it is over, and going on is
/// [`open`](Self::open)ing another.
#[derive(Clone, Debug)]
pub struct Session {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    shared: Arc<SessionState>,
    accepted: SessionAccepted,
    /// Cancelled to close; the receiving task listens.
    stop: CancellationToken,
    /// Cancelled by the receiving task when the connection is closed.
    stopped: CancellationToken,
}

impl Drop for Inner {
    fn drop(&mut self) {
        self.stop.cancel();
    }
}

/// What requests and the receiving task have in common.
#[derive(Debug)]
pub(crate) struct SessionState {
    pub(crate) session: SessionId,
    machine: Mutex<Client<oneshot::Sender<Answer>>>,
    pub(crate) sender: Box<dyn EdgeSender>,
    pub(crate) clock: SharedClock,
    pub(crate) counters: Counters,
    /// The version of the protocol that the cloud chose.
    version: u16,
    /// Places in flight; closed when the session is over.
    pub(crate) places: Semaphore,
    /// The tighter limit of both ends.
    max_message_bytes: u64,
    pub(crate) over: watch::Sender<Option<CloseReason>>,
    pub(crate) peer_clock: watch::Sender<PeerClock>,
    /// What the cloud told last of its end of the connection.
    pub(crate) peer_statistics: watch::Sender<Option<ConnectionStatistics>>,
    /// What the transport remarked, oldest first; [`MAX_REMARKS`] at most.
    pub(crate) remarks: watch::Sender<Vec<String>>,
    /// How many iterations the run was to have, once it is over.
    pub(crate) ordered: OnceLock<u64>,
}

/// What a request waits for.
#[derive(Debug)]
pub(crate) enum Answer {
    Reply(Box<Arrived>),
    /// The request or its answer was lost on the way, and how much of it arrived.
    Lost(String),
    Over(CloseReason),
}

impl Session {
    /// Opens a session with the cloud at `address`, over the network that its scheme selects.
    ///
    /// # Errors
    /// When nobody answers, not in time, or with a refusal.
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
        let places = accepted.max_in_flight.min(settings.max_in_flight).max(1);
        let shared = Arc::new(SessionState {
            session: accepted.session,
            machine: Mutex::new(Client::new(accepted.session)),
            sender: dialled.sender,
            clock,
            counters,
            version: accepted.protocol,
            places: Semaphore::new(places as usize),
            max_message_bytes: accepted.max_message_bytes.min(settings.max_message_bytes),
            over: watch::Sender::new(None),
            peer_clock: watch::Sender::new(accepted.accepted.host_clock.clone()),
            peer_statistics: watch::Sender::default(),
            remarks: watch::Sender::new(remarks),
            ordered: OnceLock::new(),
        });
        let (stop, stopped) = (CancellationToken::new(), CancellationToken::new());
        let task = Receiving { shared: shared.clone(), stop: stop.clone(), stopped: stopped.clone() };
        tokio::spawn(task.run(dialled.receiver, settings.close_timeout()));
        Self { inner: Arc::new(Inner { shared, accepted: accepted.accepted, stop, stopped }) }
    }

    /// What the cloud said when it accepted the session.
    pub fn accepted(&self) -> &SessionAccepted {
        &self.inner.accepted
    }

    /// Its id, which nobody but its two ends knows as long as nobody reads the connection.
    pub fn id(&self) -> SessionId {
        self.inner.shared.session
    }

    /// Which clocks the stamps of its exchanges are of: the cloud's is the free-running one where the version of the session has it.
    pub fn clocks(&self) -> RelatedClocks {
        if self.inner.shared.has_raw_stamps() { RelatedClocks::Raw } else { RelatedClocks::RawToWall }
    }

    /// What the cloud tells of its clocks: at first what it said when it accepted the session.
    pub fn peer_clock(&self) -> watch::Receiver<PeerClock> {
        self.inner.shared.peer_clock.subscribe()
    }

    /// What makes the connection worse than it could be, and what to do about it, in words.
    pub fn caveat(&self) -> Option<&str> {
        self.inner.shared.sender.caveat()
    }

    /// What else makes the connection worse than it could be, each with its object and what to do, as it is noticed. The texts
    /// stay; new ones come behind them.
    pub fn remarks(&self) -> watch::Receiver<Vec<String>> {
        let mut remarks = self.inner.shared.remarks.subscribe();
        remarks.mark_changed();
        remarks
    }

    /// What the cloud tells of its end of the connection: `None` until it does.
    pub fn peer_statistics(&self) -> watch::Receiver<Option<ConnectionStatistics>> {
        self.inner.shared.peer_statistics.subscribe()
    }

    /// Returns what was sent and received so far, the messages that opened the session included.
    pub fn statistics(&self) -> ConnectionStatistics {
        self.inner.shared.statistics()
    }

    /// Returns a reader of the statistics that does not keep the session open.
    pub fn statistics_reader(&self) -> StatisticsReader {
        StatisticsReader(Arc::downgrade(&self.inner.shared))
    }

    /// Sends a sample and waits for the answer; any number of requests may be under way.
    ///
    /// Records on `log`: `send-queue` if it had to wait for a free place in flight, `encode`, `upload`,
    /// `download`, their sizes, and what the cloud recorded. `timeout` covers all of it. Dropping the future
    /// gives the request up.
    pub async fn request(&self, log: Recorder, sample: &Sample, timeout: Duration) -> Exchange {
        let shared = &*self.inner.shared;
        let mut exchange = Exchange {
            log,
            result: Err(RequestError::Timeout),
            arrived: None,
            up: None,
            down: None,
            witnessed: None,
        };
        let now = tokio::time::Instant::now();
        let deadline = now.checked_add(timeout).unwrap_or(now + AGES);
        let _place = match shared.place(&mut exchange.log, deadline).await {
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
            Err(_) => {}
        }
        if exchange.arrived.is_none() {
            pending.sizes.record(&mut exchange.log, stage::UPLOAD_BYTES, stage::UPLOAD_LOGGER_BYTES);
        }
        exchange
    }

    /// Takes an answer. The cloud grew the tree as it was sent: nothing may be added before that is absorbed.
    fn take(&self, exchange: &mut Exchange, sent: &Pending<'_>, arrived: Arrived) {
        let shared = &*self.inner.shared;
        let sizes = Sizes::of(&arrived.frames);
        let log = &mut exchange.log;
        exchange.arrived = Some(arrived.at);
        let raw = shared.has_raw_stamps();
        let absorbed = absorb(log, self.inner.accepted.host, raw, &sent.departed, &arrived);
        sent.sizes.record(log, stage::UPLOAD_BYTES, stage::UPLOAD_LOGGER_BYTES);
        sizes.record(log, stage::DOWNLOAD_BYTES, stage::DOWNLOAD_LOGGER_BYTES);
        exchange.result = match absorbed {
            Ok(absorbed) => {
                exchange.down = absorbed.map(|(down, _)| down);
                exchange.witnessed = absorbed.and_then(|(_, witnessed)| witnessed);
                result(arrived.reply.outcome, arrived.frames)
            }
            Err(problem) => {
                shared.counters.malformed();
                Err(RequestError::Failed(format!("the answer makes no sense: {problem}")))
            }
        };
    }

    /// Waits until the session is over, and tells why.
    pub async fn closed(&self) -> CloseReason {
        let mut over = self.inner.shared.over.subscribe();
        match over.wait_for(Option::is_some).await {
            Ok(reason) => reason.clone().unwrap_or(CloseReason::Local),
            Err(_) => CloseReason::Local,
        }
    }

    /// Says goodbye and closes the connection; requests under way are lost. Closing twice does no harm.
    pub async fn close(&self) {
        self.inner.stop.cancel();
        self.inner.stopped.cancelled().await;
    }

    /// [Closes](Self::close) and tells that the run is over which was to have `ordered` iterations, so that nobody waits
    /// there for those that never came.
    pub async fn close_after(&self, ordered: u64) {
        self.inner.shared.ordered.get_or_init(|| ordered);
        self.close().await;
    }
}

/// Reads the statistics of a session's connection, from any thread, as long as it is there.
#[derive(Clone, Debug)]
pub struct StatisticsReader(Weak<SessionState>);

impl StatisticsReader {
    /// Both ends of the connection; `None` where the transport has no such addresses.
    pub fn addresses(&self) -> Option<ConnectionAddresses> {
        self.0.upgrade()?.sender.addresses()
    }

    /// Returns what was sent and received so far; `None` when the session is over. It asks the system: once a second is
    /// often enough.
    pub fn read(&self) -> Option<ConnectionStatistics> {
        Some(self.0.upgrade()?.statistics())
    }

    /// Returns what the cloud told last of its end of the connection; `None` when it has told nothing, as clouds of releases
    /// before 0.3.
    pub fn peer(&self) -> Option<ConnectionStatistics> {
        *self.0.upgrade()?.peer_statistics.borrow()
    }
}

/// Why a sample cannot be sent.
#[derive(Debug, thiserror::Error)]
enum UnsendableSample {
    #[error(transparent)]
    Header(#[from] HeaderError),
    #[error(transparent)]
    Tree(#[from] TreeFrameError),
    #[error("{bytes} bytes are more than max_message_bytes allows, {most}")]
    TooLarge { bytes: u64, most: u64 },
}

/// A request under way. Giving it up is dropping it.
struct Pending<'a> {
    shared: &'a SessionState,
    request: u64,
    departed: Departed,
    sizes: Sizes,
    answer: oneshot::Receiver<Answer>,
}

impl Drop for Pending<'_> {
    fn drop(&mut self) {
        self.shared.machine().give_up(self.request);
    }
}

impl SessionState {
    pub(crate) fn machine(&self) -> MutexGuard<'_, Client<oneshot::Sender<Answer>>> {
        self.machine.lock().unwrap_or_else(PoisonError::into_inner)
    }

    const fn has_raw_stamps(&self) -> bool {
        self.version >= RAW_STAMPS_SINCE
    }

    fn statistics(&self) -> ConnectionStatistics {
        self.counters.statistics(&self.sender.statistics())
    }

    fn over(&self) -> RequestError {
        let reason = self.over.borrow().clone().unwrap_or(CloseReason::Local);
        RequestError::Lost(reason.to_string())
    }

    /// The transport remarked something. What finds no room is in the log alone.
    pub(crate) fn remark(&self, text: String) {
        self.remarks.send_if_modified(|remarks| {
            let has_room = remarks.len() < MAX_REMARKS;
            if has_room {
                remarks.push(text);
            } else {
                tracing::warn!("{text}");
            }
            has_room
        });
    }

    /// A place in flight; recorded as `send-queue` only if there was none free.
    async fn place(
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
        place.map_err(|_| RequestError::Timeout)?.map_err(|_| self.over())
    }

    /// Encodes and hands to the network, from the task that asks for it.
    fn send(
        &self,
        log: &mut Recorder,
        sample: &Sample,
        deadline: tokio::time::Instant,
    ) -> Result<Pending<'_>, RequestError> {
        let failed =
            |error: UnsendableSample| RequestError::Failed(format!("the sample cannot be sent: {error}"));
        let encoding = log.start(stage::ENCODE);
        let prepared = self.prepare(log, sample);
        let (tree, sample_header) = match prepared {
            Ok(prepared) => prepared,
            Err(error) => {
                log.stop(encoding);
                return Err(failed(error));
            }
        };
        let (waiter, answer) = oneshot::channel();
        let request =
            self.machine().begin(waiter).map_err(|reason| RequestError::Lost(reason.to_string()))?;

        // Before the stamp, as the one at the answer is after it: if they are equal, so is all in between.
        let epoch = self.clock.epoch();
        let stamp = self.clock.stamp();
        log.stop_at(encoding, stamp.mono);
        let (told_epoch, sent_raw) =
            if self.has_raw_stamps() { (epoch, Some(stamp.raw)) } else { (self.clock.wall_epoch(), None) };
        let start = log.offset(stamp.mono);
        let departure = Departure { sent: stamp.wall, start, epoch: told_epoch, sent_raw };
        let departed = Departed { upload: put_upload(log.tree_mut(), departure), at: stamp, epoch };
        // From here on the request is given up by dropping it.
        let mut pending = Pending { shared: self, request, departed, sizes: Sizes::default(), answer };
        let header =
            Header::Request(Request { session: self.session, request, departure, sample: sample_header });
        let header = header.encode().map_err(|error| failed(error.into()))?;
        let mut frames = Vec::with_capacity(2 + sample.parts.len());
        frames.extend([header, tree]);
        frames.extend(sample.parts.iter().map(|part| part.bytes.clone()));
        pending.sizes = Sizes::of(&frames);
        let options = SendOptions { deadline: Some(deadline), tag: Some(request) };
        match self.sender.send(frames, options) {
            Ok(()) => {
                self.counters.sent(pending.sizes.total());
                Ok(pending)
            }
            Err(SendFailure::Full) => Err(RequestError::Overloaded(SendFailure::Full.to_string())),
            Err(SendFailure::Gone(reason)) => {
                self.counters.lost(1);
                Err(RequestError::Lost(reason))
            }
        }
    }

    fn prepare(
        &self,
        log: &Recorder,
        sample: &Sample,
    ) -> Result<(bytes::Bytes, SampleHeader), UnsendableSample> {
        let header = SampleHeader::of(sample)?;
        let tree = encode_tree(log.tree())?;
        let bytes = sample.payload_bytes().saturating_add(tree.len() as u64);
        if bytes > self.max_message_bytes {
            return Err(UnsendableSample::TooLarge { bytes, most: self.max_message_bytes });
        }
        Ok((tree, header))
    }
}
