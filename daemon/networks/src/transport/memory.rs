//! Memory budgets that many connections share. Bytes are reserved before memory is used, and given back when the
//! reservation is dropped.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// A number of bytes that several reservations share: the sum of the reservations never exceeds it.
#[derive(Debug)]
pub(crate) struct MemoryBudget {
    limit: u64,
    reserved_bytes: AtomicU64,
}

/// Bytes reserved in a budget; dropping the reservation gives the bytes back.
#[derive(Debug)]
pub(crate) struct Reservation {
    budget: Arc<MemoryBudget>,
    bytes: u64,
}

/// Error: a reservation would exceed its budget.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct BudgetExhausted;

impl MemoryBudget {
    pub(crate) fn new(limit: u64) -> Arc<Self> {
        Arc::new(Self { limit, reserved_bytes: AtomicU64::new(0) })
    }

    pub(crate) fn reserved_bytes(&self) -> u64 {
        self.reserved_bytes.load(Ordering::Relaxed)
    }

    fn reserve(&self, bytes: u64) -> Result<(), BudgetExhausted> {
        let add_if_it_fits = |reserved_bytes: u64| {
            reserved_bytes.checked_add(bytes).filter(|reserved_bytes| *reserved_bytes <= self.limit)
        };
        self.reserved_bytes
            // Relaxed is enough: only the sum of the reservations matters, and no other memory depends on the sum.
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, add_if_it_fits)
            .map(drop)
            .map_err(|_| BudgetExhausted)
    }
}

impl Reservation {
    pub(crate) fn empty(budget: &Arc<MemoryBudget>) -> Self {
        Self { budget: Arc::clone(budget), bytes: 0 }
    }

    /// Grows or shrinks the reservation to `bytes` of `budget`. A reservation in another budget moves to this budget.
    ///
    /// # Errors
    /// If the reservation would exceed `budget`. The reservation is then unchanged.
    pub(crate) fn resize(&mut self, budget: &Arc<MemoryBudget>, bytes: u64) -> Result<(), BudgetExhausted> {
        if !Arc::ptr_eq(&self.budget, budget) {
            // The bytes are reserved in the new budget before they are released in the old budget, so that a failure
            // changes nothing.
            let mut moved = Self::empty(budget);
            moved.resize(budget, bytes)?;
            *self = moved;
        } else if bytes >= self.bytes {
            if bytes == self.bytes {
                return Ok(());
            }
            budget.reserve(bytes - self.bytes)?;
            self.bytes = bytes;
        } else {
            self.shrink_to(bytes);
        }
        Ok(())
    }

    /// Reduces the reservation to `bytes` of its budget, if it is larger.
    pub(crate) fn shrink_to(&mut self, bytes: u64) {
        let freed_bytes = self.bytes.saturating_sub(bytes);
        self.budget.reserved_bytes.fetch_sub(freed_bytes, Ordering::Relaxed);
        self.bytes -= freed_bytes;
    }

    #[cfg(test)]
    pub(crate) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Moves all reserved bytes to a new reservation.
    pub(crate) fn take(&mut self) -> Self {
        Self { budget: Arc::clone(&self.budget), bytes: std::mem::take(&mut self.bytes) }
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.budget.reserved_bytes.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dropped_or_moved_reservation_frees_its_budget() {
        let (small, large) = (MemoryBudget::new(10), MemoryBudget::new(100));
        let (mut first, mut second) = (Reservation::empty(&small), Reservation::empty(&small));
        first.resize(&small, 7).expect("fits");
        assert_eq!(second.resize(&small, 4), Err(BudgetExhausted));
        second.resize(&small, 3).expect("fits exactly");
        first.resize(&large, 80).expect("moves");
        assert_eq!((small.reserved_bytes(), large.reserved_bytes()), (3, 80));
        let handed_over = first.take();
        drop((first, second));
        assert_eq!((small.reserved_bytes(), large.reserved_bytes()), (0, 80));
        drop(handed_over);
        assert_eq!(large.reserved_bytes(), 0);
    }
}
