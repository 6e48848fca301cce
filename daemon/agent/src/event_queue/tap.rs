//! Copies of events for a program that runs the agent in the foreground.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use peernet_stream::Event;
use tokio::sync::mpsc;

/// Channel to the program that runs the agent. Clones share the channel. Sending never waits.
#[derive(Clone, Debug)]
pub(crate) struct EventTap {
    sender: mpsc::Sender<Event>,
    missed_events: Arc<AtomicU64>,
}

impl EventTap {
    pub(crate) fn new(sender: mpsc::Sender<Event>) -> Self {
        Self { sender, missed_events: Arc::default() }
    }

    /// Sends an event, or counts it as missed if the channel is full.
    pub(super) fn offer(&self, event: Event) {
        if self.sender.try_send(event).is_err() {
            self.missed_events.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Returns the number of events that did not fit into the channel.
    pub(crate) fn missed_events(&self) -> u64 {
        self.missed_events.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, ManualClock, WallTime};
    use peernet_logger::RunId;
    use peernet_stream::{EndReason, RunEnded};

    use super::super::EventQueue;
    use super::*;

    fn run_ended() -> Event {
        let ended = WallTime::from_unix_nanos(1);
        Event::RunEnded(RunEnded { run: RunId::random(), ended, reason: EndReason::Finished })
    }

    #[test]
    fn events_beyond_tap_capacity_are_counted_as_missed() {
        let (sender, mut listener) = mpsc::channel(1);
        let tap = EventTap::new(sender);
        let event_queue = EventQueue::discarding().with_tap(Some(tap.clone()));
        let (first, second) = (run_ended(), run_ended());
        event_queue.push_event(None, first.clone());
        event_queue.push_event(None, second.clone());
        assert_eq!((listener.try_recv().ok(), tap.missed_events()), (Some(first), 1));
        event_queue.push_event(None, second.clone());
        assert_eq!((listener.try_recv().ok(), tap.missed_events()), (Some(second), 1));
    }

    #[test]
    fn tap_and_outbox_receive_the_event() {
        let clock: peernet_clock::SharedClock =
            Arc::new(ManualClock::new(WallTime::from_unix_nanos(5), ClockIdentity::new("boot", "system")));
        let (event_queue, mut receiver) = super::super::channel(clock, super::super::EventCounter::default());
        let (sender, mut listener) = mpsc::channel(4);
        let event_queue = event_queue.with_tap(Some(EventTap::new(sender)));
        let event = run_ended();
        event_queue.push_event(None, event.clone());
        assert_eq!(listener.try_recv().ok().as_ref(), Some(&event));
        assert_eq!(receiver.queue.try_recv().ok(), Some(event));
    }
}
