//! Guards of open nodes: timers, meters, token counters.

use std::ops::{Deref, DerefMut};

use peernet_clock::{MonoTime, Span};

use crate::{Measure, Meter, NodeId, Recorder, Unit, stage};

/// Guard of an open node: a timer, a container, or the node of a [`MeterGuard`] or [`TokenGuard`]. Nodes that are
/// recorded through the guard become children of the node. The node closes when the guard is dropped.
#[derive(Debug)]
pub struct TimerGuard<'a> {
    pub(crate) recorder: &'a mut Recorder,
    pub(crate) node: NodeId,
    /// Innermost open node before this node was opened.
    pub(crate) outer: NodeId,
    /// Level of `outer`.
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

/// Guard of an open node with a custom instrument, created by [`Recorder::measure`].
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

/// Guard of an open token rate, created by [`Recorder::tokens`]. The drop of the guard adds the children `tokens` and
/// `time-to-first-token` to the node.
///
/// The rate is the number of tokens divided by the time from the opening of the node to the last token. This time
/// includes the wait for the first token.
#[derive(Debug)]
pub struct TokenGuard<'a> {
    guard: TimerGuard<'a>,
    started_at: MonoTime,
    token_count: u64,
    first_token: Option<MonoTime>,
    last_token: MonoTime,
}

impl<'a> TokenGuard<'a> {
    pub(crate) const fn new(guard: TimerGuard<'a>, started_at: MonoTime) -> Self {
        Self { guard, started_at, token_count: 0, first_token: None, last_token: started_at }
    }

    /// Returns the open node.
    pub const fn id(&self) -> NodeId {
        self.guard.node
    }

    /// Counts tokens that arrived now, all at the same time.
    pub fn add_tokens(&mut self, tokens: u64) {
        if tokens > 0 {
            self.last_token = self.guard.clock().mono();
            self.first_token.get_or_insert(self.last_token);
            self.token_count += tokens;
        }
    }
}

impl Deref for TokenGuard<'_> {
    type Target = Recorder;
    fn deref(&self) -> &Recorder {
        self.guard.recorder
    }
}

impl DerefMut for TokenGuard<'_> {
    fn deref_mut(&mut self) -> &mut Recorder {
        self.guard.recorder
    }
}

impl Drop for TokenGuard<'_> {
    fn drop(&mut self) {
        let elapsed = self.last_token - self.started_at;
        let node = self.guard.node;
        if let Some(Measure::TokenRate(rate)) = self.guard.recorder.tree.measure_mut(node) {
            *rate = (elapsed > Span::ZERO).then(|| self.token_count as f64 / elapsed.seconds());
        }
        // The field `guard` is dropped after this function. Its node is therefore still open and becomes the parent of
        // these nodes.
        self.guard.recorder.record_value(stage::TOKENS, self.token_count as f64, Unit::TOKENS);
        if let Some(first_token) = self.first_token {
            self.guard.recorder.record_timer(stage::TIME_TO_FIRST_TOKEN, self.started_at, first_token);
        }
    }
}
