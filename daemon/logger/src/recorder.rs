//! Recording of a tree while an iteration runs.

mod guard;

pub use self::guard::{MeterGuard, TimerGuard, TokenGuard};

use peernet_clock::{MonoTime, SharedClock, Span, Stamp, WallTime};

use crate::limits::{MAX_ANCHORS, MAX_DEPTH, MAX_NODES, RESERVED_NODES};
use crate::{
    Anchor, HostId, HostIndex, Measure, Meter, Name, Node, NodeId, Transit, Tree, TreeDelta, TreeError, Unit,
    stage,
};

/// Recorder of a tree on one host: opens and closes nodes below the innermost open node.
///
/// The tree never exceeds [`crate::limits`]. Nodes that do not fit are left out ([`NodeId::SKIPPED`]). The number of
/// omitted nodes is recorded as `skipped-nodes`. Children of an omitted node become children of the innermost node that
/// exists.
///
/// ```
/// # use std::sync::Arc;
/// # use peernet_clock::{ClockIdentity, ManualClock, Span, WallTime};
/// # use peernet_logger::{HostId, Recorder, stage};
/// let clock = Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("b", "c")));
/// let mut log = Recorder::new(clock.clone(), HostId::random());
/// {
///     let mut sensing = log.time(stage::SENSING);
///     let _capture = sensing.time(stage::CAPTURE);
///     clock.advance(Span::from_millis(2));
/// }
/// let tree = log.finish();
/// assert_eq!(tree.find(&["sensing", "capture"]).unwrap().1.measure.value(), Some(0.002));
/// ```
#[derive(Clone, Debug)]
pub struct Recorder {
    pub(crate) clock: SharedClock,
    pub(crate) tree: Tree,
    host: HostIndex,
    /// Time of this host's anchor on its monotonic clock.
    anchor_time: MonoTime,
    /// The innermost open node.
    pub(crate) innermost: NodeId,
    /// Level of the innermost open node; the root is on level 1.
    pub(crate) level: usize,
    /// Number of nodes left out because the tree had reached its limits.
    skipped_nodes: u32,
    /// State of the tree when it arrived from another host; `None` for a tree that was created on this host.
    resume_state: Option<ResumeState>,
}

/// State of a tree when it arrived from another host.
#[derive(Clone, Copy, Debug)]
struct ResumeState {
    /// Number of nodes that the tree had on its arrival.
    base: u32,
    /// The transit with which the tree arrived, and the time of its end on this host's wall clock.
    closed: (NodeId, WallTime),
}

impl Recorder {
    /// Creates the recorder of an iteration that starts now.
    pub fn new(clock: SharedClock, host: HostId) -> Self {
        let now = clock.stamp();
        Self::starting_at(clock, host, now)
    }

    /// Creates the recorder of an iteration whose intended start is `at`: now or an earlier time.
    pub fn starting_at(clock: SharedClock, host: HostId, at: Stamp) -> Self {
        let tree = Tree::new(stage::ITERATION, Anchor { host, wall: at.wall });
        let resume_state = None;
        Self::for_tree(clock, tree, HostIndex::EDGE, at.mono, resume_state)
    }

    /// Continues a tree that arrived from another host. `transit` is the transit of the message that carried the tree.
    /// It is closed at `arrival`.
    ///
    /// # Errors
    /// If `transit` is not an open transit, or if the tree already has the maximum number of hosts.
    pub fn resume(
        clock: SharedClock,
        host: HostId,
        mut tree: Tree,
        transit: NodeId,
        arrival: Stamp,
    ) -> Result<Self, TreeError> {
        // Nodes from this position on are added on this host and sent back.
        let base = tree.nodes().len() as u32;
        if tree.anchors.len() >= MAX_ANCHORS {
            return Err(TreeError::TooManyHosts(tree.anchors.len() + 1));
        }
        match tree.measure_mut(transit) {
            Some(Measure::Transit(transit)) if transit.received.is_none() => {
                transit.received = Some(arrival.wall);
            }
            _ => return Err(TreeError::NotInFlight(transit.index())),
        }
        // The times of this host's nodes are counted from the arrival, so that they need no relation to the sender's
        // clock.
        tree.anchors.push(Anchor { host, wall: arrival.wall });
        let host = HostIndex((tree.anchors.len() - 1) as u8);
        let resume_state = Some(ResumeState { base, closed: (transit, arrival.wall) });
        Ok(Self::for_tree(clock, tree, host, arrival.mono, resume_state))
    }

