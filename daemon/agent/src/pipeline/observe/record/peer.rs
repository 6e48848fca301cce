//! The tree of an iteration of which another agent observed the same messages on its host.

use peernet_clock::{OneWayDelay, SharedClock, Span, Stamp};
use peernet_logger::{Anchor, Growth, HostId, HostIndex, Measure, Name, Node, NodeId, Recorder, Tree, stage};

use super::{add_topics, count, ends, ticket};
use crate::link::{Crossing, HostStamp};
use crate::observed::ObservedPair;
use crate::pipeline::iteration;
use crate::pipeline::observe::peer::Pair;

/// Input messages that the peer did not receive.
const PEER_INPUT_MISSING: Name = Name::from_static("peer-input-missing");
/// Output messages that it did not receive.
const PEER_OUTPUT_MISSING: Name = Name::from_static("peer-output-missing");
/// Iterations of which the peer was not asked, or gave no answer.
const PEER_UNANSWERED: Name = Name::from_static("peer-unanswered");

/// The place of the peer in the tree: the only other host.
const PEER: HostIndex = HostIndex(1);

/// Returns the tree of a pair of messages with what the peer received, and when the iteration ended. `judge` judges the delays of
/// the input message and, where both are known, of the output message.
pub(in crate::pipeline::observe) fn answered_by_peer(
    (clock, host): (&SharedClock, HostId),
    peer: HostId,
    pair: &Pair,
    seen: &ObservedPair,
    judge: impl FnOnce(&Crossing, Option<&Crossing>) -> [Option<OneWayDelay>; 2],
) -> (Tree, Stamp) {
    let (input, output) = (&pair.input, &pair.output);
    let (begun, ended) = ends(input, output);
    let total = ended.mono - begun.mono;
    let mut log = Recorder::begin_at(SharedClock::clone(clock), host, begun);
    let mut stages = None;
    if let Some(arrived) = seen.input() {
        let up = Crossing { sender: input.received.at, receiver: arrived };
        let down = |departed| Crossing { sender: departed, receiver: output.at };
        let way_back = seen.output().zip(seen.elapsed()).map(|(departed, elapsed)| (down(departed), elapsed));
        let [up_delay, down_delay] = judge(&up, way_back.as_ref().map(|(down, _)| down));
        let upload = log.depart(stage::UPLOAD, begun);
        let nodes = way_back.map(|(down, elapsed)| at_peer(&down, elapsed, down_delay));
        // Both ways together are known by the monotonic clocks alone: what this host waited, less what the peer took.
        stages = way_back.filter(|(_, elapsed)| *elapsed <= total).map(|_| total);
        let base = u32::try_from(log.tree().nodes().len()).unwrap_or(u32::MAX);
        let growth = Growth {
            base,
            anchor: Anchor { host: peer, wall: arrived.wall },
            others: Vec::new(),
            closed: (upload, arrived.wall),
            nodes: nodes.into_iter().flatten().collect(),
        };
        match log.tree_mut().absorb(growth) {
            Ok(()) => {
                if let Some(Measure::Transit(transit)) = log.tree_mut().measure_mut(upload) {
                    **transit = up.transit(up_delay);
                }
            }
            Err(error) => {
                stages = None;
                tracing::error!(%error, "stamps of a peer make no tree; the iteration is recorded without them");
            }
        }
    }
    let missing = [(PEER_INPUT_MISSING, seen.input()), (PEER_OUTPUT_MISSING, seen.output())];
    for (name, _) in missing.into_iter().filter(|(_, stamp): &(Name, Option<HostStamp>)| stamp.is_none()) {
        count(log.tree_mut(), name, total, 1);
    }
    close(log, pair, ended, stages)
}

/// Returns the tree of a pair of messages of which nothing is known from the peer, and when the iteration ended.
pub(in crate::pipeline::observe) fn answered_without_peer(
    (clock, host): (&SharedClock, HostId),
    pair: &Pair,
) -> (Tree, Stamp) {
    let (begun, ended) = ends(&pair.input, &pair.output);
    let mut log = Recorder::begin_at(SharedClock::clone(clock), host, begun);
    count(log.tree_mut(), PEER_UNANSWERED, ended.mono - begun.mono, 1);
    close(log, pair, ended, None)
}

/// What happened at the peer and on the way back.
fn at_peer(down: &Crossing, elapsed: Span, delay: Option<OneWayDelay>) -> [Node; 2] {
    // The observed node may have had the input before the peer's agent.
    let elapsed = elapsed.max(Span::ZERO);
    let node = |name, start, measure| Node { parent: Some(NodeId::ROOT), name, host: PEER, start, measure };
    [
        node(stage::INFERENCE, Span::ZERO, Measure::Timer(Some(elapsed))),
        node(stage::DOWNLOAD, elapsed, Measure::Transit(Box::new(down.transit(delay)))),
    ]
}

fn close(mut log: Recorder, pair: &Pair, ended: Stamp, stages: Option<Span>) -> (Tree, Stamp) {
    let begun = pair.input.received.message.received;
    add_topics(log.tree_mut(), &pair.input, &pair.output, ended.mono - begun.mono, pair.uncounted);
    (iteration::close_with(log, &ticket(pair.input.position, begun), ended.mono, true, stages), ended)
}
