//! Nodes that a request and its answer add to the edge's tree.

use std::fmt;
use std::num::NonZeroU32;

use peernet_clock::{ExchangeObservation, RawTime, Span, Stamp};
use peernet_logger::{
    HostId, HostIndex, Measure, Name, Node, NodeId, RawStamps, Recorder, Transit, Tree, TreeError, Unit,
    stage,
};
use peernet_sample::Sample;

use super::partial_answers::ArrivedPartialAnswers;
use crate::message::{Departure, Outcome, Reply, TreeFrameError, decode_tree_delta};
use crate::transport::Frames;

/// A request that has ended, with or without an answer. The recorder is returned in every case.
#[derive(Debug)]
pub struct CompletedRequest {
    /// Tree of the iteration, with the nodes of the request and of the cloud.
    pub recorder: Recorder,
    /// The answer.
    pub result: Result<Sample, RequestError>,
    /// Time at which the whole answer had arrived; `None` if no answer came.
    pub arrived_at: Option<Stamp>,
    /// The `upload` node; `None` if the request was not sent.
    pub upload: Option<NodeId>,
    /// The `download` node; `None` if no model answered.
    pub download: Option<NodeId>,
    /// The [`FIRST_PART_DOWNLOAD`](crate::FIRST_PART_DOWNLOAD) node; `None` if no partial answer
    /// arrived, or if no model answered.
    pub first_partial_answer: Option<NodeId>,
    /// The four stamps of `upload` and `download`, from which the clock relation of the two hosts is estimated.
    ///
    /// The edge's stamps are of its free-running clock. The cloud's stamps are of its free-running clock since version
    /// [`RAW_STAMPS_SINCE`](crate::RAW_STAMPS_SINCE), and of its wall clock in earlier versions. `None` if no model
    /// answered. Also `None` if the clock of either host was interrupted between the four stamps, because such stamps
    /// bound no offset.
    pub observation: Option<ExchangeObservation>,
}

/// Error bound of an exchange's stamps. A stamp may be wrong by the resolution of its clock: at most 52.1 ns for the
/// counters of arm64, which run at 19.2 MHz or more, rounded up because stamps are whole nanoseconds. Each bound of the
/// offset is computed from two stamps, so the errors of two stamps add up.
const UNCERTAINTY: Span = Span::from_nanos(2 * 53);

/// A reply that arrived.
#[derive(Debug)]
pub(crate) struct ArrivedReply {
    pub(crate) reply: Reply,
    pub(crate) frames: Frames,
    /// Partial answers that arrived before the reply.
    pub(crate) partial_answers: ArrivedPartialAnswers,
    pub(crate) stamp: Stamp,
    /// Epoch of the edge's free-running clock, read right after the arrival was stamped.
    pub(crate) epoch: u32,
}

/// The departure of a request.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DepartedRequest {
    /// The `upload` node.
    pub(crate) upload: NodeId,
    pub(crate) stamp: Stamp,
    /// Epoch of the edge's free-running clock, read right before the departure was stamped.
    pub(crate) epoch: u32,
}

/// Event that a request was waiting for when its timeout passed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AwaitedEvent {
    /// A slot among the requests in flight: nothing was sent.
    Slot,
    /// The cloud's answer.
    Answer,
    /// The rest of the cloud's answer, after this number of partial answers.
    RestOfAnswer(NonZeroU32),
}

impl fmt::Display for AwaitedEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Slot => f.write_str("a slot among the requests in flight"),
            Self::Answer => f.write_str("the cloud's answer"),
            Self::RestOfAnswer(partial_answers) => {
                write!(f, "the rest of the cloud's answer after partial answer {partial_answers}")
            }
        }
    }
}

/// Reason why a request has no answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RequestError {
    /// The session ended before the answer arrived, or the request or its answer was lost on the way.
    #[error("the request was lost: {0}")]
    Lost(String),
    /// The request's timeout passed before the answer arrived. If the answer arrives later, it is dropped and counted
    /// as late.
    #[error("no answer in time, waiting for {0}")]
    Timeout(AwaitedEvent),
    /// The sample could not be sent, or the cloud's model failed on it. The next request may succeed.
    #[error("the request failed: {0}")]
    Failed(String),
    /// The cloud, or the network to it, accepts no more requests at the moment.
    #[error("the cloud is overloaded: {0}")]
    Overloaded(String),
}

