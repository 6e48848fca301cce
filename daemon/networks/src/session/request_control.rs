//! State of a request on the cloud, shared by its model, its session and its connection.

use std::collections::VecDeque;
use std::num::NonZeroU32;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio_util::sync::CancellationToken;

use crate::message::{MAX_UNREAD_BYTES, MAX_UNREAD_PARTIAL_ANSWERS};

/// Error: the edge does not wait for the answer any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the edge does not wait for the answer any more")]
pub struct RequestCancelled;

/// Cancellation of a request, and flow control of the partial answers to it.
#[derive(Debug, Default)]
pub(crate) struct RequestControl {
    state: Mutex<ControlState>,
    changed: Condvar,
    /// Token that is cancelled with the request, for models that wait in a task.
    cancellation: CancellationToken,
}

#[derive(Debug, Default)]
struct ControlState {
    /// Number of partial answers that were sent.
    sent_count: u32,
    /// Number of partial answers that the edge has read.
    read_count: u32,
    /// Number of unread partial answers that were lost on the way.
    lost_count: u32,
    /// Payload bytes of each unread partial answer; 0 for those that were probably lost.
    unread_bytes: VecDeque<u64>,
    is_cancelled: bool,
}

impl ControlState {
    /// Returns whether the next partial answer has to wait for an acknowledgement.
    // The edge acknowledges after a quarter of each limit. Whenever the window is full, an acknowledgement is therefore
    // due or on its way.
    fn is_window_full(&self) -> bool {
        let unread = self.sent_count - self.read_count - self.lost_count;
        unread >= MAX_UNREAD_PARTIAL_ANSWERS || self.unread_bytes.iter().sum::<u64>() >= MAX_UNREAD_BYTES
    }
}

impl RequestControl {
    fn state(&self) -> MutexGuard<'_, ControlState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Cancels the request and wakes its model.
    pub(crate) fn cancel(&self) {
        self.state().is_cancelled = true;
        self.changed.notify_all();
        self.cancellation.cancel();
    }

    /// Returns the token that is cancelled with the request.
    pub(crate) fn cancellation(&self) -> CancellationToken {
        self.cancellation.clone()
    }

    pub(crate) fn is_cancelled(&self) -> bool {
        self.state().is_cancelled
    }

    /// Notes that the edge has read the first `read_count` partial answers. Ignores partial answers that were never
    /// sent.
    pub(crate) fn acknowledge(&self, read_count: u32) {
        let mut state = self.state();
        // A higher number would make the subtraction in `is_window_full` overflow.
        let read_count = read_count.min(state.sent_count);
        if read_count > state.read_count {
            let newly_read = (read_count - state.read_count) as usize;
            state.unread_bytes.drain(..newly_read);
            state.read_count = read_count;
            // Most lost partial answers have numbers below `read_count` and count as read from now on. A lost partial
            // answer with a higher number occupies a place in the window, but only until the next acknowledgement.
            state.lost_count = 0;
        }
        self.changed.notify_all();
    }

    /// Notes that one of the unread partial answers was lost on the way, so that the edge does not acknowledge it.
    /// Ignored if no partial answer is unread.
    pub(crate) fn note_lost_partial_answer(&self) {
        let mut state = self.state();
        state.lost_count = (state.lost_count + 1).min(state.sent_count - state.read_count);
        // The network does not say which partial answer was lost. It retransmits small messages, so the lost one is
        // probably the largest.
        if let Some(largest) = state.unread_bytes.iter_mut().max() {
            *largest = 0;
        }
        self.changed.notify_all();
    }

    /// Returns the number of partial answers that were sent; `None` if no partial answer was sent.
    pub(crate) fn sent_partial_answers(&self) -> Option<NonZeroU32> {
        NonZeroU32::new(self.state().sent_count)
    }

    /// Returns the number of the next partial answer, which has `bytes` bytes of payload, and counts it as sent. Waits
    /// while [`MAX_UNREAD_PARTIAL_ANSWERS`] partial answers or [`MAX_UNREAD_BYTES`] are unread.
    ///
    /// # Errors
    /// If the request is cancelled.
    pub(crate) fn next_partial_answer_number(&self, bytes: u64) -> Result<u32, RequestCancelled> {
        let must_wait = |state: &mut ControlState| !state.is_cancelled && state.is_window_full();
        let mut state =
            self.changed.wait_while(self.state(), must_wait).unwrap_or_else(PoisonError::into_inner);
        if state.is_cancelled {
            return Err(RequestCancelled);
        }
        let number = state.sent_count;
        state.sent_count += 1;
        state.unread_bytes.push_back(bytes);
        Ok(number)
    }

