//! State that the requests of a session share with its receiving task.

use std::sync::{Mutex, OnceLock, PoisonError};

use peernet_clock::{LogThrottle, RelatedClocks, SharedClock};
use peernet_logger::{Recorder, Slug, stage};
use peernet_sample::Sample;
use tokio::sync::{oneshot, watch};

use super::completed_request::{DepartedRequest, MessageSizes, RequestError};
use super::partial_answers::PartialAnswerHandler;
use super::remarks::Remarks;
use super::requests_in_flight::{RequestOutcome, RequestsInFlight};
use crate::message::{
    Cancel, Departure, Header, HeaderError, PARTIAL_REPLIES_SINCE, PeerClock, RAW_STAMPS_SINCE, Request,
    SampleHeader, SessionId, TreeFrameError, add_upload, encode_tree,
};
use crate::statistics::{ConnectionStatistics, Counters};
use crate::transport::{EdgeSender, SendFailure, SendOptions};

/// Terms on which both ends of a session agreed.
#[derive(Clone, Copy, Debug)]
pub(super) struct SessionTerms {
    pub(super) session: SessionId,
    /// Version of the protocol that the cloud chose.
    pub(super) version: u16,
    /// Largest message that both ends accept. Bytes.
    pub(super) max_message_bytes: u64,
}

impl SessionTerms {
    /// Returns the clocks of the stamps in exchanges. The cloud's clock is the free-running one if the version supports
    /// it.
    pub(super) const fn clocks(self) -> RelatedClocks {
        if self.has_raw_stamps() { RelatedClocks::Raw } else { RelatedClocks::RawToWall }
    }

    /// Returns whether the version has stamps of the cloud's free-running clock.
    pub(super) const fn has_raw_stamps(self) -> bool {
        self.version >= RAW_STAMPS_SINCE
    }
}

/// State of an open session.
#[derive(Debug)]
pub(super) struct SessionState {
    pub(super) terms: SessionTerms,
    pub(super) requests: RequestsInFlight,
    pub(super) sender: Box<dyn EdgeSender>,
    pub(super) clock: SharedClock,
    pub(super) counters: Counters,
    pub(super) peer_clock: watch::Sender<PeerClock>,
    /// Last report of the cloud about its end of the connection.
    pub(super) peer_statistics: watch::Sender<Option<ConnectionStatistics>>,
    pub(super) remarks: Remarks,
    /// Name of the cloud, for the log.
    pub(super) cloud: Slug,
    pub(super) log_throttle: Mutex<LogThrottle>,
    /// Number of iterations that the run was planned to have. Set when the run is over, for the goodbye: a cloud that
    /// serves a fixed number of requests then does not wait for missing requests.
    pub(super) planned_iterations: OnceLock<u64>,
}

/// Reason why a sample cannot be sent.
#[derive(Debug, thiserror::Error)]
enum UnsendableSample {
    #[error(transparent)]
    Header(#[from] HeaderError),
    #[error(transparent)]
    Tree(#[from] TreeFrameError),
    #[error(
        "it has {bytes} bytes, more than max_message_bytes of the session allows ({max_bytes}): raise max_message_bytes at both ends \
         ([pipeline.placement.session] and [serve.session]; --max-message-bytes of peernet --client and --server), or make \
         samples smaller with a transform or --encoding"
    )]
    TooLarge { bytes: u64, max_bytes: u64 },
}

/// A request in flight. Dropping it cancels the request, also on the cloud.
pub(super) struct PendingRequest<'a> {
    state: &'a SessionState,
    pub(super) request: u64,
    is_sent: bool,
    pub(super) departed: DepartedRequest,
    pub(super) sizes: MessageSizes,
    pub(super) outcome: oneshot::Receiver<RequestOutcome>,
}

impl Drop for PendingRequest<'_> {
    fn drop(&mut self) {
        let is_unanswered = self.state.requests.cancel_request(self.request);
        // In an older version, the cloud does not know the message `cancel` and would count it as malformed.
        if is_unanswered && self.is_sent && self.state.terms.version >= PARTIAL_REPLIES_SINCE {
            let session = self.state.terms.session;
            self.state.send_control(&Header::Cancel(Cancel { session, request: self.request }));
        }
    }
}

impl SessionState {
    /// Returns the statistics of the connection so far.
    pub(super) fn statistics(&self) -> ConnectionStatistics {
        self.counters.statistics(&self.sender.statistics())
    }

