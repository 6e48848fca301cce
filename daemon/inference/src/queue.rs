//! The bounded queue between a pool and its threads.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Many in, many out, first come first served, never more than `capacity` waiting.
///
/// A thread that already waits for work counts as a free place: what it takes at once does not wait.
pub(crate) struct Queue<T> {
    capacity: usize,
    state: Mutex<State<T>>,
    changed: Condvar,
}

struct State<T> {
    waiting: VecDeque<T>,
    idle: usize,
    closed: bool,
}

/// Why something was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rejection {
    Full,
    Closed,
}

impl<T> Queue<T> {
    pub(crate) fn new(capacity: usize) -> Self {
        let state = State { waiting: VecDeque::new(), idle: 0, closed: false };
        Self { capacity, state: Mutex::new(state), changed: Condvar::new() }
    }

    pub(crate) fn capacity(&self) -> usize {
        self.capacity
    }

    /// How many wait now.
    pub(crate) fn len(&self) -> usize {
        self.lock().waiting.len()
    }

    /// Adds at the end, or gives back at once.
    pub(crate) fn push(&self, item: T) -> Result<(), (T, Rejection)> {
        let mut state = self.lock();
        if state.closed {
            return Err((item, Rejection::Closed));
        }
        if state.waiting.len() >= self.capacity + state.idle {
            return Err((item, Rejection::Full));
        }
        state.waiting.push_back(item);
        drop(state);
        self.changed.notify_one();
        Ok(())
    }

    /// Waits for the next; `None` once the queue is closed.
    pub(crate) fn pop(&self) -> Option<T> {
        let mut state = self.lock();
        state.idle += 1;
        while state.waiting.is_empty() && !state.closed {
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.idle -= 1;
        if state.closed { None } else { state.waiting.pop_front() }
    }

    /// Lets all who wait go, and gives back what nobody took.
    pub(crate) fn close(&self) -> VecDeque<T> {
        let mut state = self.lock();
        state.closed = true;
        let left = std::mem::take(&mut state.waiting);
        drop(state);
        self.changed.notify_all();
        left
    }

    /// Nothing in here can panic half-way, so that a poisoned lock still guards a whole state.
    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    #[test]
    fn the_bound_holds_and_order_is_kept() {
        let queue = Queue::new(2);
        assert_eq!((queue.push('a'), queue.push('b')), (Ok(()), Ok(())));
        assert_eq!(queue.push('c'), Err(('c', Rejection::Full)));
        assert_eq!((queue.pop(), queue.pop(), queue.len()), (Some('a'), Some('b'), 0));
    }

    #[test]
    fn closing_wakes_who_waits_and_gives_back_the_rest() {
        let queue = Arc::new(Queue::<char>::new(4));
        let waiting = std::thread::spawn({
            let queue = Arc::clone(&queue);
            move || queue.pop()
        });
        assert!(queue.close().is_empty());
        assert_eq!(waiting.join().expect("does not panic"), None);

        let queue = Queue::new(4);
        queue.push('a').expect("has room");
        assert_eq!(queue.close(), ['a']);
        assert_eq!(queue.push('b'), Err(('b', Rejection::Closed)));
    }
}
