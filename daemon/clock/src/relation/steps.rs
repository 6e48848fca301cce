//! Tracking of the steps that both hosts report, and exclusion of the exchanges that were in flight during one.

use crate::{Exchange, ExchangeObservation, RawTime, Span};

/// Number of equal lower values in a row after which a peer's epoch is taken for that of a new process. Fewer are late
/// answers that were overtaken.
const NEW_COUNTER: u32 = 8;
/// Longest time by which an exchange may have begun before the one that reported a step of the edge. It is short,
/// because the stamps themselves may have been set back; longer exchanges show the step against the monotonic clock.
const EDGE_REACH: Span = Span::from_seconds(2);
/// Longest time by which an exchange may have begun before the one that reported a step of the cloud.
const CLOUD_REACH: Span = Span::from_seconds(60);

/// The epochs of both hosts, and the exclusion of exchanges that the last step requires.
#[derive(Clone, Debug, Default)]
pub(super) struct StepTracker {
    edge: Option<u32>,
    cloud: Option<u32>,
    /// A lower epoch of the cloud than the known one, and how often it came in a row.
    older: Option<(u32, u32)>,
    barrier: Barrier,
}

/// Rule that excludes exchanges which were in flight during a step.
///
/// The edge compares its epoch before and after an exchange. The cloud's epoch is read after its stamps, so that a
/// stamp may belong to an earlier epoch, never to a later one.
#[derive(Clone, Copy, Debug, Default)]
enum Barrier {
    /// Excludes nothing.
    #[default]
    Open,
    /// Excludes the next exchange, whose return gives the time of the step. The span is the reach of
    /// [`Barrier::Before`].
    Next(Span),
    /// Excludes exchanges sent before a time, by no more than the reach.
    Before(RawTime, Span),
}

/// Steps that the epochs of an exchange report.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepReport {
    pub(super) of_edge: bool,
    pub(super) of_cloud: bool,
    /// `true` if the exchange itself took place after the last step that was known before.
    pub(super) is_current: bool,
}

impl StepTracker {
    /// Updates the edge's epoch. Returns whether it is higher than the known one.
    pub(super) fn edge_stepped(&mut self, epoch: u32) -> bool {
        let is_new = self.edge.is_none_or(|known| known < epoch);
        if is_new {
            (self.edge, self.barrier) = (Some(epoch), Barrier::Next(EDGE_REACH));
        }
        is_new
    }

    /// Updates the cloud's epoch. Returns whether it is higher than the known one.
    pub(super) fn cloud_stepped(&mut self, epoch: u32) -> bool {
        let is_new = self.cloud.is_none_or(|known| known < epoch);
        if is_new {
            (self.cloud, self.barrier) = (Some(epoch), Barrier::Next(CLOUD_REACH));
        }
        is_new
    }

    /// Compares the epochs of an exchange with the known ones, and updates these.
    pub(super) fn compare(&mut self, observation: &ExchangeObservation) -> StepReport {
        let returned = observation.exchange.returned;
        let edge = *self.edge.get_or_insert(observation.edge_epoch);
        let of_edge = observation.edge_epoch > edge;
        if of_edge {
            self.edge = Some(observation.edge_epoch);
            self.barrier = Barrier::Before(returned, EDGE_REACH);
        }
        let cloud = observation.cloud_epoch.map(|told| (told, *self.cloud.get_or_insert(told)));
        // Answers can overtake each other, so that a lower epoch is usually a late one.
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

    /// Returns whether a lower epoch came often enough in a row to be that of a new process.
    fn is_new_counter(&mut self, told: u32) -> bool {
        let times = match self.older {
            Some((older, times)) if older == told => times + 1,
            _ => 1,
        };
        self.older = Some((told, times));
        times >= NEW_COUNTER
    }

    /// Returns whether an exchange may have begun before the last step. The first exchange after a report gives the
    /// time of the step.
    pub(super) fn excludes(&mut self, exchange: &Exchange) -> bool {
        match self.barrier {
            Barrier::Open => false,
            Barrier::Next(reach) => {
                // The step was before this return; exchanges sent before it may have begun before the step.
                self.barrier = Barrier::Before(exchange.returned, reach);
                true
            }
            Barrier::Before(time, reach) => exchange.sent < time && time - exchange.sent <= reach,
        }
    }

    /// Ends the exclusion. Used when the exchanges themselves show the step, so that those which follow began after it.
    pub(super) fn admit_all(&mut self) {
        self.barrier = Barrier::Open;
    }
}
