//! Events of a connection.

use std::collections::VecDeque;

use crate::transport::memory::Reservation;
use crate::transport::{Frames, MessageLoss};

/// Something that happened on a connection.
#[derive(Debug)]
pub(in crate::transport::ros) enum Event {
    /// The edge says hello, again if it has not heard the welcome.
    Hello,
    /// The cloud's answer.
    Welcome,
    /// A message of the peer, with the memory that it takes.
    Message(Frames, Vec<Reservation>),
    /// A message of the peer did not arrive as a whole.
    Incomplete(MessageLoss),
    /// A message to the peer did not arrive as a whole.
    Lost(MessageLoss),
    /// Something that the peer should not send.
    Garbage(String),
    /// A condition that makes the connection worse than it could be: on what object, and what to do.
    Remark(String),
    /// The end of the connection, with its reason.
    Gone(String),
}

/// Events that wait to be taken, and requests of the peer of whose loss it is still to be notified.
#[derive(Debug, Default)]
pub(super) struct EventQueue {
    events: VecDeque<Event>,
    lost_requests: VecDeque<u64>,
}

impl EventQueue {
    pub(super) fn push(&mut self, event: Event) {
        self.events.push_back(event);
    }

    /// Adds messages of the peer that did not arrive as a whole; the peer is notified of those that belong to a request.
    pub(super) fn push_incomplete(&mut self, losses: Vec<MessageLoss>) {
        for loss in losses {
            self.lost_requests.extend(loss.tag);
            self.events.push_back(Event::Incomplete(loss));
        }
    }

    /// Returns the next event.
    pub(super) fn pop(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Returns the next request of whose loss the peer is to be notified.
    pub(super) fn pop_lost_request(&mut self) -> Option<u64> {
        self.lost_requests.pop_front()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peer_is_notified_of_lost_requests_only() {
        let mut queue = EventQueue::default();
        let loss = |tag| MessageLoss { tag, received: 1, total: 2 };
        queue.push_incomplete(vec![loss(None), loss(Some(7))]);
        assert!(matches!(queue.pop(), Some(Event::Incomplete(MessageLoss { tag: None, .. }))));
        assert!(matches!(queue.pop(), Some(Event::Incomplete(MessageLoss { tag: Some(7), .. }))));
        assert!(queue.pop().is_none());
        assert_eq!((queue.pop_lost_request(), queue.pop_lost_request()), (Some(7), None));
    }
}
