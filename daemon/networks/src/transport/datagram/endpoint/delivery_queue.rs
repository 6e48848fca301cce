//! Events of a port that wait for the layer above.

use std::collections::VecDeque;

use crate::transport::ListenerEvent;
use crate::transport::memory::Reservation;

/// If this number of deliveries is queued, further reports of lost, incomplete or invalid messages are dropped. The
/// queue gets this long only if the layer above does not receive the deliveries.
const MAX_DELIVERIES: usize = 1_024;

/// An event, and the reservation of its memory.
#[derive(Debug)]
pub(crate) struct Delivery {
    pub(crate) event: ListenerEvent,
    /// Holds the memory until the delivery is dropped.
    pub(crate) _reserved: Option<Reservation>,
}

/// Events in the order in which they occurred. Messages and ends of connections are never dropped. The memory of
/// messages is bounded by their reservations.
#[derive(Debug, Default)]
pub(super) struct DeliveryQueue {
    deliveries: VecDeque<Delivery>,
}

impl DeliveryQueue {
    pub(super) fn push(&mut self, event: ListenerEvent, reserved: Option<Reservation>) {
        let is_droppable = matches!(
            event,
            ListenerEvent::InvalidData(..)
                | ListenerEvent::IncomingLost(..)
                | ListenerEvent::OutgoingLost(..)
        );
        if !is_droppable || self.deliveries.len() < MAX_DELIVERIES {
            self.deliveries.push_back(Delivery { event, _reserved: reserved });
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
    fn full_delivery_queue_still_takes_connection_ends() {
        let mut queue = DeliveryQueue::default();
        for _ in 0..2 * MAX_DELIVERIES {
            queue.push(ListenerEvent::InvalidData(None, String::new()), None);
        }
        queue.push(ListenerEvent::Gone(ConnectionId(1), String::new()), None);
        let deliveries: Vec<Delivery> = std::iter::from_fn(|| queue.pop()).collect();
        assert_eq!(deliveries.len(), MAX_DELIVERIES + 1);
        assert!(deliveries.last().is_some_and(|delivery| matches!(delivery.event, ListenerEvent::Gone(..))));
    }
}