/// Sizes of a message: of its metadata and of its payload. Bytes.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct MessageSizes {
    /// Length of the header and the tree, as in `upload-logger-bytes`.
    pub(crate) metadata: u64,
    /// Length of the payload.
    pub(crate) payload: u64,
}

impl MessageSizes {
    pub(crate) fn from_frames(frames: &Frames) -> Self {
        let bytes = |frames: &[bytes::Bytes]| frames.iter().map(|frame| frame.len() as u64).sum();
        let (metadata, payload) = frames.split_at(frames.len().min(2));
        Self { metadata: bytes(metadata), payload: bytes(payload) }
    }

    pub(crate) const fn total(self) -> u64 {
        self.metadata + self.payload
    }

    /// Adds the two sizes as values to the edge's tree. These nodes fit even into a tree that accepts no other nodes,
    /// because a recorder leaves [`RESERVED_NODES`](peernet_logger::limits::RESERVED_NODES) free for such values.
    pub(crate) fn record(self, recorder: &mut Recorder, payload: Name, metadata: Name) {
        let start = recorder.offset(recorder.clock().mono());
        for (name, bytes) in [(payload, self.payload), (metadata, self.metadata)] {
            recorder.tree_mut().add(NodeId::ROOT, name, start, Measure::Value(bytes as f64, Unit::BYTES));
        }
    }
}

