//! Events that come out of the feed.

use peernet_clock::{MonoTime, Span, Stamp};
use peernet_stream::{Accounting, Event, Sending, SentUnspooled};

use crate::event_queue::Exit;
use crate::runs::Runs;

/// Without an event for so long, the next one wakes the task, and looks cost nothing until then.
const QUIET: Span = Span::from_millis(500);

/// The end of the feed, and what is known of its runs.
#[derive(Debug)]
pub(super) struct EventIntake {
    exit: Exit,
    runs: Runs,
    /// When the feed last held an event.
    fed: MonoTime,
}

impl EventIntake {
    pub(super) const fn new(exit: Exit, runs: Runs, now: MonoTime) -> Self {
        Self { exit, runs, fed: now }
    }

    /// Whether the feed held no event for a while.
    pub(super) fn is_quiet(&self, now: MonoTime) -> bool {
        now - self.fed >= QUIET
    }

    /// Waits for the next event.
    pub(super) async fn next(&mut self) -> Option<Event> {
        self.exit.queue.recv().await
    }

    /// Hands over an event that came out of the feed.
    pub(super) fn offer(&mut self, machine: &mut Sending, event: &Event, now: Stamp) {
        self.fed = now.mono;
        machine.offer(event, now);
    }

    /// Empties the feed, and lets time pass for the machine.
    pub(super) fn drain(&mut self, machine: &mut Sending, now: Stamp) {
        while let Ok(event) = self.exit.queue.try_recv() {
            self.offer(machine, &event, now);
        }
        for gap in self.exit.overflow.take_gaps() {
            machine.lost(&gap, now);
        }
        machine.tick(now);
    }

    /// Hands over the beginnings of the runs again: the aggregator does not have what it once stored, and without the start
    /// of its run an iteration means little.
    pub(super) fn repeat_beginnings(&self, machine: &mut Sending, now: Stamp) {
        for event in self.runs.beginnings() {
            let pipeline =
                if let Event::RunStarted(started) = &event { Some(&started.pipeline) } else { None };
            self.exit.counter.count(pipeline, event.run(), now.wall);
            machine.offer(&event, now);
        }
    }

    /// Runs that have ended and are safe give their places in the counter to others.
    pub(super) fn release_runs(&self, machine: &mut Sending) {
        for (run, events) in machine.settled_runs() {
            if self.exit.counter.release(run, events) {
                machine.forget_run(run);
            }
        }
    }

    /// Adds what has not reached the machine to its account.
    pub(super) fn add_to(&self, account: &mut Accounting) {
        let (queued, dropped) = (self.exit.queue.len() as u64, self.exit.overflow.dropped());
        account.produced += queued + dropped;
        account.waiting += queued;
        account.dropped += dropped;
    }

    /// Notes a batch that is sent without being in the spool, where it outlives the process.
    pub(super) fn note_sent_unspooled(&self, sent: SentUnspooled) {
        self.exit.counter.record_sent_unspooled(sent);
    }

    /// Makes the counter's file anew when somebody has deleted it.
    pub(super) fn keep_counter(&self) {
        self.exit.counter.recreate_if_deleted();
    }

    /// Whether the events are counted where the count outlives the process.
    pub(super) fn is_counted(&self) -> bool {
        self.exit.counter.total().is_some()
    }

    /// Removes the counter if all that it counted is settled.
    pub(super) fn remove_counter(&self, settled: u64) {
        if self.exit.counter.total() == Some(settled) {
            self.exit.counter.remove();
        }
    }
}
