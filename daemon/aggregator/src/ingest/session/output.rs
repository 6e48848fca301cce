//! What the session has to say: replies to connections, news for the live state, and counts of what was not taken.

use peernet_logger::HostId;
use peernet_networks::ConnectionId;
use peernet_stream::ToAgent;

use crate::live::News;

/// What could not be taken, since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct RejectedCounts {
    /// Batches and greetings that found no room; batches are asked for again, greetings are repeated.
    pub(crate) deferred: u64,
    /// Batches that do not match their hash; they are asked for again.
    pub(crate) damaged: u64,
    /// Frames that are no message.
    pub(crate) unreadable: u64,
    /// Messages of hosts that did not say hello on that connection, or did not prove who they are.
    pub(crate) strangers: u64,
}

/// Replies and news that were not collected yet, and the counts since the start.
#[derive(Debug, Default)]
pub(super) struct SessionOutput {
    replies: Vec<(ConnectionId, ToAgent)>,
    news: Vec<News>,
    rejected: RejectedCounts,
}

impl SessionOutput {
    /// Adds a message to be sent.
    pub(super) fn reply(&mut self, to: ConnectionId, message: ToAgent) {
        self.replies.push((to, message));
    }

    /// Adds what the live state should know.
    pub(super) fn announce(&mut self, news: News) {
        self.news.push(news);
    }

    /// A greeting found no room.
    pub(super) const fn defer_greeting(&mut self) {
        self.rejected.deferred += 1;
    }

    /// A batch of the host found no room.
    pub(super) fn defer_batch(&mut self, host: HostId) {
        self.rejected.deferred += 1;
        self.announce(News::Deferred(host));
    }

    /// A batch of the host does not match its hash.
    pub(super) fn reject_damaged(&mut self, host: HostId) {
        self.rejected.damaged += 1;
        self.announce(News::Damaged(host));
    }

    /// A frame is no message.
    pub(super) fn reject_unreadable(&mut self) {
        self.rejected.unreadable += 1;
        self.announce(News::Unreadable);
    }

    /// A message came of a host that did not say hello on that connection, or did not prove who it is: it is asked to.
    pub(super) fn reject_stranger(&mut self, connection: ConnectionId) {
        self.rejected.strangers += 1;
        self.announce(News::Stranger);
        self.reply(connection, ToAgent::Unknown);
    }

    /// What is to be sent, and to whom.
    pub(super) fn take_replies(&mut self) -> Vec<(ConnectionId, ToAgent)> {
        std::mem::take(&mut self.replies)
    }

    /// What the live state should know.
    pub(super) fn take_news(&mut self) -> Vec<News> {
        std::mem::take(&mut self.news)
    }

    /// What could not be taken, since the start.
    pub(super) const fn rejected(&self) -> RejectedCounts {
        self.rejected
    }
}
