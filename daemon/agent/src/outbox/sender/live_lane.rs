//! Live updates: when one is due, and whether the connection takes it.

use peernet_clock::WallTime;
use peernet_stream::{Accounting, Sending, ToAggregator, codec};

use crate::live::Receipt;
use crate::outbox::connection::Connection;
use crate::outbox::live_sources::LiveSources;

/// The live lane of one connection.
#[derive(Debug)]
pub(super) struct LiveLane {
    sources: LiveSources,
    /// A live update is due.
    is_due: bool,
    /// It waits for room on the connection, not for the way to be free.
    is_blocked: bool,
    /// Sessions that were over when the last update was sent. The aggregator stores the totals of their connections, which it knows from
    /// the updates before.
    told_ends: u64,
}

impl LiveLane {
    pub(super) const fn new(sources: LiveSources) -> Self {
        Self { sources, is_due: false, is_blocked: false, told_ends: 0 }
    }

    /// Time for an update.
    pub(super) const fn fall_due(&mut self) {
        self.is_due = true;
    }

    pub(super) const fn is_due(&self) -> bool {
        self.is_due
    }

    /// Whether an update waits for room on the connection.
    pub(super) const fn is_blocked(&self) -> bool {
        self.is_due && self.is_blocked
    }

    /// There is no connection: no update is due.
    pub(super) const fn reset(&mut self) {
        (self.is_due, self.is_blocked) = (false, false);
    }

    /// Number of connections to clouds that ended since the last update was sent: the last of their totals never reached the aggregator.
    pub(super) fn untold_ends(&self) -> u64 {
        self.sources.links.ended_sessions().saturating_sub(self.told_ends)
    }

    /// The aggregator may have been started anew and know no second of ours.
    pub(super) fn start_over(&self) {
        self.sources.live_statistics.start_over();
    }

    /// Sends a live update, before all that waits for the connection: it is worth nothing later. On a slow link it is
    /// made when it can go, not earlier.
    pub(super) fn show(
        &mut self,
        machine: &mut Sending,
        connection: &Connection,
        sent: WallTime,
        account: Accounting,
    ) {
        if !machine.is_up() {
            // The aggregator wants none.
            self.is_due = false;
            return;
        }
        self.is_blocked = false;
        if !machine.may_show() {
            return;
        }
        // Before the update is made: one that ends meanwhile is untold.
        let ends = self.sources.links.ended_sessions();
        let (frame, receipt) = self.update(machine, sent, account);
        let bytes = frame.len();
        self.is_blocked = connection.send(frame).is_err();
        if !self.is_blocked {
            (self.is_due, self.told_ends) = (false, ends);
            machine.shown(bytes);
            self.sources.live_statistics.delivered(&receipt);
        }
    }

    /// The frame that says how everything is now.
    pub(super) fn update(
        &self,
        machine: &Sending,
        sent: WallTime,
        account: Accounting,
    ) -> (Vec<u8>, Receipt) {
        let (update, receipt) = self.sources.update(machine.host(), sent, account);
        let message = ToAggregator::Live(update);
        let frame =
            if machine.compresses() { codec::encode_packed(&message) } else { codec::encode(&message) };
        (frame, receipt)
    }
}