/// Error: a tree delta does not fit the tree that was sent.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TreeDeltaError {
    #[error(transparent)]
    Frame(#[from] TreeFrameError),
    #[error("the tree delta closes another node than the upload of this request")]
    OtherNodeClosed,
    #[error("the tree delta names another host than the cloud")]
    OtherHost,
    #[error("the tree would have too many hosts")]
    TooManyHosts,
    #[error("the tree delta adds a node to a host that was in the tree before the cloud")]
    EarlierHost,
    #[error("the stamps of the cloud's free-running clock are missing")]
    NoRawStamps,
    #[error("the tree would have too many nodes")]
    TooManyNodes,
    #[error(transparent)]
    Tree(#[from] TreeError),
}

/// The transits from the cloud that an answer added to the tree, and the stamps of the exchange.
#[derive(Debug)]
pub(crate) struct AbsorbedReply {
    /// The `download` node.
    pub(crate) download: NodeId,
    /// The node of the first partial answer's download, if any partial answer arrived.
    pub(crate) first_partial_answer: Option<NodeId>,
    /// The stamps of the exchange; `None` if a clock was interrupted.
    pub(crate) observation: Option<ExchangeObservation>,
}

/// Adds the cloud's nodes to the tree: closes `upload`, appends the nodes of the delta, the download of the first
/// partial answer, and `download`. Returns `None` if no model answered. `has_raw_stamps` is `true` if the session's
/// version has stamps of the cloud's free-running clock.
///
/// A tree delta may only add nodes of the host that made it.
///
/// # Errors
/// If the delta does not fit the tree. The tree is then unchanged.
pub(crate) fn absorb(
    recorder: &mut Recorder,
    cloud: HostId,
    has_raw_stamps: bool,
    departed: &DepartedRequest,
    arrived: &ArrivedReply,
) -> Result<Option<AbsorbedReply>, TreeDeltaError> {
    let (Some(departure), Some(delta)) = (arrived.reply.departure, arrived.frames.get(1)) else {
        return Ok(None);
    };
    let mut delta = decode_tree_delta(delta)?;
    // The cloud may close only the node of this request's upload.
    if delta.closed.0 != departed.upload {
        return Err(TreeDeltaError::OtherNodeClosed);
    }
    // Otherwise a cloud could add nodes in the name of another host.
    if delta.anchor.host != cloud {
        return Err(TreeDeltaError::OtherHost);
    }
    let host_count =
        u8::try_from(recorder.tree().anchors().len()).map_err(|_| TreeDeltaError::TooManyHosts)?;
    // The delta's anchor is appended to the anchors of the tree.
    let cloud_index = HostIndex(host_count);
    if delta.nodes.iter().any(|node| node.host < cloud_index) {
        return Err(TreeDeltaError::EarlierHost);
    }
    let (received, replied) = match (has_raw_stamps, arrived.reply.arrived_raw, departure.sent_raw) {
        // Older versions send stamps of the cloud's wall clock only, which take the place of its free-running clock.
        (false, ..) => (RawTime::from_wall(delta.closed.1), RawTime::from_wall(departure.sent)),
        (true, Some(received), Some(replied)) => (received, replied),
        (true, ..) => return Err(TreeDeltaError::NoRawStamps),
    };
    let raw_stamps = Some(RawStamps { sent: replied, received: arrived.stamp.raw });
    let transit =
        Transit { sent: departure.sent, received: Some(arrived.stamp.wall), delay: None, raw_stamps };
    let first_partial_answer = arrived.partial_answers.first_partial_answer_download(cloud_index);
    let has_partial_answers = first_partial_answer.is_some();
    delta.nodes.extend(first_partial_answer);
    delta.nodes.push(Node {
        parent: Some(NodeId::ROOT),
        name: stage::DOWNLOAD,
        host: cloud_index,
        start: departure.sent_since_anchor,
        measure: Measure::Transit(Box::new(transit)),
    });
    let observation = make_observation(departed, has_raw_stamps, (received, replied), departure, arrived);
    recorder.tree_mut().apply_delta(delta)?;
    let upload_stamps = RawStamps { sent: departed.stamp.raw, received };
    set_raw_stamps(recorder.tree_mut(), departed.upload, upload_stamps);
    let last_index = recorder.tree().nodes().len() - 1;
    let last_index = u32::try_from(last_index).map_err(|_| TreeDeltaError::TooManyNodes)?;
    // `download` was appended last, and the first partial answer right before it.
    let first_partial_answer = has_partial_answers.then(|| NodeId(last_index - 1));
    Ok(Some(AbsorbedReply { download: NodeId(last_index), first_partial_answer, observation }))
}

fn set_raw_stamps(tree: &mut Tree, node: NodeId, stamps: RawStamps) {
    if let Some(Measure::Transit(transit)) = tree.measure_mut(node) {
        transit.raw_stamps = Some(stamps);
    }
}

/// Returns the stamps of an exchange. `received` and `replied` are the cloud's stamps; `has_raw_stamps` is `true` if
/// they are of its free-running clock. `None` if a clock was interrupted during the exchange.
fn make_observation(
    departed: &DepartedRequest,
    has_raw_stamps: bool,
    (received, replied): (RawTime, RawTime),
    departure: Departure,
    arrived: &ArrivedReply,
) -> Option<ExchangeObservation> {
    // A step between the stamps would look like a part of the offset.
    if departed.epoch != arrived.epoch || arrived.reply.arrival_epoch != departure.epoch {
        return None;
    }
    let exchange = peernet_clock::Exchange {
        sent: departed.stamp.raw,
        received,
        replied,
        returned: arrived.stamp.raw,
        uncertainty: UNCERTAINTY,
    };
    Some(ExchangeObservation {
        exchange,
        // The duration is of the monotonic clock, which is slewed. It must not be compared with stamps of the
        // free-running clock, which is not slewed.
        cloud_elapsed: (!has_raw_stamps).then_some(departure.sent_since_anchor),
        edge_epoch: arrived.epoch,
        cloud_epoch: Some(departure.epoch),
    })
}

/// Returns the result of a request with this outcome and these frames.
pub(crate) fn request_result(outcome: Outcome, frames: Frames) -> Result<Sample, RequestError> {
    match outcome {
        Outcome::Answer(header) => header
            .into_sample(frames.into_iter().skip(2))
            .map_err(|error| RequestError::Failed(format!("the answer is invalid: {error}"))),
        Outcome::Failed(reason) => Err(RequestError::Failed(reason)),
        Outcome::Overloaded(reason) => Err(RequestError::Overloaded(reason)),
    }
}
