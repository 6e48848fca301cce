//! Computes how long a stopping outbox continues to send. No I/O: the time is an argument.

use std::time::Duration;

use tokio::time::Instant;

/// Shutdown of the outbox. All events are written to the spool. The events are also sent to the aggregator, as long as
/// the aggregator stores events in time.
#[derive(Debug)]
pub(super) struct Shutdown {
    deadline: Instant,
    /// Time without a newly stored event after which the outbox no longer waits for the aggregator.
    progress_timeout: Duration,
    /// Time at which the aggregator was last seen to store an event.
    latest_progress: Instant,
    /// Number of events that the aggregator had stored by that time.
    stored: u64,
}

/// State of the outbox at one time.
#[derive(Clone, Copy, Debug)]
pub(super) struct OutboxState {
    /// `true` if all events are in the spool.
    pub(super) is_spooled: bool,
    /// `true` if the aggregator is known to be unreachable.
    pub(super) is_unreachable: bool,
    /// Number of events that the aggregator has stored.
    pub(super) stored: u64,
    /// Number of events that the aggregator has not stored.
    pub(super) waiting: u64,
}

impl Shutdown {
    /// Starts a shutdown at `now` that ends at `deadline` at the latest; `stored` events are already stored.
    pub(super) fn start(now: Instant, deadline: Instant, stored: u64) -> Self {
        Self {
            deadline,
            // An aggregator that stored no event in half of the time will probably store none in the other half.
            progress_timeout: deadline.saturating_duration_since(now) / 2,
            latest_progress: now,
            stored,
        }
    }

    /// Returns the time until which sending continues. The caller must call this method again at that time. `None` when
    /// the shutdown is complete.
    pub(super) fn continue_until(&mut self, now: Instant, state: OutboxState) -> Option<Instant> {
        let OutboxState { is_spooled, is_unreachable, stored, waiting } = state;
        if stored > self.stored {
            (self.stored, self.latest_progress) = (stored, now);
        }
        let end = match (is_spooled, is_unreachable) {
            // The outbox waits for the spool, because events that are only in memory would be lost.
            (false, _) => self.deadline,
            (true, true) => now,
            // Without progress the outbox stops before the deadline: the next start of the agent sends the remaining
            // events from the spool.
            (true, false) => self.deadline.min(self.latest_progress + self.progress_timeout),
        };
        (waiting > 0 && now < end).then_some(end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPOOLED: OutboxState =
        OutboxState { is_spooled: true, is_unreachable: false, stored: 10, waiting: 90 };

    fn seconds(seconds: f64) -> Duration {
        Duration::from_secs_f64(seconds)
    }

    #[tokio::test]
    async fn progress_extends_delivery_until_deadline() {
        let now = Instant::now();
        let at = |after: f64| now + seconds(after);
        let mut shutdown = Shutdown::start(now, at(4.0), 10);
        assert_eq!(shutdown.continue_until(now, SPOOLED), Some(at(2.0)));
        assert_eq!(shutdown.continue_until(at(1.9), OutboxState { stored: 20, ..SPOOLED }), Some(at(3.9)));
        assert_eq!(shutdown.continue_until(at(3.4), OutboxState { stored: 30, ..SPOOLED }), Some(at(4.0)));
        assert_eq!(
            shutdown.continue_until(at(3.5), OutboxState { stored: 100, waiting: 0, ..SPOOLED }),
            None
        );
        assert_eq!(
            shutdown.continue_until(at(4.0), OutboxState { stored: 31, ..SPOOLED }),
            None,
            "the deadline has passed"
        );
    }

    #[tokio::test]
    async fn spooled_events_do_not_wait_for_silent_aggregator() {
        let now = Instant::now();
        let at = |after: f64| now + seconds(after);
        let mut shutdown = Shutdown::start(now, at(4.0), 10);
        assert_eq!(shutdown.continue_until(at(2.0), SPOOLED), None, "no progress in half of the time");
        assert_eq!(
            shutdown.continue_until(at(0.1), OutboxState { is_unreachable: true, ..SPOOLED }),
            None,
            "the aggregator is unreachable"
        );
        assert_eq!(
            Shutdown::start(now, now, 0).continue_until(now, SPOOLED),
            None,
            "the deadline has already passed"
        );
    }

    #[tokio::test]
    async fn events_only_in_memory_are_awaited_until_deadline() {
        let now = Instant::now();
        let at = |after: f64| now + seconds(after);
        let mut shutdown = Shutdown::start(now, at(4.0), 10);
        let unspooled = OutboxState { is_spooled: false, is_unreachable: true, ..SPOOLED };
        assert_eq!(shutdown.continue_until(at(3.9), unspooled), Some(at(4.0)));
        assert_eq!(shutdown.continue_until(at(3.95), OutboxState { is_spooled: true, ..unspooled }), None);
        assert_eq!(shutdown.continue_until(at(4.0), unspooled), None);
    }
}
