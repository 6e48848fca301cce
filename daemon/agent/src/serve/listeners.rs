//! The listeners for sessions as one source of incoming messages.

use futures::FutureExt;
use futures::future::{join_all, select_all};
use peernet_networks::{Address, Incoming, Listener};

/// The listeners of a host, each identified by its index.
#[derive(Debug)]
pub(super) struct Listeners {
    listeners: Vec<Listener>,
    /// Index of the listener that is polled first in the next call.
    next_index: usize,
}

impl Listeners {
    pub(super) fn new(listeners: Vec<Listener>) -> Self {
        Self { listeners, next_index: 0 }
    }

    /// Waits for the next incoming message. Returns it with the index of its listener; the message is `None` if that
    /// listener's port was lost. Cancel-safe.
    pub(super) async fn next(&mut self) -> (usize, Option<Incoming>) {
        let Self { listeners, next_index } = self;
        // One listener is the usual case. It does not need the allocations of the wait for several listeners.
        if let [only_listener] = listeners.as_mut_slice() {
            return (0, only_listener.next().await);
        }
        let count = listeners.len();
        let (earlier, later) = listeners.split_at_mut(*next_index);
        // The listeners take turns, so that a busy listener cannot starve the others.
        let in_turn = later.iter_mut().chain(earlier).map(|listener| listener.next().boxed());
        let (incoming, index, _) = select_all(in_turn).await;
        let index = (*next_index + index) % count;
        *next_index = (index + 1) % count;
        (index, incoming)
    }

    /// Returns the address of a listener.
    pub(super) fn address(&self, index: usize) -> &Address {
        self.listeners[index].address()
    }

    /// Closes all ports at the same time. Each port waits until its unsent answers are sent.
    pub(super) async fn close(self) {
        join_all(self.listeners.into_iter().map(Listener::close)).await;
    }
}
