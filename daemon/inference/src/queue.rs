//! Bounded queue between a pool and its threads.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Bounded first-in first-out queue with several producers and consumers.
///
/// At most `capacity` items wait. Each idle consumer allows one more item, because it takes the item at once.
///
/// An item is *unfinished* from [`push`](Self::push) until [`finish`](Self::finish). A consumer that collects a batch
/// stops waiting when the number of unfinished items reaches its maximum since a consumer's wait last timed out: every
/// producer then probably waits for an answer, and no producer will add an item.
// Channels of the standard library and of tokio do not count idle consumers.
pub(crate) struct Queue<T> {
    capacity: usize,
    state: Mutex<State<T>>,
    changed: Condvar,
}

struct State<T> {
    waiting: VecDeque<T>,
    /// Number of items that waiting consumers will take as soon as the items are added.
    awaited_items: usize,
    /// Number of unfinished items, in the queue and with consumers.
    unfinished: usize,
    /// Largest number of unfinished items since a consumer's wait last timed out. A consumer does not wait when this
    /// number is reached.
    max_unfinished: usize,
    is_closed: bool,
}

/// Reason why an item was not added.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rejection {
    Full,
    Closed,
}

impl<T> Queue<T> {
    pub(crate) fn new(capacity: usize) -> Self {
        // Nothing is known about the producers yet, so the first batch waits for its whole time.
        let max_unfinished = usize::MAX;
        let state = State {
            waiting: VecDeque::new(),
            awaited_items: 0,
            unfinished: 0,
            max_unfinished,
            is_closed: false,
        };
        Self { capacity, state: Mutex::new(state), changed: Condvar::new() }
    }

    pub(crate) fn capacity(&self) -> usize {
        self.capacity
    }

    /// Returns whether [`push`](Self::push) would reject an item now because the queue is full.
    pub(crate) fn is_full(&self) -> bool {
        self.is_full_in(&self.lock())
    }

    fn is_full_in(&self, state: &State<T>) -> bool {
        state.waiting.len() >= self.capacity + state.awaited_items
    }

    /// Returns the number of waiting items.
    pub(crate) fn len(&self) -> usize {
        self.lock().waiting.len()
    }

    /// Adds an item at the end; never waits.
    ///
    /// # Errors
    /// If the queue is full or closed; the error contains the item.
    pub(crate) fn push(&self, item: T) -> Result<(), (T, Rejection)> {
        let mut state = self.lock();
        if state.is_closed {
            return Err((item, Rejection::Closed));
        }
        if self.is_full_in(&state) {
            return Err((item, Rejection::Full));
        }
        state.waiting.push_back(item);
        state.unfinished += 1;
        state.max_unfinished = state.max_unfinished.max(state.unfinished);
        let is_last_expected = state.unfinished >= state.max_unfinished;
        // The lock is released before the notification, so that the woken consumer does not wait for the lock.
        drop(state);
        if is_last_expected {
            // An idle consumer may take the item. Another consumer may collect a batch, and need not wait any more.
            self.changed.notify_all();
        } else {
            self.changed.notify_one();
        }
        Ok(())
    }

    /// Removes and returns the waiting items for which `is_removed` is true.
    pub(crate) fn remove(&self, mut is_removed: impl FnMut(&T) -> bool) -> Vec<T> {
        let mut state = self.lock();
        let (removed, kept) =
            std::mem::take(&mut state.waiting).into_iter().partition(|item| is_removed(item));
        state.waiting = kept;
        state.unfinished = state.unfinished.saturating_sub(removed.len());
        removed.into()
    }

    /// Marks `count` of the taken items as finished. Call this before the producers of these items learn the results:
    /// otherwise a producer that adds its next item has two unfinished items.
    pub(crate) fn finish(&self, count: usize) {
        let mut state = self.lock();
        state.unfinished = state.unfinished.saturating_sub(count);
    }

