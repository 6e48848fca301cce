//! Memory budget for the requests of all sessions of a listener.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bytes::Bytes;

use crate::transport::Frames;

/// Counts the bytes of requests from their arrival until their last holder drops them. The last holder is the model, or
/// the network if it still sends the bytes back.
///
/// The budget counts bytes that are really held. A crowd of large requests is therefore answered with "overloaded" and
/// does not fill the memory.
#[derive(Debug)]
pub(super) struct Budget {
    most: u64,
    held: AtomicU64,
}

/// Error: the budget has no room for a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the cloud holds {held} bytes of requests and has no room for {bytes} more; its max_in_flight_bytes is {most}"
)]
pub(super) struct BudgetExceeded {
    /// Bytes of the requests that are held.
    held: u64,
    /// Bytes of the new request.
    bytes: u64,
    most: u64,
}

/// A part of the budget, returned when it is dropped.
#[derive(Debug)]
struct BudgetShare {
    budget: Arc<Budget>,
    bytes: u64,
}

/// A frame that holds its share until it is dropped.
struct BudgetedFrame {
    frame: Bytes,
    _share: Arc<BudgetShare>,
}

impl AsRef<[u8]> for BudgetedFrame {
    fn as_ref(&self) -> &[u8] {
        &self.frame
    }
}

impl Drop for BudgetShare {
    fn drop(&mut self) {
        self.budget.held.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

impl Budget {
    pub(super) fn new(most: u64) -> Arc<Self> {
        Arc::new(Self { most, held: AtomicU64::new(0) })
    }

    /// Counts the frames of a request until they are dropped. A request that is alone always fits, because its size is
    /// limited elsewhere.
    ///
    /// # Errors
    /// If there is no room for the frames now.
    pub(super) fn reserve_frames(self: &Arc<Self>, frames: Frames) -> Result<Frames, BudgetExceeded> {
        let bytes: u64 = frames.iter().map(|frame| frame.len() as u64).sum();
        // `held == 0` lets a request of any size pass if it is alone.
        let fits = |held: u64| (held == 0 || held.saturating_add(bytes) <= self.most).then(|| held + bytes);
        self.held
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits)
            .map_err(|held| BudgetExceeded { held, bytes, most: self.most })?;
        let share = Arc::new(BudgetShare { budget: Arc::clone(self), bytes });
        let held = |frame| Bytes::from_owner(BudgetedFrame { frame, _share: Arc::clone(&share) });
        Ok(frames.into_iter().map(held).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(sizes: &[usize]) -> Frames {
        sizes.iter().map(|size| Bytes::from(vec![7; *size])).collect()
    }

    #[test]
    fn bytes_are_reserved_until_last_part_is_dropped() {
        let budget = Budget::new(100);
        let held = budget.reserve_frames(frames(&[10, 50])).expect("fits");
        assert_eq!((held[0].len(), held[1].len()), (10, 50));
        let refused = budget.reserve_frames(frames(&[41])).expect_err("is too much").to_string();
        assert!(refused.contains("60 bytes") && refused.contains("100"), "{refused}");
        let rest = budget.reserve_frames(frames(&[40])).expect("fits exactly");
        let part = held[1].slice(5..6);
        drop((held, rest));
        assert!(budget.reserve_frames(frames(&[41])).is_err(), "one byte of the first request is still held");
        drop(part);
        drop(budget.reserve_frames(frames(&[1000])).expect("is alone"));
        assert_eq!(budget.held.load(Ordering::Relaxed), 0);
    }
}
