//! Memory budget for the requests of all sessions of a listener.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bytes::Bytes;

use crate::transport::Frames;

/// Limit on the bytes of all requests in flight. The bytes of a request count from its arrival until their last owner
/// drops them. The last owner is the model, or the network if the model sends the bytes back.
///
/// If many large requests arrive at the same time, some of them are answered with "overloaded", so that requests do not
/// fill the memory.
#[derive(Debug)]
pub(super) struct RequestBudget {
    max_bytes: u64,
    used_bytes: AtomicU64,
}

/// Error: a request would exceed the budget.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the requests in flight on the cloud have {used_bytes} bytes, and {bytes} more would exceed max_in_flight_bytes, {max_bytes}; \
     send fewer requests at the same time, or raise max_in_flight_bytes on the cloud"
)]
pub(super) struct BudgetExceeded {
    /// Bytes of the requests in flight.
    used_bytes: u64,
    /// Bytes of the new request.
    bytes: u64,
    max_bytes: u64,
}

/// Bytes that are reserved in the budget. Dropping the reservation gives the bytes back to the budget.
#[derive(Debug)]
struct Reservation {
    budget: Arc<RequestBudget>,
    bytes: u64,
}

/// A frame whose bytes stay reserved until it is dropped.
struct ReservedFrame {
    frame: Bytes,
    _reservation: Arc<Reservation>,
}

impl AsRef<[u8]> for ReservedFrame {
    fn as_ref(&self) -> &[u8] {
        &self.frame
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.budget.used_bytes.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

impl RequestBudget {
    pub(super) fn new(max_bytes: u64) -> Arc<Self> {
        Arc::new(Self { max_bytes, used_bytes: AtomicU64::new(0) })
    }

    /// Reserves the bytes of a request's frames until the last frame is dropped. While no other request has reserved
    /// bytes, a request that is larger than the budget fits, too. The transport limits its size (`max_message_bytes`).
    ///
    /// # Errors
    /// If the frames would exceed the budget now.
    pub(super) fn reserve_frames(self: &Arc<Self>, frames: Frames) -> Result<Frames, BudgetExceeded> {
        let bytes: u64 = frames.iter().map(|frame| frame.len() as u64).sum();
        let sum_if_within_budget =
            |used: u64| (used == 0 || used.saturating_add(bytes) <= self.max_bytes).then(|| used + bytes);
        self.used_bytes
            // Relaxed is enough: only the sum counts, and no other memory depends on it.
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, sum_if_within_budget)
            .map_err(|used_bytes| BudgetExceeded { used_bytes, bytes, max_bytes: self.max_bytes })?;
        let reservation = Arc::new(Reservation { budget: Arc::clone(self), bytes });
        let reserve =
            |frame| Bytes::from_owner(ReservedFrame { frame, _reservation: Arc::clone(&reservation) });
        Ok(frames.into_iter().map(reserve).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(sizes: &[usize]) -> Frames {
        sizes.iter().map(|size| Bytes::from(vec![7; *size])).collect()
    }

    #[test]
    fn bytes_are_reserved_until_last_slice_is_dropped() {
        let budget = RequestBudget::new(100);
        let reserved = budget.reserve_frames(frames(&[10, 50])).expect("fits");
        assert_eq!((reserved[0].len(), reserved[1].len()), (10, 50));
        let refused = budget.reserve_frames(frames(&[41])).expect_err("is too much").to_string();
        assert!(refused.contains("60 bytes") && refused.contains("100"), "{refused}");
        let second_request = budget.reserve_frames(frames(&[40])).expect("fits exactly");
        let slice = reserved[1].slice(5..6);
        drop((reserved, second_request));
        assert!(budget.reserve_frames(frames(&[41])).is_err(), "a slice of the first request still exists");
        drop(slice);
        drop(budget.reserve_frames(frames(&[1000])).expect("no other request has reserved bytes"));
        assert_eq!(budget.used_bytes.load(Ordering::Relaxed), 0);
    }
}
