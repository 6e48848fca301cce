//! The queue between the tasks that create events and the outbox.
//!
//! Adding an event never waits. Every event that does not fit is counted.

pub(crate) mod counter;
mod tap;

pub(crate) use self::counter::EventCounter;
pub(crate) use self::tap::EventTap;
pub use self::tap::{MissedEventCounters, MissedEvents};

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use peernet_clock::SharedClock;
use peernet_logger::{RunId, Slug};
use peernet_stream::{Event, Gap, Iteration};
use tokio::sync::mpsc;

use crate::config::HostConfig;

/// Number of events up to which the queue accepts iterations. The outbox empties the queue every few milliseconds.
const ITERATION_CAPACITY: usize = 4096;
/// Further capacity, reserved for events that are not iterations, because an iteration is useless without the start of
/// its run.
const RESERVED_CAPACITY: usize = 512;

/// Sending end of the queue. Clones share the queue.
#[derive(Clone, Debug)]
pub(crate) struct EventQueue {
    /// Channel to the outbox; `None` for an agent without an aggregator.
    outbox: Option<Arc<QueueSender>>,
    /// Channel to the program that runs the agent; `None` if that program does not receive the events.
    tap: Option<EventTap>,
}

#[derive(Debug)]
struct QueueSender {
    queue: mpsc::Sender<Event>,
    overflow: Arc<Overflow>,
    counter: EventCounter,
}

/// Receiving end of the queue, with the count of events that did not fit.
#[derive(Debug)]
pub(crate) struct QueueReceiver {
    pub(crate) queue: mpsc::Receiver<Event>,
    pub(crate) overflow: Arc<Overflow>,
    pub(crate) counter: EventCounter,
}

/// Events that were dropped because the queue was full.
#[derive(Debug)]
pub(crate) struct Overflow {
    clock: SharedClock,
    /// Number of events that were dropped since the last [`take_gaps`](Self::take_gaps).
    dropped: AtomicU64,
    /// Gaps by pipeline and run.
    gaps: Mutex<BTreeMap<Origin, Gap>>,
}

/// Pipeline and run that an event concerns.
type Origin = (Option<Slug>, Option<RunId>);

/// Creates a queue and returns its two ends.
pub(crate) fn channel(clock: SharedClock, counter: EventCounter) -> (EventQueue, QueueReceiver) {
    let (sender, queue) = mpsc::channel(ITERATION_CAPACITY + RESERVED_CAPACITY);
    let overflow = Arc::new(Overflow { clock, dropped: AtomicU64::new(0), gaps: Mutex::default() });
    let queue_sender =
        QueueSender { queue: sender, overflow: Arc::clone(&overflow), counter: counter.clone() };
    (
        EventQueue { outbox: Some(Arc::new(queue_sender)), tap: None },
        QueueReceiver { queue, overflow, counter },
    )
}

impl EventQueue {
    /// Returns a queue that discards its events, for an agent without an aggregator.
    pub(crate) const fn discarding() -> Self {
        Self { outbox: None, tap: None }
    }

    /// Returns this queue with a tap, which receives a copy of each event.
    pub(crate) fn with_tap(self, tap: Option<EventTap>) -> Self {
        Self { tap, ..self }
    }

    /// Queues an iteration of `pipeline`.
    pub(crate) fn push_iteration(&self, pipeline: &Slug, iteration: Iteration) {
        let run = iteration.run;
        let Some(event) = self.send_to_tap(Event::Iteration(iteration)) else { return };
        let Some(queue_sender) = &self.outbox else { return };
        queue_sender.count(Some(pipeline), Some(run));
        // Checking the capacity and sending are two steps. Between these steps each other thread may use one reserved
        // place; there are more reserved places than threads.
        let has_capacity = queue_sender.queue.capacity() > RESERVED_CAPACITY;
        if !has_capacity || queue_sender.queue.try_send(event).is_err() {
            queue_sender.overflow.count(Some(pipeline), Some(run));
        }
    }

    /// Queues an event that is not an iteration; `pipeline` is the pipeline that it concerns, if any.
    pub(crate) fn push_event(&self, pipeline: Option<&Slug>, event: Event) {
        let run = event.run();
        let Some(event) = self.send_to_tap(event) else { return };
        let Some(queue_sender) = &self.outbox else { return };
        queue_sender.count(pipeline, run);
        if queue_sender.queue.try_send(event).is_err() {
            queue_sender.overflow.count(pipeline, run);
        }
    }

    /// Sends the event to the tap, if there is one. Returns the event if it goes to the outbox.
    fn send_to_tap(&self, event: Event) -> Option<Event> {
        let Some(tap) = &self.tap else { return Some(event) };
        if self.outbox.is_none() {
            tap.offer(event);
            return None;
        }
        tap.offer(event.clone());
        Some(event)
    }
}

impl QueueSender {
    /// Counts an event. Called before the event is queued, because a kill of the process can lose a queued event.
    fn count(&self, pipeline: Option<&Slug>, run: Option<RunId>) {
        self.counter.count(pipeline, run, self.overflow.clock.wall());
    }
}