    const fn for_tree(
        clock: SharedClock,
        tree: Tree,
        host: HostIndex,
        anchor_time: MonoTime,
        resume_state: Option<ResumeState>,
    ) -> Self {
        Self {
            clock,
            tree,
            host,
            anchor_time,
            innermost: NodeId::ROOT,
            level: 1,
            skipped_nodes: 0,
            resume_state,
        }
    }

    /// Returns the clock that the recorder reads.
    pub fn clock(&self) -> &SharedClock {
        &self.clock
    }

    /// Returns the tree recorded so far.
    pub fn tree(&self) -> &Tree {
        &self.tree
    }

    /// Returns the tree recorded so far, to add computed nodes.
    pub fn tree_mut(&mut self) -> &mut Tree {
        &mut self.tree
    }

    /// Converts a time of this host's monotonic clock to an offset from the anchor.
    pub fn offset(&self, at: MonoTime) -> Span {
        at - self.anchor_time
    }

    /// Opens a timer that closes when the guard is dropped. Nodes opened through the guard become its children.
    #[inline]
    pub fn time(&mut self, name: Name) -> TimerGuard<'_> {
        let started_at = self.clock.mono();
        self.enter(name, started_at, Measure::Timer(None))
    }

    /// Opens a timer that [`stop`](Self::stop) closes, for code in which a guard cannot live long enough.
    pub fn start(&mut self, name: Name) -> NodeId {
        let now = self.clock.mono();
        self.append_at(name, now, Measure::Timer(None))
    }

    /// Closes a timer now. A timer that is already closed keeps its end.
    pub fn stop(&mut self, timer: NodeId) {
        let now = self.clock.mono();
        self.stop_at(timer, now);
    }

    /// Closes a timer at a past time. A timer that is already closed keeps its end.
    pub fn stop_at(&mut self, timer: NodeId, at: MonoTime) {
        let end = self.offset(at);
        if let Some(node) = self.tree.nodes.get_mut(timer.index())
            && let Measure::Timer(duration @ None) = &mut node.measure
        {
            *duration = Some(end - node.start);
        }
    }

    /// Records a timer that started and ended at the given times.
    pub fn record_timer(&mut self, name: Name, from: MonoTime, to: MonoTime) -> NodeId {
        self.append_at(name, from, Measure::Timer(Some(to - from)))
    }

    /// Opens a container. Nodes opened through the guard become its children.
    pub fn container(&mut self, name: Name) -> TimerGuard<'_> {
        let started_at = self.clock.mono();
        self.enter(name, started_at, Measure::Container)
    }

    /// Measures with a custom instrument until the guard is dropped. Nodes opened through the guard become its
    /// children.
    pub fn measure<M: Meter>(&mut self, name: Name, meter: M) -> MeterGuard<'_, M> {
        let started_at = self.clock.mono();
        let measure = Measure::Custom(meter.kind(), meter.unit(), None);
        MeterGuard::new(self.enter(name, started_at, measure), meter)
    }

    /// Counts the tokens of a language model until the guard is dropped.
    pub fn tokens(&mut self, name: Name) -> TokenGuard<'_> {
        let started_at = self.clock.mono();
        TokenGuard::new(self.enter(name, started_at, Measure::TokenRate(None)), started_at)
    }

    /// Records a number. NaN is recorded as a node without value.
    pub fn record_value(&mut self, name: Name, value: f64, unit: Unit) -> NodeId {
        let now = self.clock.mono();
        self.append_at(name, now, Measure::Value(value, unit).without_nan())
    }

    /// Opens the node of a message that is handed to the network at `sent`. The receiver closes it.
    pub fn start_transit(&mut self, name: Name, sent: Stamp) -> NodeId {
        let transit = Transit { sent: sent.wall, received: None, delay: None, raw_stamps: None };
        self.append_at(name, sent.mono, Measure::Transit(Box::new(transit)))
    }

    /// Closes the transit of a message that arrived on this host. A transit that is already closed keeps its end.
    pub fn end_transit(&mut self, transit: NodeId, at: WallTime) {
        if let Some(Measure::Transit(measure)) = self.tree.measure_mut(transit) {
            measure.received.get_or_insert(at);
        }
    }

    /// Inserts a whole tree, which another recorder recorded, below the innermost open node. Returns the position of
    /// the inserted root.
    ///
    /// The nodes keep their hosts. If a host already belongs to this tree, the host's wall clock determines how far the
    /// inserted nodes are from the host's anchor in this tree.
    ///
    /// # Errors
    /// If this tree would exceed its limits, or if the inserted tree is invalid. This tree is then unchanged.
    pub fn insert(&mut self, tree: &Tree) -> Result<NodeId, TreeError> {
        // As for recorded nodes, the reserved nodes stay free for values that are computed afterwards.
        let fits = self.tree.nodes.len() + tree.nodes().len() <= MAX_NODES - RESERVED_NODES;
        if !fits {
            return Err(TreeError::TooManyNodes(self.tree.nodes.len() + tree.nodes().len()));
        }
        self.tree.insert_tree(self.innermost, tree)
    }

    /// Ends the recording. Nodes that are still open stay open.
    pub fn finish(mut self) -> Tree {
        self.record_skipped();
        self.tree
    }

    /// Ends the recording of a [resumed](Self::resume) tree. Returns the additions of this host, which are sent back;
    /// `None` for a tree that was created on this host.
    pub fn into_tree_delta(mut self) -> Option<TreeDelta> {
        let ResumeState { base, closed } = self.resume_state?;
        self.record_skipped();
        let nodes = self.tree.nodes.split_off(base as usize);
        // The first anchor that was added on this host is the anchor of this host.
        let mut anchors = self.tree.anchors.drain(usize::from(self.host.0)..);
        let anchor = anchors.next()?;
        Some(TreeDelta { base, anchor, others: anchors.collect(), closed, nodes })
    }

    /// Opens a node that is the innermost open node until its guard is dropped.
    #[inline]
    fn enter(&mut self, name: Name, started_at: MonoTime, measure: Measure) -> TimerGuard<'_> {
        let (outer, outer_level) = (self.innermost, self.level);
        let node = self.append_at(name, started_at, measure);
        // If the node was left out, the outer node stays the innermost open node and gets the children of the omitted
        // node.
        if node != NodeId::SKIPPED {
            self.innermost = node;
            self.level += 1;
        }
        TimerGuard { recorder: self, node, outer, outer_level, started_at }
    }

    /// Appends a child of the innermost open node, or counts it as skipped if the tree is full.
    #[inline]
    fn append_at(&mut self, name: Name, at: MonoTime, measure: Measure) -> NodeId {
        if self.tree.nodes.len() >= MAX_NODES - RESERVED_NODES || self.level >= MAX_DEPTH {
            // The node is counted and causes no error: a measurement must not fail because its tree is full.
            self.skipped_nodes += 1;
            return NodeId::SKIPPED;
        }
        let start = self.offset(at);
        self.tree.push(Node { parent: Some(self.innermost), name, host: self.host, start, measure })
    }

    /// Records the number of nodes that were left out.
    fn record_skipped(&mut self) {
        if self.skipped_nodes > 0 {
            let start = self.offset(self.clock.mono());
            let measure = Measure::Value(f64::from(self.skipped_nodes), Unit::NONE);
            let (parent, name) = (Some(NodeId::ROOT), stage::SKIPPED_NODES);
            self.tree.push(Node { parent, name, host: self.host, start, measure });
        }
    }
}

#[cfg(test)]
mod tests;
