//! Tracking of the steps that the two hosts report, and exclusion of the exchanges that were in flight during a step.

use crate::{Exchange, ExchangeObservation, RawTime, Span};

/// If this many answers in a row have the same epoch, and this epoch is lower than the current epoch, the peer counts
/// as restarted.
// If there are fewer such answers, they are late answers, which a later answer overtook.
const LOWER_EPOCHS_FOR_RESTART: u32 = 8;
/// An exchange is excluded only if it was sent at most this long before the return of the exchange that reported a step
/// of the edge.
// The time is short: if the step set the edge's clock back, exchanges after the step have stamps before that return,
// too. An exchange that took longer needs no exclusion: in its stamps the step is visible as a difference between the
// wall clock and the monotonic clock.
const MAX_EDGE_REACH: Span = Span::from_seconds(2);
/// An exchange is excluded only if it was sent at most this long before the return of the exchange that reported a step
/// of the cloud, or before the first exchange that shows a step that no host reported.
// The time is long, because a step of the cloud does not change the edge's stamps, by which the reach is measured.
const MAX_CLOUD_REACH: Span = Span::from_seconds(60);

/// The epochs of both hosts, and the exclusion of exchanges that the last step requires.
#[derive(Clone, Debug, Default)]
pub(super) struct StepTracker {
    edge: Option<u32>,
    cloud: Option<u32>,
    /// An epoch of the cloud that is lower than the current epoch, and the number of answers in a row that carried it.
    lower_epoch: Option<(u32, u32)>,
    exclusion_rule: ExclusionRule,
}

/// Rule that excludes the exchanges that were in flight during a step.
// The edge compares its epoch before and after an exchange. The cloud's epoch is read after the cloud's stamps, so a
// stamp may belong to an earlier epoch, but never to a later epoch.
#[derive(Clone, Copy, Debug, Default)]
enum ExclusionRule {
    /// Excludes no exchange.
    #[default]
    NoExchange,
    /// Excludes the next exchange, whose return gives the time of the step. The span is the reach of
    /// [`ExclusionRule::SentBefore`].
    NextExchange(Span),
    /// Excludes the exchanges that were sent before a time, but not the exchanges that were sent earlier than the reach
    /// before this time.
    SentBefore(RawTime, Span),
}

/// Steps that the epochs of an exchange report.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepReport {
    pub(super) has_edge_step: bool,
    pub(super) has_cloud_step: bool,
    /// `true` if the epochs of the exchange equal the previous epochs, so that the exchange reports no step.
    pub(super) is_current: bool,
}

impl StepTracker {
    /// Updates the edge's epoch. Returns whether the epoch is higher than the previous epoch, or is the first one.
    pub(super) fn update_edge_epoch(&mut self, epoch: u32) -> bool {
        let is_new = self.edge.is_none_or(|previous| previous < epoch);
        if is_new {
            (self.edge, self.exclusion_rule) = (Some(epoch), ExclusionRule::NextExchange(MAX_EDGE_REACH));
        }
        is_new
    }

    /// Updates the cloud's epoch. Returns whether the epoch is higher than the previous epoch, or is the first one.
    pub(super) fn update_cloud_epoch(&mut self, epoch: u32) -> bool {
        let is_new = self.cloud.is_none_or(|previous| previous < epoch);
        if is_new {
            (self.cloud, self.exclusion_rule) = (Some(epoch), ExclusionRule::NextExchange(MAX_CLOUD_REACH));
        }
        is_new
    }

    /// Compares the epochs of an exchange with the previous epochs, and replaces the previous epochs.
    pub(super) fn compare(&mut self, observation: &ExchangeObservation) -> StepReport {
        let returned = observation.exchange.returned;
        let edge = *self.edge.get_or_insert(observation.edge_epoch);
        let has_edge_step = observation.edge_epoch > edge;
        if has_edge_step {
            self.edge = Some(observation.edge_epoch);
            self.exclusion_rule = ExclusionRule::SentBefore(returned, MAX_EDGE_REACH);
        }
        let cloud = observation.cloud_epoch.map(|reported| (reported, *self.cloud.get_or_insert(reported)));
        // Answers can overtake each other, so a lower epoch usually comes with a late answer.
        let is_overtaken = cloud
            .is_some_and(|(reported, previous)| reported < previous && !self.count_lower_epoch(reported));
        let mut has_cloud_step = false;
        if let Some((reported, previous)) = cloud.filter(|_| !is_overtaken) {
            self.lower_epoch = None;
            has_cloud_step = reported != previous;
            if has_cloud_step {
                self.cloud = Some(reported);
                self.exclusion_rule = ExclusionRule::SentBefore(returned, MAX_CLOUD_REACH);
            }
        }
        let is_current =
            observation.edge_epoch == edge && cloud.is_none_or(|(reported, previous)| reported == previous);
        StepReport { has_edge_step, has_cloud_step, is_current }
    }

    /// Counts an answer with a lower epoch. Returns whether enough answers in a row carried this epoch, so that the
    /// cloud counts as restarted.
    fn count_lower_epoch(&mut self, reported: u32) -> bool {
        let count = match self.lower_epoch {
            Some((lower_epoch, count)) if lower_epoch == reported => count + 1,
            _ => 1,
        };
        self.lower_epoch = Some((reported, count));
        count >= LOWER_EPOCHS_FOR_RESTART
    }

    /// Returns whether an exchange may have started before the last step. The first exchange after a report sets the
    /// time of the step.
    pub(super) fn excludes(&mut self, exchange: &Exchange) -> bool {
        match self.exclusion_rule {
            ExclusionRule::NoExchange => false,
            ExclusionRule::NextExchange(reach) => {
                // The step happened before this exchange returned. Exchanges that were sent before this return may have
                // been sent before the step.
                self.exclusion_rule = ExclusionRule::SentBefore(exchange.returned, reach);
                true
            }
            ExclusionRule::SentBefore(time, reach) => exchange.sent < time && time - exchange.sent <= reach,
        }
    }

    /// Replaces the exclusion: excludes the exchanges that were sent before `time`. Called when the exchanges themselves
    /// show a step; the first of them was sent at `time`.
    pub(super) fn exclude_sent_before(&mut self, time: RawTime) {
        self.exclusion_rule = ExclusionRule::SentBefore(time, MAX_CLOUD_REACH);
    }
}
