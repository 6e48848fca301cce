//! Guards of open nodes: timers and meters.

use std::ops::{Deref, DerefMut};

use peernet_clock::MonoTime;

use crate::{Measure, Meter, NodeId, Recorder};

/// Guard of an open node. Nodes that are recorded through the guard become children of the node. The node closes when
/// the guard is dropped.
#[derive(Debug)]
pub struct TimerGuard<'a> {
    pub(crate) recorder: &'a mut Recorder,
    pub(crate) node: NodeId,
    /// Innermost open node before this node was opened.
    pub(crate) outer: NodeId,
    pub(crate) outer_level: usize,
    pub(crate) started_at: MonoTime,
}

impl TimerGuard<'_> {
    /// Returns the open node.
    pub const fn id(&self) -> NodeId {
        self.node
    }
}

impl Deref for TimerGuard<'_> {
    type Target = Recorder;
    fn deref(&self) -> &Recorder {
        self.recorder
    }
}

impl DerefMut for TimerGuard<'_> {
    fn deref_mut(&mut self) -> &mut Recorder {
        self.recorder
    }
}

impl Drop for TimerGuard<'_> {
    #[inline]
    fn drop(&mut self) {
        let recorder = &mut *self.recorder;
        // Guards are dropped innermost first, so the outer node becomes the innermost open node.
        (recorder.innermost, recorder.level) = (self.outer, self.outer_level);
        if let Some(node) = recorder.tree.nodes.get_mut(self.node.index())
            && let Measure::Timer(duration) = &mut node.measure
        {
            *duration = Some(recorder.clock.mono() - self.started_at);
        }
    }
}

/// Guard of an open node with a user's instrument, created by [`Recorder::measure`].
#[derive(Debug)]
pub struct MeterGuard<'a, M: Meter> {
    guard: TimerGuard<'a>,
    meter: M,
}

impl<'a, M: Meter> MeterGuard<'a, M> {
    pub(crate) fn new(guard: TimerGuard<'a>, mut meter: M) -> Self {
        meter.begin();
        Self { guard, meter }
    }

    /// Returns the open node.
    pub const fn id(&self) -> NodeId {
        self.guard.node
    }

    /// Returns the instrument.
    pub const fn meter(&mut self) -> &mut M {
        &mut self.meter
    }
}

impl<M: Meter> Deref for MeterGuard<'_, M> {
    type Target = Recorder;
    fn deref(&self) -> &Recorder {
        self.guard.recorder
    }
}

impl<M: Meter> DerefMut for MeterGuard<'_, M> {
    fn deref_mut(&mut self) -> &mut Recorder {
        self.guard.recorder
    }
}

impl<M: Meter> Drop for MeterGuard<'_, M> {
    fn drop(&mut self) {
        let reading = self.meter.end();
        let node = self.guard.node;
        if let Some(Measure::Custom(_, _, value)) = self.guard.recorder.tree.measure_mut(node) {
            *value = Some(reading).filter(|reading| !reading.is_nan());
        }
    }
}
