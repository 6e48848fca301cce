//! Where measuring hands over its events: never waiting, never losing one uncounted.

pub(crate) mod counter;
mod tap;

pub(crate) use self::counter::EventCounter;
pub(crate) use self::tap::EventTap;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use peernet_clock::SharedClock;
use peernet_logger::{RunId, Slug};
use peernet_stream::{Event, Gap, Iteration};
use tokio::sync::mpsc;

use crate::config::HostConfig;

/// Iterations between the pipelines and the outbox task, which looks every few milliseconds.
const PLACES: usize = 4096;
/// Places kept for other events: without the start of its run an iteration means nothing.
const RESERVE: usize = 512;

/// Where events go in; clones are the same.
#[derive(Clone, Debug)]
pub(crate) struct EventQueue {
    /// To the outbox; `None` for an agent without an aggregator.
    outbox: Option<Arc<Entrance>>,
    /// To the program that runs the agent; `None` when it does not listen.
    tap: Option<EventTap>,
}

#[derive(Debug)]
struct Entrance {
    queue: mpsc::Sender<Event>,
    overflow: Arc<Overflow>,
    counter: EventCounter,
}

/// The outbox task's end: what came in, and what did not fit.
#[derive(Debug)]
pub(crate) struct Exit {
    pub(crate) queue: mpsc::Receiver<Event>,
    pub(crate) overflow: Arc<Overflow>,
    pub(crate) counter: EventCounter,
}

/// What was dropped for want of a place.
#[derive(Debug)]
pub(crate) struct Overflow {
    clock: SharedClock,
    /// How many since they were last taken.
    dropped: AtomicU64,
    /// Which, by pipeline and run.
    gaps: Mutex<BTreeMap<Origin, Gap>>,
}

/// Pipeline and run.
type Origin = (Option<Slug>, Option<RunId>);

/// An entrance and an exit with a queue between them.
pub(crate) fn channel(clock: SharedClock, counter: EventCounter) -> (EventQueue, Exit) {
    let (sender, queue) = mpsc::channel(PLACES + RESERVE);
    let overflow = Arc::new(Overflow { clock, dropped: AtomicU64::new(0), gaps: Mutex::default() });
    let entrance = Entrance { queue: sender, overflow: Arc::clone(&overflow), counter: counter.clone() };
    (EventQueue { outbox: Some(Arc::new(entrance)), tap: None }, Exit { queue, overflow, counter })
}

impl EventQueue {
    /// A feed into nothing, for an agent without an aggregator.
    pub(crate) const fn nowhere() -> Self {
        Self { outbox: None, tap: None }
    }

    /// The same feed, of which every event also goes to `tap`.
    pub(crate) fn tapped(self, tap: Option<EventTap>) -> Self {
        Self { tap, ..self }
    }

    /// Hands in an iteration of `pipeline`.
    pub(crate) fn iteration(&self, pipeline: &Slug, iteration: Iteration) {
        let run = iteration.run;
        let Some(event) = self.tap(Event::Iteration(iteration)) else { return };
        let Some(entrance) = &self.outbox else { return };
        entrance.count(Some(pipeline), Some(run));
        // Looking and sending are two steps: each thread that hands in at the same moment may take one place of the
        // reserve, which is larger than there are such threads.
        let room = entrance.queue.capacity() > RESERVE;
        if !room || entrance.queue.try_send(event).is_err() {
            entrance.overflow.count(Some(pipeline), Some(run));
        }
    }

    /// Hands in anything else, which concerns `pipeline` or none.
    pub(crate) fn event(&self, pipeline: Option<&Slug>, event: Event) {
        let run = event.run();
        let Some(event) = self.tap(event) else { return };
        let Some(entrance) = &self.outbox else { return };
        entrance.count(pipeline, run);
        if entrance.queue.try_send(event).is_err() {
            entrance.overflow.count(pipeline, run);
        }
    }

    /// Shows the event to whoever listens, and gives it back if the outbox wants it, too.
    fn tap(&self, event: Event) -> Option<Event> {
        let Some(tap) = &self.tap else { return Some(event) };
        if self.outbox.is_none() {
            tap.offer(event);
            return None;
        }
        tap.offer(event.clone());
        Some(event)
    }
}

