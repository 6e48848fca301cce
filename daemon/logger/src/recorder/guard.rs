//! Guards of open nodes: timers, meters, token counters.

use std::ops::{Deref, DerefMut};

use peernet_clock::{MonoTime, Span};

use crate::{Measure, Meter, NodeId, Recorder, Unit, stage};

/// Guard of an open node. Nodes recorded through it become its children; dropping it closes the node.
#[derive(Debug)]
pub struct Timing<'a> {
    pub(crate) recorder: &'a mut Recorder,
    pub(crate) node: NodeId,
    pub(crate) outer: NodeId,
    pub(crate) outer_level: usize,
    pub(crate) started: MonoTime,
}

impl Timing<'_> {
    /// Returns the open node.
    pub const fn id(&self) -> NodeId {
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
        let recorder = &mut *self.recorder;
        // Guards are dropped innermost first, so the outer node is open again.
        (recorder.open, recorder.level) = (self.outer, self.outer_level);
        if let Some(node) = recorder.tree.nodes.get_mut(self.node.index())
            && let Measure::Timer(duration) = &mut node.measure
        {
            *duration = Some(recorder.clock.mono() - self.started);
        }
    }
}

/// Guard of an open node that a user's instrument measures, created by [`Recorder::measure`].
#[derive(Debug)]
pub struct Measuring<'a, M: Meter> {
    open: Timing<'a>,
    meter: M,
}

impl<'a, M: Meter> Measuring<'a, M> {
    pub(crate) fn begin(open: Timing<'a>, mut meter: M) -> Self {
        meter.begin();
        Self { open, meter }
    }

    /// Returns the open node.
    pub const fn id(&self) -> NodeId {
        self.open.node
    }

    /// Returns the instrument.
    pub const fn meter(&mut self) -> &mut M {
        &mut self.meter
    }
}

impl<M: Meter> Deref for Measuring<'_, M> {
    type Target = Recorder;
    fn deref(&self) -> &Recorder {
        self.open.recorder
    }
}

impl<M: Meter> DerefMut for Measuring<'_, M> {
    fn deref_mut(&mut self) -> &mut Recorder {
        self.open.recorder
    }
}

impl<M: Meter> Drop for Measuring<'_, M> {
    fn drop(&mut self) {
        let reading = self.meter.end();
        let node = self.open.node;
        if let Some(Measure::Custom(_, _, value)) = self.open.recorder.tree.measure_mut(node) {
            *value = Some(reading).filter(|reading| !reading.is_nan());
        }
    }
}

/// Guard of an open token rate, created by [`Recorder::tokens`]. When it is dropped it adds `tokens` and
/// `time-to-first-token` as children.
///
/// The rate is the number of tokens divided by the time from opening to the last token. That time includes the wait for
/// the first token, as a user of the answer experiences it.
#[derive(Debug)]
pub struct Tokens<'a> {
    open: Timing<'a>,
    started: MonoTime,
    count: u64,
    first: Option<MonoTime>,
    last: MonoTime,
}

impl<'a> Tokens<'a> {
    pub(crate) const fn begin(open: Timing<'a>, started: MonoTime) -> Self {
        Self { open, started, count: 0, first: None, last: started }
    }

    /// Returns the open node.
    pub const fn id(&self) -> NodeId {
        self.open.node
    }

    /// Counts one token.
    pub fn token(&mut self) {
        self.several(1);
    }

    /// Counts several tokens that arrived at once.
    pub fn several(&mut self, tokens: u64) {
        if tokens > 0 {
            self.last = self.open.clock().mono();
            self.first.get_or_insert(self.last);
            self.count += tokens;
        }
    }
}

impl Deref for Tokens<'_> {
    type Target = Recorder;
    fn deref(&self) -> &Recorder {
        self.open.recorder
    }
}

impl DerefMut for Tokens<'_> {
    fn deref_mut(&mut self) -> &mut Recorder {
        self.open.recorder
    }
}

impl Drop for Tokens<'_> {
    fn drop(&mut self) {
        let took = self.last - self.started;
        let node = self.open.node;
        if let Some(Measure::TokenRate(rate)) = self.open.recorder.tree.measure_mut(node) {
            *rate = (took > Span::ZERO).then(|| self.count as f64 / took.seconds());
        }
        self.open.recorder.value(stage::TOKENS, self.count as f64, Unit::TOKENS);
        if let Some(first) = self.first {
            self.open.recorder.timed(stage::TIME_TO_FIRST_TOKEN, self.started, first);
        }
    }
}