    /// Counts an invalid message from the cloud, and logs it at most once a minute.
    pub(super) fn report_invalid(&self, problem: &str) {
        self.counters.count_malformed();
        let now = self.clock.mono();
        let mut throttle = self.log_throttle.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(times) = throttle.count_event("malformed", None, now) {
            tracing::warn!(
                cloud = %self.cloud, problem, times,
                "dropped an invalid message from the cloud: if it was an answer, its iteration times out; check that nothing alters \
                 messages on the way, and that both hosts have the same version of PEERNet"
            );
        }
    }

    /// Sends a message without payload. A message that the network does not accept is dropped.
    pub(super) fn send_control(&self, header: &Header) {
        let sent = header.encode().map_err(|error| error.to_string()).and_then(|header| {
            let bytes = header.len() as u64;
            self.sender.send(vec![header], SendOptions::default()).map_err(|error| error.to_string())?;
            Ok(bytes)
        });
        match sent {
            Ok(bytes) => self.counters.count_sent(bytes),
            Err(error) => tracing::debug!(error, "cannot send a message to the cloud; it is dropped"),
        }
    }

    /// Encodes a sample and hands it to the network. The calling task writes to the socket itself; otherwise `upload`
    /// would include the time of a switch to another task.
    pub(super) fn send(
        &self,
        recorder: &mut Recorder,
        sample: &Sample,
        deadline: tokio::time::Instant,
        handler: Option<PartialAnswerHandler>,
    ) -> Result<PendingRequest<'_>, RequestError> {
        let failed =
            |error: UnsendableSample| RequestError::Failed(format!("the sample cannot be sent: {error}"));
        let encoding = recorder.start(stage::ENCODE);
        let encoded = self.encode_tree_and_sample_header(recorder, sample);
        let (tree, sample_header) = match encoded {
            Ok(encoded) => encoded,
            Err(error) => {
                recorder.stop(encoding);
                return Err(failed(error));
            }
        };
        let (request, outcome) = self.requests.start_request(handler)?;

        // This epoch is read before the departure is stamped. A second epoch is read after the arrival of the answer is
        // stamped. If the two epochs are equal, no step of the clock lies between the two stamps.
        let epoch = self.clock.epoch();
        let stamp = self.clock.stamp();
        recorder.stop_at(encoding, stamp.mono);
        let (sent_epoch, sent_raw) = if self.terms.has_raw_stamps() {
            (epoch, Some(stamp.raw))
        } else {
            (self.clock.wall_epoch(), None)
        };
        let sent_since_anchor = recorder.offset(stamp.mono);
        let departure = Departure { sent: stamp.wall, sent_since_anchor, epoch: sent_epoch, sent_raw };
        let departed = DepartedRequest { upload: add_upload(recorder.tree_mut(), departure), stamp, epoch };
        // From here on, an early return drops `pending`, which cancels the request.
        let sizes = MessageSizes::default();
        let mut pending = PendingRequest { state: self, request, is_sent: false, departed, sizes, outcome };
        let header = Header::Request(Request {
            session: self.terms.session,
            request,
            departure,
            sample: sample_header,
        });
        let header = header.encode().map_err(|error| failed(error.into()))?;
        let mut frames = Vec::with_capacity(2 + sample.parts.len());
        frames.extend([header, tree]);
        frames.extend(sample.parts.iter().map(|part| part.bytes.clone()));
        pending.sizes = MessageSizes::from_frames(&frames);
        let options = SendOptions { deadline: Some(deadline), tag: Some(request) };
        match self.sender.send(frames, options) {
            Ok(()) => {
                self.counters.count_sent(pending.sizes.total());
                pending.is_sent = true;
                Ok(pending)
            }
            Err(SendFailure::Full) => Err(RequestError::Overloaded(SendFailure::Full.to_string())),
            Err(SendFailure::Gone(reason)) => {
                self.counters.count_lost(1);
                Err(RequestError::Lost(reason))
            }
        }
    }

    /// Returns the encoded tree and the description of the sample.
    fn encode_tree_and_sample_header(
        &self,
        recorder: &Recorder,
        sample: &Sample,
    ) -> Result<(bytes::Bytes, SampleHeader), UnsendableSample> {
        let header = SampleHeader::from_sample(sample)?;
        let tree = encode_tree(recorder.tree())?;
        // The size is checked before sending, because the cloud closes a connection on which a larger message arrives.
        let bytes = sample.payload_bytes().saturating_add(tree.len() as u64);
        let max_bytes = self.terms.max_message_bytes;
        if bytes > max_bytes {
            return Err(UnsendableSample::TooLarge { bytes, max_bytes });
        }
        Ok((tree, header))
    }
}