impl Entrance {
    /// Before it is handed in: from then on it can be lost.
    fn count(&self, pipeline: Option<&Slug>, run: Option<RunId>) {
        self.counter.count(pipeline, run, self.overflow.clock.wall());
    }
}

/// Where events go in, counted by `counter`, and the end at which the outbox takes them out; nowhere without an
/// aggregator.
pub(crate) fn entrance(
    config: &HostConfig,
    clock: &SharedClock,
    counter: EventCounter,
) -> (EventQueue, Option<Exit>) {
    if config.aggregator.is_none() {
        return (EventQueue::nowhere(), None);
    }
    let (event_queue, exit) = channel(SharedClock::clone(clock), counter);
    (event_queue, Some(exit))
}

#[cfg(test)]
impl Exit {
    /// The next event.
    pub(crate) async fn next(&mut self) -> Option<Event> {
        self.queue.recv().await
    }
}

impl Overflow {
    /// Events that were dropped and not taken yet.
    pub(crate) fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Takes what was dropped since the last call, to be reported.
    pub(crate) fn take_gaps(&self) -> Vec<Gap> {
        // Nearly always nothing was dropped: no lock then.
        if self.dropped() == 0 {
            return Vec::new();
        }
        let gaps = std::mem::take(&mut *self.gaps.lock().unwrap_or_else(PoisonError::into_inner));
        let gaps: Vec<Gap> = gaps.into_values().collect();
        self.dropped.fetch_sub(gaps.iter().map(|gap| gap.count).sum(), Ordering::Relaxed);
        gaps
    }

    fn count(&self, pipeline: Option<&Slug>, run: Option<RunId>) {
        let now = self.clock.wall();
        let mut gaps = self.gaps.lock().unwrap_or_else(PoisonError::into_inner);
        self.dropped.fetch_add(1, Ordering::Relaxed);
        let gap = gaps.entry((pipeline.cloned(), run)).or_insert_with(|| Gap {
            pipeline: pipeline.cloned(),
            run,
            from: now,
            to: now,
            count: 0,
            reason: "the agent made events faster than it could queue them".to_owned(),
        });
        gap.count += 1;
        gap.to = now;
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{Clock, ClockIdentity, ManualClock, Span, WallTime};
    use peernet_logger::{HostId, Recorder};
    use peernet_stream::{EndReason, Outcome, RunEnded};

    use super::*;

    fn iteration(clock: &Arc<ManualClock>, run: RunId, number: u64) -> Iteration {
        let tree = Recorder::begin(Arc::<ManualClock>::clone(clock), HostId::random()).finish();
        Iteration { run, number, episode: 0, step: 0, warm_up: false, outcome: Outcome::Ok, tree }
    }

    #[test]
    fn what_does_not_fit_is_counted_by_run_and_the_end_of_a_run_still_gets_through() {
        let clock =
            Arc::new(ManualClock::new(WallTime::from_unix_nanos(5), ClockIdentity::new("boot", "system")));
        let (event_queue, exit) = channel(Arc::<ManualClock>::clone(&clock), EventCounter::default());
        let (pipeline, run): (Slug, _) = ("line".parse().expect("a name"), RunId::random());
        let offered = PLACES as u64 + 2;
        for number in 1..=offered {
            clock.advance(Span::from_nanos(10));
            event_queue.iteration(&pipeline, iteration(&clock, run, number));
        }
        let ended = RunEnded { run, ended: clock.wall(), reason: EndReason::Stopped };
        event_queue.event(Some(&pipeline), Event::RunEnded(ended));

        assert_eq!((exit.queue.len(), exit.overflow.dropped()), (PLACES + 1, 2));
        let gaps = exit.overflow.take_gaps();
        assert_eq!(gaps.len(), 1);
        assert_eq!((gaps[0].count, gaps[0].run, gaps[0].pipeline.as_ref()), (2, Some(run), Some(&pipeline)));
        assert_eq!(gaps[0].to - gaps[0].from, Span::from_nanos(10));
        assert!(exit.overflow.take_gaps().is_empty());
    }
}
