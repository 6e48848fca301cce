//! Copies of events for a program that runs the agent in the foreground.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use peernet_stream::Event;
use tokio::sync::mpsc;

/// Channel to the program that runs the agent. Clones share the channel. Sending never waits.
#[derive(Clone, Debug)]
pub(crate) struct EventTap {
    sender: mpsc::Sender<Event>,
    missed_event_counters: MissedEventCounters,
}

/// Counters of the events that did not fit into the channel to the program that runs the agent.
/// Clones share the counters, so a clone can still be read after the agent has ended.
#[derive(Clone, Debug, Default)]
pub struct MissedEventCounters {
    iterations: Arc<AtomicU64>,
    others: Arc<AtomicU64>,
}

/// Numbers of events that did not fit into the channel to the program that runs the agent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MissedEvents {
    /// Number of iterations.
    pub iterations: u64,
    /// Number of events that are not iterations, such as clock samples and incidents.
    pub others: u64,
}

impl EventTap {
    pub(crate) fn new(sender: mpsc::Sender<Event>) -> Self {
        Self { sender, missed_event_counters: MissedEventCounters::default() }
    }

    /// Sends an event, or counts it as missed if the channel is full.
    pub(super) fn offer(&self, event: Event) {
        let MissedEventCounters { iterations, others } = &self.missed_event_counters;
        let counter = if matches!(event, Event::Iteration(_)) { iterations } else { others };
        if self.sender.try_send(event).is_err() {
            counter.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Returns the counters of the events that did not fit into the channel.
    pub(crate) fn missed_event_counters(&self) -> MissedEventCounters {
        self.missed_event_counters.clone()
    }
}

impl MissedEventCounters {
    /// Returns the numbers of events that did not fit into the channel so far.
    pub fn read(&self) -> MissedEvents {
        MissedEvents {
            iterations: self.iterations.load(Ordering::Relaxed),
            others: self.others.load(Ordering::Relaxed),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, ManualClock, WallTime};
    use peernet_logger::{HostId, Recorder, RunId};
    use peernet_stream::{EndReason, Iteration, Outcome, RunEnded};

    use super::super::EventQueue;
    use super::*;

    fn run_ended() -> Event {
        let ended = WallTime::from_unix_nanos(1);
        Event::RunEnded(RunEnded { run: RunId::random(), ended, reason: EndReason::Finished })
    }

    fn iteration(number: u64) -> Iteration {
        let clock = ManualClock::new(WallTime::from_unix_nanos(1), ClockIdentity::new("boot", "system"));
        let tree = Recorder::new(Arc::new(clock), HostId::random()).finish();
        let (run, outcome) = (RunId::random(), Outcome::Ok);
        Iteration { run, number, episode: 0, step: 0, warm_up: false, outcome, tree }
    }

    #[test]
    fn events_beyond_tap_capacity_are_counted_as_missed() {
        let (sender, mut listener) = mpsc::channel(1);
        let tap = EventTap::new(sender);
        let counters = tap.missed_event_counters();
        let event_queue = EventQueue::discarding().with_tap(Some(tap));
        let (first, second) = (run_ended(), run_ended());
        event_queue.push_event(None, first.clone());
        event_queue.push_event(None, second.clone());
        let missed = MissedEvents { iterations: 0, others: 1 };
        assert_eq!((listener.try_recv().ok(), counters.read()), (Some(first), missed));
        event_queue.push_event(None, second.clone());
        assert_eq!((listener.try_recv().ok(), counters.read()), (Some(second), missed));
    }

    #[test]
    fn missed_iterations_are_counted_separately() {
        let (sender, _listener) = mpsc::channel(1);
        let tap = EventTap::new(sender);
        let counters = tap.missed_event_counters();
        let event_queue = EventQueue::discarding().with_tap(Some(tap));
        let pipeline = "line".parse().expect("a name");
        // The first event fills the channel.
        event_queue.push_event(None, run_ended());
        for number in [1, 2] {
            event_queue.push_iteration(&pipeline, iteration(number));
        }
        event_queue.push_event(None, run_ended());
        assert_eq!(counters.read(), MissedEvents { iterations: 2, others: 1 });
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
