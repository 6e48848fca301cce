//! Steps of the two clocks that the hosts report, and the exchanges that were under way during one.

use crate::{Exchange, ExchangeObservation, RawTime, Span};

/// A peer's counter of steps that went back is a new process, if so many in a row say so. Before, it is an answer that
/// was overtaken.
const NEW_COUNTER: u32 = 8;
/// An exchange that ends so long after the one that told of a step may still have begun before it. For the edge it
/// is short: its stamps themselves may have been set back. Longer ones show against the monotonic clock.
const EDGE_REACH: Span = Span::from_seconds(2);
const CLOUD_REACH: Span = Span::from_seconds(60);

/// The counters of steps of both hosts, and which exchanges the last step keeps out.
#[derive(Clone, Debug, Default)]
pub(super) struct StepTracker {
    edge: Option<u32>,
    cloud: Option<u32>,
    /// An older one of the cloud, and how often in a row.
    older: Option<(u32, u32)>,
    barrier: Barrier,
}

/// What keeps out exchanges that were under way during a step. Who makes exchanges compares the edge's counter before and
/// after them; the cloud's is read after its stamps, so that a stamp may be older than it says, never younger.
#[derive(Clone, Copy, Debug, Default)]
enum Barrier {
    /// Nothing.
    #[default]
    Open,
    /// The next exchange is kept out and tells the time.
    Next(Span),
    /// Those sent before, but not by more than the reach.
    Before(RawTime, Span),
}

/// What the counters of an exchange say about steps.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepReport {
    pub(super) of_edge: bool,
    pub(super) of_cloud: bool,
    /// Whether the exchange itself is of the time after the last step that was known before.
    pub(super) is_current: bool,
}

impl StepTracker {
    /// Takes the edge's counter of steps. Returns whether it is higher than known.
    pub(super) fn edge_stepped(&mut self, epoch: u32) -> bool {
        let is_new = self.edge.is_none_or(|known| known < epoch);
        if is_new {
            (self.edge, self.barrier) = (Some(epoch), Barrier::Next(EDGE_REACH));
        }
        is_new
    }

    /// Takes the cloud's counter of steps. Returns whether it is higher than known.
    pub(super) fn cloud_stepped(&mut self, epoch: u32) -> bool {
        let is_new = self.cloud.is_none_or(|known| known < epoch);
        if is_new {
            (self.cloud, self.barrier) = (Some(epoch), Barrier::Next(CLOUD_REACH));
        }
        is_new
    }

    /// Compares the counters of an exchange with those known.
    pub(super) fn compare(&mut self, observation: &ExchangeObservation) -> StepReport {
        let returned = observation.exchange.returned;
        let edge = *self.edge.get_or_insert(observation.edge_epoch);
        let of_edge = observation.edge_epoch > edge;
        if of_edge {
            self.edge = Some(observation.edge_epoch);
            self.barrier = Barrier::Before(returned, EDGE_REACH);
        }
        let cloud = observation.cloud_epoch.map(|told| (told, *self.cloud.get_or_insert(told)));
        let is_overtaken = cloud.is_some_and(|(told, known)| told < known && !self.is_new_counter(told));
        let mut of_cloud = false;
        if let Some((told, known)) = cloud.filter(|_| !is_overtaken) {
            self.older = None;
            of_cloud = told != known;
            if of_cloud {
                self.cloud = Some(told);
                self.barrier = Barrier::Before(returned, CLOUD_REACH);
            }
        }
        let is_current = observation.edge_epoch == edge && cloud.is_none_or(|(told, known)| told == known);
        StepReport { of_edge, of_cloud, is_current }
    }

    /// Whether so many in a row tell of the same older counter that it is a new one.
    fn is_new_counter(&mut self, told: u32) -> bool {
        let times = match self.older {
            Some((older, times)) if older == told => times + 1,
            _ => 1,
        };
        self.older = Some((told, times));
        times >= NEW_COUNTER
    }

    /// Returns whether an exchange may have begun before the last step. The first one after a report tells when that was.
    pub(super) fn excludes(&mut self, exchange: &Exchange) -> bool {
        match self.barrier {
            Barrier::Open => false,
            Barrier::Next(reach) => {
                self.barrier = Barrier::Before(exchange.returned, reach);
                true
            }
            Barrier::Before(time, reach) => exchange.sent < time && time - exchange.sent <= reach,
        }
    }

    /// Excludes nothing any more: the step showed in the exchanges themselves, and those that follow began after it.
    pub(super) fn admit_all(&mut self) {
        self.barrier = Barrier::Open;
    }
}
