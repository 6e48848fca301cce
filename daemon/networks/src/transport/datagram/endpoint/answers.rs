//! Answers of a port to senders without a connection.

use std::collections::VecDeque;

use super::Route;
use crate::transport::datagram::packet::{Packet, Role};

/// Maximum number of queued answers. A sender that gets no answer repeats its request.
const MAX_ANSWERS: usize = 256;

/// Answers that wait to be sent.
#[derive(Debug)]
pub(super) struct AnswerQueue {
    prefix: &'static [u8],
    answers: VecDeque<(Route, Vec<u8>)>,
}

impl AnswerQueue {
    /// Creates an empty queue. Each datagram begins with `prefix`.
    pub(super) const fn new(prefix: &'static [u8]) -> Self {
        Self { prefix, answers: VecDeque::new() }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.answers.is_empty()
    }

    /// Queues an answer. Drops it if the queue is full.
    pub(super) fn push(&mut self, route: Route, packet: &Packet<'_>) {
        self.push_padded(route, packet, 0);
    }

    /// Queues an answer in a datagram of at least `bytes` bytes.
    pub(super) fn push_padded(&mut self, route: Route, packet: &Packet<'_>, bytes: usize) {
        if self.answers.len() < MAX_ANSWERS {
            let mut answer = self.prefix.to_vec();
            packet.write(Role::Cloud, &mut answer);
            answer.resize(answer.len().max(bytes), 0);
            self.answers.push_back((route, answer));
        }
    }

    pub(super) fn pop(&mut self) -> Option<(Route, Vec<u8>)> {
        self.answers.pop_front()
    }
}
