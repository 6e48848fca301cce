//! Decides when a live update is due, and sends it when the socket can take it.

use peernet_clock::WallTime;
use peernet_stream::{Accounting, LiveUpdate, Sending, ToAggregator, codec};

use crate::live::Receipt;
use crate::outbox::connection::Connection;
use crate::outbox::live_sources::LiveSources;

/// Live lane of the connection to the aggregator; stays in use when the connection is replaced.
#[derive(Debug)]
pub(super) struct LiveLane {
    sources: LiveSources,
    /// `true` if a live update is due.
    is_due: bool,
    /// `true` if the due update waits for the socket. A due update that does not wait for the socket waits for the flow
    /// control.
    is_blocked: bool,
    /// Number of sessions with clouds that had ended when the latest update was sent. The aggregator has the final
    /// totals of these sessions' connections.
    reported_ends: u64,
}

impl LiveLane {
    pub(super) const fn new(sources: LiveSources) -> Self {
        Self { sources, is_due: false, is_blocked: false, reported_ends: 0 }
    }

    /// Makes an update due.
    pub(super) const fn mark_due(&mut self) {
        self.is_due = true;
    }

    pub(super) const fn is_due(&self) -> bool {
        self.is_due
    }

    /// Returns whether an update waits until the socket can take it.
    pub(super) const fn is_blocked(&self) -> bool {
        self.is_due && self.is_blocked
    }

    /// Handles the loss of the connection: no update is due.
    pub(super) const fn reset(&mut self) {
        (self.is_due, self.is_blocked) = (false, false);
    }

    /// Returns the number of connections to clouds that ended since the last update was sent. The aggregator does not
    /// have their final totals.
    pub(super) fn unreported_ends(&self) -> u64 {
        self.sources.links.ended_sessions().saturating_sub(self.reported_ends)
    }

    /// Marks all one-second summaries as not sent, because the aggregator may have been restarted.
    pub(super) fn mark_all_unsent(&self) {
        self.sources.live_statistics.mark_all_unsent();
    }

    /// Sends a live update if the flow control allows it. The update is sent before all waiting frames, because a late
    /// update is useless. The update is composed only when the flow control allows it, so that it is current.
    pub(super) fn send_update(
        &mut self,
        state_machine: &mut Sending,
        connection: &Connection,
        sent: WallTime,
        accounting: Accounting,
    ) {
        if !state_machine.is_up() {
            // Without a session the aggregator accepts no update.
            self.is_due = false;
            return;
        }
        self.is_blocked = false;
        if !state_machine.may_send_live() {
            return;
        }
        // The number is read before the update is composed, so that a session that ends in between counts as
        // unreported.
        let ended_sessions = self.sources.links.ended_sessions();
        let (frame, receipt) = self.update(state_machine, sent, accounting);
        let bytes = frame.len();
        self.is_blocked = connection.send(frame).is_err();
        if !self.is_blocked {
            (self.is_due, self.reported_ends) = (false, ended_sessions);
            state_machine.record_live_sent(bytes);
            self.sources.live_statistics.mark_sent(&receipt);
        }
    }

    /// Returns the frame of an update of the current state.
    pub(super) fn update(
        &self,
        state_machine: &Sending,
        sent: WallTime,
        accounting: Accounting,
    ) -> (Vec<u8>, Receipt) {
        let (update, mut receipt) = self.sources.update(state_machine.host(), sent, accounting);
        let frame = encode(update, &mut receipt, state_machine.is_compressing());
        (frame, receipt)
    }
}

/// Encodes an update. An update that is longer than a message may be is shortened: it leaves out the older half of each
/// pipeline's seconds, repeatedly if necessary. Later updates contain these seconds.
// The aggregator closes a connection on which a longer message arrives. The next connection would begin with all
// seconds again.
fn encode(update: LiveUpdate, receipt: &mut Receipt, compress: bool) -> Vec<u8> {
    let mut message = ToAggregator::Live(update);
    let mut frame = codec::encode(&message);
    while frame.len() > codec::MAX_MESSAGE_BYTES
        && let ToAggregator::Live(update) = &mut message
        && leave_out_older_seconds(update, receipt)
    {
        frame = codec::encode(&message);
    }
    if compress { codec::encode_compressed(&message) } else { frame }
}

/// Removes the older half of each pipeline's seconds from an update and from its receipt. Returns `false` if the update
/// has no seconds.
fn leave_out_older_seconds(update: &mut LiveUpdate, receipt: &mut Receipt) -> bool {
    let max_seconds = update.pipelines.iter().map(|pipeline| pipeline.seconds.len()).max().unwrap_or(0);
    // The seconds are sorted, newest first.
    update.pipelines.iter_mut().for_each(|pipeline| pipeline.seconds.truncate(max_seconds / 2));
    receipt.truncate(max_seconds / 2);
    max_seconds > 0
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::Span;
    use peernet_logger::{Anchor, HostId, Measure, Name, NodeId, Tree, Unit, stage};
    use peernet_stream::{HostClock, HostMetrics, Outcome, Placement};

    use super::*;
    use crate::live::{LiveStatistics, PipelineLiveState};

    /// Returns live statistics of eight seconds that do not fit into one message.
    fn long_statistics() -> LiveStatistics {
        let anchor = Anchor { host: HostId::from_bytes([1; 16]), wall: WallTime::from_unix_nanos(0) };
        let mut tree = Tree::new(stage::ITERATION, anchor);
        for n in 0..60 {
            let name = Name::from(format!("{n:0>120}"));
            tree.add(NodeId::ROOT, name, Span::ZERO, Measure::Value(1.0, Unit::NONE));
        }
        let pipeline = |n: usize| {
            let name = format!("line-{n}").parse().expect("a name");
            let pipeline = PipelineLiveState::new(name, "closed".to_owned(), Placement::sensor_alone());
            let is_warm_up = false;
            (1..=8).for_each(|second| pipeline.record(second, &Outcome::Ok, is_warm_up, &tree));
            Arc::new(pipeline)
        };
        LiveStatistics::new((0..64).map(pipeline).collect())
    }

    fn update(statistics: &LiveStatistics) -> (LiveUpdate, Receipt) {
        let (pipelines, receipt) = statistics.snapshot();
        let update = LiveUpdate {
            host: HostId::from_bytes([1; 16]),
            sent: WallTime::from_unix_nanos(0),
            pipelines,
            links: Vec::new(),
            clock: HostClock::default(),
            metrics: HostMetrics::default(),
            accounting: Accounting::default(),
        };
        (update, receipt)
    }

    /// Returns the seconds of each pipeline in an update, without repetitions.
    fn seconds(update: &LiveUpdate) -> Vec<Vec<i64>> {
        let seconds = update.pipelines.iter();
        let mut seconds: Vec<Vec<i64>> =
            seconds.map(|pipeline| pipeline.seconds.iter().map(|second| second.at).collect()).collect();
        seconds.dedup();
        seconds
    }

    #[test]
    fn long_update_leaves_older_seconds_to_later_update() {
        let statistics = long_statistics();
        let (first, mut receipt) = update(&statistics);
        assert_eq!(seconds(&first), [[8, 7, 6, 5, 4, 3, 2, 1]]);
        let compress = false;
        let frame = encode(first, &mut receipt, compress);
        let Ok(ToAggregator::Live(sent)) = codec::decode(&frame) else { panic!("an update was expected") };
        assert_eq!(seconds(&sent), [[8, 7, 6, 5]]);
        statistics.mark_sent(&receipt);
        let (second, _) = update(&statistics);
        assert_eq!(seconds(&second), [[4, 3, 2, 1]]);
    }
}
