//! The outputs of the session: replies to connections, events for the live state, and counts of rejected messages.

use peernet_logger::HostId;
use peernet_networks::ConnectionId;
use peernet_stream::ToAgent;

use crate::live::LiveEvent;

/// Numbers of rejected messages since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct RejectedCounts {
    /// Batches and hellos that did not fit into the queue. Batches are requested again; agents repeat hellos.
    pub(crate) deferred: u64,
    /// Batches that do not match their hash; they are requested again.
    pub(crate) damaged: u64,
    /// Frames that cannot be decoded.
    pub(crate) unreadable: u64,
    /// Messages of hosts without a session on their connection.
    pub(crate) strangers: u64,
}

/// Replies and events that were not collected yet, and the counts since the start.
#[derive(Debug, Default)]
pub(super) struct SessionOutput {
    replies: Vec<(ConnectionId, ToAgent)>,
    live_events: Vec<LiveEvent>,
    rejected: RejectedCounts,
}

impl SessionOutput {
    /// Adds a message to be sent.
    pub(super) fn reply(&mut self, to: ConnectionId, message: ToAgent) {
        self.replies.push((to, message));
    }

    /// Adds an event for the live state.
    pub(super) fn announce(&mut self, event: LiveEvent) {
        self.live_events.push(event);
    }

    /// Counts a hello for whose work the queue had no capacity.
    pub(super) const fn count_deferred_hello(&mut self) {
        self.rejected.deferred += 1;
    }

    /// Counts a batch that did not fit into the queue.
    pub(super) fn count_deferred_batch(&mut self, host: HostId) {
        self.rejected.deferred += 1;
        self.announce(LiveEvent::Deferred(host));
    }

    /// Counts a batch that does not match its hash.
    pub(super) fn count_damaged_batch(&mut self, host: HostId) {
        self.rejected.damaged += 1;
        self.announce(LiveEvent::Damaged(host));
    }

    /// Counts a frame that cannot be decoded.
    pub(super) fn count_unreadable_frame(&mut self) {
        self.rejected.unreadable += 1;
        self.announce(LiveEvent::Unreadable);
    }

    /// Counts a message of a host without a session on the connection, and asks its agent for a hello.
    pub(super) fn reject_stranger(&mut self, connection: ConnectionId) {
        self.rejected.strangers += 1;
        self.announce(LiveEvent::Stranger);
        self.reply(connection, ToAgent::Unknown);
    }

    /// Returns and clears the messages to be sent.
    pub(super) fn take_replies(&mut self) -> Vec<(ConnectionId, ToAgent)> {
        std::mem::take(&mut self.replies)
    }

    /// Returns and clears the events for the live state.
    pub(super) fn take_live_events(&mut self) -> Vec<LiveEvent> {
        std::mem::take(&mut self.live_events)
    }

    /// Returns the numbers of rejected messages since the start.
    pub(super) const fn rejected(&self) -> RejectedCounts {
        self.rejected
    }
}