/// Creates the queue of an agent, whose events are counted by `counter`. Without an aggregator the queue discards its
/// events and has no receiving end.
pub(crate) fn create(
    config: &HostConfig,
    clock: &SharedClock,
    counter: EventCounter,
) -> (EventQueue, Option<QueueReceiver>) {
    if config.aggregator.is_none() {
        return (EventQueue::discarding(), None);
    }
    let (event_queue, receiver) = channel(SharedClock::clone(clock), counter);
    (event_queue, Some(receiver))
}

#[cfg(test)]
impl QueueReceiver {
    /// Waits for the next event.
    pub(crate) async fn next(&mut self) -> Option<Event> {
        self.queue.recv().await
    }
}

impl Overflow {
    /// Returns the number of dropped events whose gaps were not taken yet.
    pub(crate) fn dropped(&self) -> u64 {
        // A drop that this thread does not see yet is taken by the next call of `take_gaps`.
        self.dropped.load(Ordering::Relaxed)
    }

    /// Removes and returns the gaps since the last call.
    pub(crate) fn take_gaps(&self) -> Vec<Gap> {
        // Usually nothing was dropped: then the lock is not taken.
        if self.dropped() == 0 {
            return Vec::new();
        }
        let gaps = std::mem::take(&mut *self.gaps.lock().unwrap_or_else(PoisonError::into_inner));
        let gaps: Vec<Gap> = gaps.into_values().collect();
        self.dropped.fetch_sub(gaps.iter().map(|gap| gap.count).sum(), Ordering::Relaxed);
        gaps
    }

    /// Counts a dropped event in the gap of its pipeline and run.
    fn count(&self, pipeline: Option<&Slug>, run: Option<RunId>) {
        let now = self.clock.wall();
        let mut gaps = self.gaps.lock().unwrap_or_else(PoisonError::into_inner);
        // The drop is added under the lock, so that `take_gaps` cannot subtract it before it is added.
        self.dropped.fetch_add(1, Ordering::Relaxed);
        let gap = gaps.entry((pipeline.cloned(), run)).or_insert_with(|| Gap {
            pipeline: pipeline.cloned(),
            run,
            from: now,
            to: now,
            count: 0,
            reason: "the event queue of the agent was full".to_owned(),
        });
        gap.count += 1;
        // The wall clock may have been set back since the first drop.
        (gap.from, gap.to) = (gap.from.min(now), gap.to.max(now));
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{Clock, ClockIdentity, ManualClock, Span, WallTime};
    use peernet_logger::{HostId, Recorder};
    use peernet_stream::{EndReason, Outcome, RunEnded};

    use super::*;

    fn iteration(clock: &Arc<ManualClock>, run: RunId, number: u64) -> Iteration {
        let tree = Recorder::new(Arc::<ManualClock>::clone(clock), HostId::random()).finish();
        Iteration { run, number, episode: 0, step: 0, warm_up: false, outcome: Outcome::Ok, tree }
    }

    #[test]
    fn overflow_is_counted_by_run_and_run_end_fits() {
        let clock =
            Arc::new(ManualClock::new(WallTime::from_unix_nanos(5), ClockIdentity::new("boot", "system")));
        let (event_queue, receiver) = channel(Arc::<ManualClock>::clone(&clock), EventCounter::default());
        let (pipeline, run): (Slug, _) = ("line".parse().expect("a name"), RunId::random());
        let offered = ITERATION_CAPACITY as u64 + 2;
        for number in 1..=offered {
            clock.advance(Span::from_nanos(10));
            event_queue.push_iteration(&pipeline, iteration(&clock, run, number));
        }
        let ended = RunEnded { run, ended: clock.wall(), reason: EndReason::Stopped };
        event_queue.push_event(Some(&pipeline), Event::RunEnded(ended));

        assert_eq!((receiver.queue.len(), receiver.overflow.dropped()), (ITERATION_CAPACITY + 1, 2));
        let gaps = receiver.overflow.take_gaps();
        assert_eq!(gaps.len(), 1);
        assert_eq!((gaps[0].count, gaps[0].run, gaps[0].pipeline.as_ref()), (2, Some(run), Some(&pipeline)));
        assert_eq!(gaps[0].to - gaps[0].from, Span::from_nanos(10));
        assert!(receiver.overflow.take_gaps().is_empty());
    }

    #[test]
    fn gap_ends_after_its_start_although_clock_is_set_back() {
        let wall = WallTime::from_unix_nanos;
        let clock = Arc::new(ManualClock::new(wall(500), ClockIdentity::new("boot", "system")));
        let (event_queue, receiver) = channel(Arc::<ManualClock>::clone(&clock), EventCounter::default());
        let (pipeline, run): (Slug, _) = ("line".parse().expect("a name"), RunId::random());
        let dropped_before_step = ITERATION_CAPACITY as u64 + 1;
        for number in 1..=dropped_before_step {
            event_queue.push_iteration(&pipeline, iteration(&clock, run, number));
        }
        clock.step_wall(Span::from_nanos(-100));
        event_queue.push_iteration(&pipeline, iteration(&clock, run, dropped_before_step + 1));
        let gaps = receiver.overflow.take_gaps();
        assert_eq!((gaps[0].from, gaps[0].to, gaps[0].count), (wall(400), wall(500), 2));
    }
}
