//! Arrivals of a port that wait for the layer above.

use std::collections::VecDeque;

use crate::transport::Arrival;
use crate::transport::memory::Reservation;

/// If this number of arrivals is queued, further reports of lost, incomplete or invalid messages are dropped. The queue
/// gets this long only if the layer above does not receive the arrivals.
const MAX_ARRIVALS: usize = 1_024;

/// An arrival, and the reservation of its memory.
#[derive(Debug)]
pub(crate) struct Delivery {
    pub(crate) arrival: Arrival,
    /// Holds the memory until the delivery is dropped.
    pub(crate) _reserved: Option<Reservation>,
}

/// Arrivals in the order of their arrival. Messages and ends of connections are never dropped. The memory of messages
/// is bounded by their reservations.
#[derive(Debug, Default)]
pub(super) struct ArrivalQueue {
    deliveries: VecDeque<Delivery>,
}

impl ArrivalQueue {
    pub(super) fn push(&mut self, arrival: Arrival, reserved: Option<Reservation>) {
        let is_droppable =
            matches!(arrival, Arrival::InvalidData(..) | Arrival::Incomplete(..) | Arrival::Lost(..));
        if !is_droppable || self.deliveries.len() < MAX_ARRIVALS {
            self.deliveries.push_back(Delivery { arrival, _reserved: reserved });
        }
    }

    pub(super) fn pop(&mut self) -> Option<Delivery> {
        self.deliveries.pop_front()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::ConnectionId;

    #[test]
    fn full_arrival_queue_admits_connection_ends_only() {
        let mut queue = ArrivalQueue::default();
        for _ in 0..2 * MAX_ARRIVALS {
            queue.push(Arrival::InvalidData(None, String::new()), None);
        }
        queue.push(Arrival::Gone(ConnectionId(1), String::new()), None);
        let deliveries: Vec<Delivery> = std::iter::from_fn(|| queue.pop()).collect();
        assert_eq!(deliveries.len(), MAX_ARRIVALS + 1);
        assert!(deliveries.last().is_some_and(|delivery| matches!(delivery.arrival, Arrival::Gone(..))));
    }
}