    /// Waits for the next item; returns `None` once the queue is closed.
    pub(crate) fn pop(&self) -> Option<T> {
        let mut state = self.lock();
        state.awaited_items += 1;
        while state.waiting.is_empty() && !state.is_closed {
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.awaited_items -= 1;
        if state.is_closed { None } else { state.waiting.pop_front() }
    }

    /// Adds waiting items to `items` until `items` has `size` elements. Waits at most `timeout`, and only while more
    /// items are expected; see [`Queue`]. Takes no item if the queue is closed.
    pub(crate) fn pop_more(&self, items: &mut Vec<T>, size: usize, timeout: Duration) {
        let missing = size.saturating_sub(items.len());
        let mut state = self.lock();
        // This consumer takes all missing items as soon as they arrive, so the queue accepts as many further items.
        state.awaited_items += missing;
        let must_wait = |state: &mut State<T>| {
            state.waiting.len() < missing && state.unfinished < state.max_unfinished && !state.is_closed
        };
        let waited = self.changed.wait_timeout_while(state, timeout, must_wait);
        let (mut state, wait) = waited.unwrap_or_else(PoisonError::into_inner);
        state.awaited_items -= missing;
        if wait.timed_out() {
            // The expected items were not added, so fewer producers are active than before.
            state.max_unfinished = state.unfinished;
        }
        if state.is_closed {
            return;
        }
        let ready = missing.min(state.waiting.len());
        items.extend(state.waiting.drain(..ready));
        let is_more_waiting = !state.waiting.is_empty();
        drop(state);
        // This consumer may have received the notification of a further item in place of an idle consumer.
        if is_more_waiting {
            self.changed.notify_one();
        }
    }

    /// Closes the queue: wakes all consumers, and returns the items that none of them took.
    pub(crate) fn close(&self) -> VecDeque<T> {
        let mut state = self.lock();
        state.is_closed = true;
        let waiting = std::mem::take(&mut state.waiting);
        drop(state);
        self.changed.notify_all();
        waiting
    }

    /// Locks the state. No code here panics while it holds the lock, so the state behind a poisoned lock is consistent.
    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    #[test]
    fn full_queue_rejects_item_and_keeps_order() {
        let queue = Queue::new(2);
        assert_eq!((queue.push('a'), queue.push('b')), (Ok(()), Ok(())));
        assert_eq!(queue.push('c'), Err(('c', Rejection::Full)));
        assert_eq!((queue.pop(), queue.pop(), queue.len()), (Some('a'), Some('b'), 0));
    }

    #[test]
    fn batch_is_complete_at_its_size_or_at_timeout() {
        let hour = Duration::from_secs(3600);
        let queue = Arc::new(Queue::new(8));
        for item in ['b', 'c', 'd'] {
            queue.push(item).expect("has room");
        }
        let mut items = vec!['a'];
        queue.pop_more(&mut items, 3, hour);
        assert_eq!((&items[..], queue.len()), (&['a', 'b', 'c'][..], 1));
        let mut items = vec!['a'];
        queue.pop_more(&mut items, 3, Duration::from_millis(1));
        assert_eq!(items, ['a', 'd']);
        // Without unfinished items, the next consumer expects further items and waits for them.
        queue.finish(3);
        let waiting = std::thread::spawn({
            let queue = Arc::clone(&queue);
            move || {
                let mut items = vec!['a'];
                queue.pop_more(&mut items, 3, hour);
                items
            }
        });
        queue.push('e').expect("has room");
        queue.push('f').expect("has room");
        assert_eq!(waiting.join().expect("does not panic"), ['a', 'e', 'f']);
        queue.close();
        let mut items = vec!['a'];
        queue.pop_more(&mut items, 3, hour);
        assert_eq!(items, ['a'], "a closed queue does not wait");
    }

    #[test]
    fn batch_waits_only_while_more_items_are_expected() {
        let (hour, moment) = (Duration::from_secs(3600), Duration::from_millis(1));
        let queue = Queue::new(8);
        let take = |timeout: Duration| {
            let mut items = vec![queue.pop().expect("is open")];
            queue.pop_more(&mut items, 4, timeout);
            items
        };
        queue.push('a').expect("has room");
        assert_eq!(take(moment), ['a'], "the first batch waits, but no other item is added");
        queue.finish(1);
        queue.push('a').expect("has room");
        assert_eq!(take(hour), ['a'], "the only producer has its item in the batch");
        queue.push('b').expect("has room");
        assert_eq!(take(hour), ['b'], "`a` is computed by another worker");
        queue.finish(2);
        queue.push('b').expect("has room");
        queue.push('a').expect("has room");
        assert_eq!(take(hour), ['b', 'a'], "both producers have an item in the batch");
        queue.finish(2);
        queue.push('a').expect("has room");
        assert_eq!(take(moment), ['a'], "`b` is expected, but is not added");
        queue.finish(1);
        queue.push('a').expect("has room");
        assert_eq!(take(hour), ['a'], "`b` is not expected any more");
        queue.push('b').expect("has room");
        assert_eq!(queue.remove(|item| *item == 'b'), ['b']);
        queue.finish(1);
        queue.push('a').expect("has room");
        assert_eq!(
            take(moment),
            ['a'],
            "two items are expected, because the removed item counted as unfinished"
        );
    }

    #[test]
    fn closing_wakes_consumers_and_returns_waiting_items() {
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