    /// Waits for `duration`.
    ///
    /// # Errors
    /// If the request is cancelled. The function then returns at once.
    pub(crate) fn wait(&self, duration: Duration) -> Result<(), RequestCancelled> {
        let (state, _) = self
            .changed
            .wait_timeout_while(self.state(), duration, |state| !state.is_cancelled)
            .unwrap_or_else(PoisonError::into_inner);
        if state.is_cancelled { Err(RequestCancelled) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::thread;

    use super::*;

    #[test]
    fn sending_waits_until_partial_answers_are_read() {
        let control = Arc::new(RequestControl::default());
        let numbers: Vec<u32> = (0..MAX_UNREAD_PARTIAL_ANSWERS)
            .map(|_| control.next_partial_answer_number(1).expect("the window is open"))
            .collect();
        assert_eq!(numbers, (0..MAX_UNREAD_PARTIAL_ANSWERS).collect::<Vec<_>>());
        let waiting_thread = thread::spawn({
            let control = Arc::clone(&control);
            move || control.next_partial_answer_number(1)
        });
        control.acknowledge(0);
        assert!(!waiting_thread.is_finished(), "nothing was read");
        control.acknowledge(1);
        assert_eq!(waiting_thread.join().expect("does not panic"), Ok(MAX_UNREAD_PARTIAL_ANSWERS));
    }

    #[test]
    fn acknowledging_unsent_partial_answers_does_not_widen_window() {
        let control = RequestControl::default();
        control.acknowledge(u32::MAX);
        for _ in 0..MAX_UNREAD_PARTIAL_ANSWERS {
            control.next_partial_answer_number(1).expect("the window is open");
        }
        control.acknowledge(u32::MAX);
        assert_eq!(control.next_partial_answer_number(1), Ok(MAX_UNREAD_PARTIAL_ANSWERS));
        assert_eq!(control.state().read_count, MAX_UNREAD_PARTIAL_ANSWERS);
    }

    #[test]
    fn lost_partial_answers_do_not_count_as_unread() {
        let control = RequestControl::default();
        control.note_lost_partial_answer();
        // Nothing arrives any more, so nothing is acknowledged.
        for number in 0..MAX_UNREAD_PARTIAL_ANSWERS * 3 {
            assert_eq!(control.next_partial_answer_number(1), Ok(number));
            control.note_lost_partial_answer();
        }
        for _ in 0..MAX_UNREAD_PARTIAL_ANSWERS {
            control.next_partial_answer_number(1).expect("the window is open");
        }
        control.acknowledge(MAX_UNREAD_PARTIAL_ANSWERS * 4);
        let state = control.state();
        assert_eq!((state.read_count, state.lost_count), (state.sent_count, 0));
    }

    #[test]
    fn sending_waits_until_bytes_are_read_or_lost() {
        let control = Arc::new(RequestControl::default());
        assert_eq!(control.next_partial_answer_number(MAX_UNREAD_BYTES - 1), Ok(0));
        assert_eq!(
            control.next_partial_answer_number(MAX_UNREAD_BYTES * 9),
            Ok(1),
            "the last partial answer may exceed the window"
        );
        let wait_for_next = || {
            let control = Arc::clone(&control);
            thread::spawn(move || control.next_partial_answer_number(MAX_UNREAD_BYTES))
        };
        let waiting_thread = wait_for_next();
        control.acknowledge(1);
        assert!(!waiting_thread.is_finished(), "the larger partial answer is unread");
        control.acknowledge(2);
        assert_eq!(waiting_thread.join().expect("does not panic"), Ok(2));
        let waiting_thread = wait_for_next();
        control.note_lost_partial_answer();
        assert_eq!(waiting_thread.join().expect("does not panic"), Ok(3));
    }

    #[test]
    fn cancellation_ends_every_wait() {
        let control = Arc::new(RequestControl::default());
        for _ in 0..MAX_UNREAD_PARTIAL_ANSWERS {
            control.next_partial_answer_number(1).expect("the window is open");
        }
        let waits = [
            thread::spawn({
                let control = Arc::clone(&control);
                move || control.next_partial_answer_number(1).map(drop)
            }),
            thread::spawn({
                let control = Arc::clone(&control);
                move || control.wait(Duration::from_secs(3_600))
            }),
        ];
        control.cancel();
        for wait in waits {
            assert_eq!(wait.join().expect("does not panic"), Err(RequestCancelled));
        }
        assert!(control.is_cancelled());
        assert_eq!(control.wait(Duration::ZERO), Err(RequestCancelled));
    }
}
