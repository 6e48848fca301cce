//! Decides when a live update is due, and sends it when the socket can take it.

use peernet_clock::WallTime;
use peernet_stream::{Accounting, Sending, ToAggregator, codec};

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
        let (update, receipt) = self.sources.update(state_machine.host(), sent, accounting);
        let message = ToAggregator::Live(update);
        let frame = if state_machine.is_compressing() {
            codec::encode_compressed(&message)
        } else {
            codec::encode(&message)
        };
        (frame, receipt)
    }
}
