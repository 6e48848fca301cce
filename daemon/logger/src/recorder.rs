//! Growing a tree while an iteration runs.

use std::ops::{Deref, DerefMut};

use peernet_clock::{MonoTime, SharedClock, Span, Stamp, WallTime};

use crate::tree::{Anchor, Growth, HostIndex, Measure, Node, NodeId, Transit, Tree, TreeError};
use crate::{HostId, Name, Unit};

/// A tree under construction on one host: opens and closes nodes below the innermost open one.
///
/// ```
/// # use std::sync::Arc;
/// # use peernet_clock::{ClockIdentity, ManualClock, Span, WallTime};
/// # use peernet_logger::{HostId, Recorder, stage};
/// let clock = Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("b", "c")));
/// let mut log = Recorder::begin(clock.clone(), HostId::random());
/// {
///     let mut sensing = log.time(stage::SENSING);
///     let _capture = sensing.time(stage::CAPTURE);
///     clock.advance(Span::from_millis(2));
/// }
/// let tree = log.finish();
/// assert_eq!(tree.find(&["sensing", "capture"]).unwrap().1.measure.value(), Some(0.002));
/// ```
#[derive(Debug)]
pub struct Recorder {
    clock: SharedClock,
    tree: Tree,
    host: HostIndex,
    /// This host's anchor on its monotonic clock.
    zero: MonoTime,
    /// The innermost open node.
    open: NodeId,
    /// For a tree that came from another host: what it looked like on arrival.
    received: Option<Received>,
}

#[derive(Clone, Copy, Debug)]
struct Received {
    base: u32,
    closed: (NodeId, WallTime),
}

impl Recorder {
    /// Begins an iteration now.
    pub fn begin(clock: SharedClock, host: HostId) -> Self {
        let now = clock.stamp();
        Self::begin_at(clock, host, now)
    }

    /// Begins an iteration that was meant to begin at `at`, now or earlier.
    pub fn begin_at(clock: SharedClock, host: HostId, at: Stamp) -> Self {
        let tree = Tree::new(crate::stage::ITERATION, Anchor { host, wall: at.wall });
        Self { clock, tree, host: HostIndex::EDGE, zero: at.mono, open: NodeId::ROOT, received: None }
    }

    /// Continues a tree that arrived from another host: closes `transit`, on which it came, at `arrival`.
    ///
    /// # Errors
    /// When `transit` is not a transit under way.
    pub fn resume(
        clock: SharedClock,
        host: HostId,
        mut tree: Tree,
        transit: NodeId,
        arrival: Stamp,
    ) -> Result<Self, TreeError> {
        let base = tree.nodes().len() as u32;
        match tree.measure_mut(transit) {
            Some(Measure::Transit(open)) if open.received.is_none() => open.received = Some(arrival.wall),
            _ => return Err(TreeError::NotUnderWay(transit.index())),
        }
        tree.anchors.push(Anchor { host, wall: arrival.wall });
        let host = HostIndex((tree.anchors.len() - 1) as u8);
        let received = Some(Received { base, closed: (transit, arrival.wall) });
        Ok(Self { clock, tree, host, zero: arrival.mono, open: NodeId::ROOT, received })
    }

    /// The clock this recorder reads.
    pub fn clock(&self) -> &SharedClock {
        &self.clock
    }

    /// The tree so far.
    pub fn tree(&self) -> &Tree {
        &self.tree
    }

    /// The tree so far, for nodes that are computed rather than timed.
    pub fn tree_mut(&mut self) -> &mut Tree {
        &mut self.tree
    }

    /// A moment of this host's monotonic clock as an offset from the anchor.
    pub fn offset(&self, at: MonoTime) -> Span {
        at - self.zero
    }

