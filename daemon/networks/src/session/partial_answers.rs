//! Partial answers: parts of an answer that arrive at the edge before the answer is complete.

use std::fmt;
use std::num::NonZeroU32;
use std::sync::Arc;

use peernet_clock::{MonoTime, Stamp};
use peernet_logger::{HostIndex, Measure, Name, Node, NodeId, RawStamps, Recorder, Transit, Unit};
use peernet_sample::Sample;

use crate::message::{Departure, MAX_UNREAD_BYTES, MAX_UNREAD_PARTIAL_ANSWERS};

/// Name of the edge's node for the time from the departure of a request to the arrival of the first partial answer.
pub const FIRST_PART: Name = Name::from_static("first-part");
/// Name of the transit of the first partial answer from the cloud to the edge. It corresponds to `download`.
pub const FIRST_PART_DOWNLOAD: Name = Name::from_static("first-part-download");
/// Name of the value for the number of partial answers that arrived before the whole answer.
pub const PARTS: Name = Name::from_static("parts");
/// Name of the cloud's value for the number of partial answers that it sent. It is larger than [`PARTS`] if
/// partial answers were lost on the way or arrived after the whole answer.
pub const PARTS_SENT: Name = Name::from_static("parts-sent");

/// Number of partial answers after which the edge acknowledges them. It is a quarter of the window, so that an
/// acknowledgement usually reaches the cloud before the window is full.
const ACKNOWLEDGE_AFTER: u32 = MAX_UNREAD_PARTIAL_ANSWERS / 4;
/// Number of payload bytes of partial answers after which the edge acknowledges them; a quarter of the window, too.
const ACKNOWLEDGE_AFTER_BYTES: u64 = MAX_UNREAD_BYTES / 4;

/// Function that takes each partial answer when it arrives. It is called on the task that receives messages, and must
/// not block.
#[derive(Clone)]
pub struct PartialAnswerHandler(pub Arc<dyn Fn(&Sample) + Send + Sync>);

impl fmt::Debug for PartialAnswerHandler {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("PartialAnswerHandler")
    }
}

/// Counts of the partial answers to one request that have arrived, and the stamps of the first one.
#[derive(Debug, Default)]
pub(super) struct ArrivedPartialAnswers {
    /// Number of partial answers that arrived.
    arrived_count: u32,
    first: Option<FirstPartialAnswer>,
    /// Number of partial answers that count as read: the number of the newest partial answer, plus one.
    read_count: u32,
    /// Value of `read_count` that was acknowledged last.
    acknowledged_count: u32,
    /// Payload bytes of the partial answers that arrived since the last acknowledgement.
    unacknowledged_bytes: u64,
}

/// Departure and arrival of the partial answer that arrived first.
#[derive(Clone, Copy, Debug)]
struct FirstPartialAnswer {
    departure: Departure,
    arrival: Stamp,
}

impl ArrivedPartialAnswers {
    /// Adds a partial answer with this number and `bytes` bytes of payload. If an acknowledgement is due, returns the
    /// number of partial answers that count as read.
    pub(super) fn add(
        &mut self,
        number: u32,
        bytes: u64,
        departure: Departure,
        arrival: Stamp,
    ) -> Option<u32> {
        self.arrived_count += 1;
        self.first.get_or_insert(FirstPartialAnswer { departure, arrival });
        // On networks of datagrams, partial answers may overtake each other.
        self.read_count = self.read_count.max(number.saturating_add(1));
        self.unacknowledged_bytes = self.unacknowledged_bytes.saturating_add(bytes);
        let is_due = self.read_count - self.acknowledged_count >= ACKNOWLEDGE_AFTER
            || self.unacknowledged_bytes >= ACKNOWLEDGE_AFTER_BYTES;
        is_due.then(|| {
            self.acknowledged_count = self.read_count;
            self.unacknowledged_bytes = 0;
            self.read_count
        })
    }

    /// Returns the transit of the first partial answer from the cloud. `cloud` is the cloud's index in the
    /// tree. `None` if no partial answer arrived.
    pub(super) fn first_partial_answer_download(&self, cloud: HostIndex) -> Option<Node> {
        let FirstPartialAnswer { departure, arrival } = self.first?;
        let raw_stamps = departure.sent_raw.map(|sent| RawStamps { sent, received: arrival.raw });
        let transit = Transit { sent: departure.sent, received: Some(arrival.wall), delay: None, raw_stamps };
        Some(Node {
            parent: Some(NodeId::ROOT),
            name: FIRST_PART_DOWNLOAD,
            host: cloud,
            start: departure.sent_since_anchor,
            measure: Measure::Transit(Box::new(transit)),
        })
    }

    /// Returns the number of partial answers that arrived; `None` if none did.
    pub(super) const fn count(&self) -> Option<NonZeroU32> {
        NonZeroU32::new(self.arrived_count)
    }

    /// Adds `first-part` and `parts` to the edge's tree, if any partial answer arrived. `departure` is the
    /// departure of the request.
    pub(super) fn record(&self, recorder: &mut Recorder, departure: MonoTime) {
        let Some(FirstPartialAnswer { arrival, .. }) = self.first else { return };
        let start = recorder.offset(departure);
        let nodes = [
            (FIRST_PART, Measure::Timer(Some(arrival.mono - departure))),
            (PARTS, Measure::Value(f64::from(self.arrived_count), Unit::NONE)),
        ];
        for (name, measure) in nodes {
            recorder.tree_mut().add(NodeId::ROOT, name, start, measure);
        }
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{RawTime, Span, WallTime};

    use super::*;

    #[test]
    fn partial_answers_are_acknowledged_before_window_is_full() {
        let departure = Departure {
            sent: WallTime::from_unix_nanos(0),
            sent_since_anchor: Span::ZERO,
            epoch: 0,
            sent_raw: None,
        };
        let arrival = Stamp {
            wall: WallTime::from_unix_nanos(0),
            mono: MonoTime::from_nanos(0),
            raw: RawTime::from_nanos(0),
        };
        let mut partial_answers = ArrivedPartialAnswers::default();
        // The partial answers with odd numbers are lost.
        let acknowledged: Vec<u32> = (0..MAX_UNREAD_PARTIAL_ANSWERS)
            .step_by(2)
            .filter_map(|number| partial_answers.add(number, 1, departure, arrival))
            .collect();
        assert_eq!(acknowledged, [17, 33, 49]);
        assert_eq!(partial_answers.arrived_count, MAX_UNREAD_PARTIAL_ANSWERS / 2);
        let mut partial_answers = ArrivedPartialAnswers::default();
        let mut add_bytes = |number, bytes| partial_answers.add(number, bytes, departure, arrival);
        assert_eq!(add_bytes(0, ACKNOWLEDGE_AFTER_BYTES - 40), None);
        assert_eq!(add_bytes(1, 40), Some(2));
        assert_eq!(add_bytes(2, 40), None);
    }
}
