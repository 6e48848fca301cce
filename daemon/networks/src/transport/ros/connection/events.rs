//! Events of a connection.

use std::collections::VecDeque;

use crate::transport::memory::Reservation;
use crate::transport::{Frames, MessageLoss};

/// Event of a connection.
#[derive(Debug)]
pub(in crate::transport::ros) enum Event {
    /// The edge said hello. An edge repeats the hello until it receives the welcome.
    Hello,
    /// The cloud answered the hello.
    Welcome,
    /// A message of the peer arrived; with the reservations of its memory.
    Message(Frames, Vec<Reservation>),
    /// A message of the peer did not arrive as a whole.
    IncomingLost(MessageLoss),
    /// A message to the peer did not arrive as a whole.
    OutgoingLost(MessageLoss),
    /// The peer sent invalid data, for this reason.
    InvalidData(String),
    /// The connection works, but worse than it could. The text says why, and what to do about it.
    Remark(String),
    /// The connection ended, for this reason.
    Gone(String),
}

/// Queue of events, and of the numbers of lost requests about which the peer must be notified.
#[derive(Debug, Default)]
pub(super) struct EventQueue {
    events: VecDeque<Event>,
    lost_requests: VecDeque<u64>,
}

impl EventQueue {
    pub(super) fn push(&mut self, event: Event) {
        self.events.push_back(event);
    }

    /// Adds messages of the peer that did not arrive as a whole. The peer is notified of messages that belong to a
    /// request.
    pub(super) fn push_incomplete(&mut self, losses: Vec<MessageLoss>) {
        for loss in losses {
            self.lost_requests.extend(loss.tag);
            self.events.push_back(Event::IncomingLost(loss));
        }
    }

    /// Removes and returns the next event.
    pub(super) fn pop(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Removes and returns the number of the next lost request about which the peer must be notified.
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
        assert!(matches!(queue.pop(), Some(Event::IncomingLost(MessageLoss { tag: None, .. }))));
        assert!(matches!(queue.pop(), Some(Event::IncomingLost(MessageLoss { tag: Some(7), .. }))));
        assert!(queue.pop().is_none());
        assert_eq!((queue.pop_lost_request(), queue.pop_lost_request()), (Some(7), None));
    }
}