    /// Opens a timer that closes when the guard goes; nodes opened through the guard are its children.
    #[inline]
    pub fn time(&mut self, name: Name) -> Timing<'_> {
        let outer = self.open;
        let started = self.clock.mono();
        let node = self.append_at(name, started, Measure::Timer(None));
        self.open = node;
        Timing { recorder: self, node, outer, started }
    }

    /// Opens a timer to be closed with [`stop`](Self::stop), where a guard cannot live long enough.
    pub fn start(&mut self, name: Name) -> NodeId {
        let now = self.clock.mono();
        self.append_at(name, now, Measure::Timer(None))
    }

    /// Opens a timer at a moment that has passed.
    pub fn start_at(&mut self, name: Name, at: MonoTime) -> NodeId {
        self.append_at(name, at, Measure::Timer(None))
    }

    /// Closes a timer now. Closing twice keeps the first end.
    pub fn stop(&mut self, timer: NodeId) {
        let now = self.clock.mono();
        self.stop_at(timer, now);
    }

    /// Closes a timer at a moment that has passed. Closing twice keeps the first end.
    pub fn stop_at(&mut self, timer: NodeId, at: MonoTime) {
        let end = self.offset(at);
        if let Some(node) = self.tree.nodes.get_mut(timer.index())
            && let Measure::Timer(duration @ None) = &mut node.measure
        {
            *duration = Some(end - node.start);
        }
    }

    /// Records a finished timer between two moments.
    pub fn timed(&mut self, name: Name, from: MonoTime, to: MonoTime) -> NodeId {
        self.append_at(name, from, Measure::Timer(Some(to - from)))
    }

    /// Opens a container through the guard of which children are added.
    pub fn container(&mut self, name: Name) -> Timing<'_> {
        let outer = self.open;
        let started = self.clock.mono();
        let node = self.append_at(name, started, Measure::Container);
        self.open = node;
        Timing { recorder: self, node, outer, started }
    }

    /// Records a number.
    pub fn value(&mut self, name: Name, value: f64, unit: Unit) -> NodeId {
        let now = self.clock.mono();
        self.append_at(name, now, Measure::Value(value, unit))
    }

    /// Records a measurement of a kind the user declared.
    pub fn custom(&mut self, name: Name, kind: Name, unit: Unit, value: f64) -> NodeId {
        let now = self.clock.mono();
        self.append_at(name, now, Measure::Custom(kind, unit, Some(value)))
    }

    /// Opens the node of a message that is handed to the network at `sent`; the receiver closes it.
    pub fn depart(&mut self, name: Name, sent: Stamp) -> NodeId {
        let transit = Transit { sent: sent.wall, received: None, delay: None };
        self.append_at(name, sent.mono, Measure::Transit(Box::new(transit)))
    }

    /// Sets the end of a message that arrived here.
    pub fn arrive(&mut self, transit: NodeId, at: WallTime) {
        if let Some(Measure::Transit(open)) = self.tree.measure_mut(transit) {
            open.received.get_or_insert(at);
        }
    }

    /// Ends the recording; nodes that are still open stay so.
    pub fn finish(self) -> Tree {
        self.tree
    }

    /// Ends the recording of a [resumed](Self::resume) tree: what this host added, to be sent back.
    /// `None` for a tree that began here.
    pub fn into_growth(mut self) -> Option<Growth> {
        let Received { base, closed } = self.received?;
        let nodes = self.tree.nodes.split_off(base as usize);
        let anchor = self.tree.anchors.pop()?;
        Some(Growth { base, anchor, closed, nodes })
    }

    fn append_at(&mut self, name: Name, at: MonoTime, measure: Measure) -> NodeId {
        let node =
            Node { parent: Some(self.open), name, host: self.host, start: self.offset(at), measure };
        self.tree.push(node)
    }
}

/// An open node: everything recorded through it becomes its child, and dropping it closes it.
#[derive(Debug)]
pub struct Timing<'a> {
    recorder: &'a mut Recorder,
    node: NodeId,
    outer: NodeId,
    started: MonoTime,
}

impl Timing<'_> {
    /// The open node.
    pub fn id(&self) -> NodeId {
        self.node
    }
}

impl Deref for Timing<'_> {
    type Target = Recorder;
    fn deref(&self) -> &Recorder {
        self.recorder
    }
}

impl DerefMut for Timing<'_> {
    fn deref_mut(&mut self) -> &mut Recorder {
        self.recorder
    }
}

impl Drop for Timing<'_> {
    #[inline]
    fn drop(&mut self) {
        self.recorder.open = self.outer;
        if let Some(node) = self.recorder.tree.nodes.get_mut(self.node.index())
            && let Measure::Timer(duration) = &mut node.measure
        {
            *duration = Some(self.recorder.clock.mono() - self.started);
        }
    }
}
