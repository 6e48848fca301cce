//! Moves events from the queue to the state machine.

use peernet_clock::{MonoTime, Span, Stamp};
use peernet_stream::{Accounting, Event, Sending, SentUnspooled};

use crate::event_queue::QueueReceiver;
use crate::runs::Runs;

/// Time without an event after which the task waits for the next event instead of polling the queue.
const IDLE_AFTER: Span = Span::from_millis(500);

/// Receiving end of the event queue, and the runs in progress.
#[derive(Debug)]
pub(super) struct EventIntake {
    receiver: QueueReceiver,
    runs: Runs,
    /// Time at which the latest event was received.
    latest_event: MonoTime,
}

impl EventIntake {
    pub(super) const fn new(receiver: QueueReceiver, runs: Runs, now: MonoTime) -> Self {
        Self { receiver, runs, latest_event: now }
    }

    /// Returns whether no event was received for [`IDLE_AFTER`].
    pub(super) fn is_quiet(&self, now: MonoTime) -> bool {
        now - self.latest_event >= IDLE_AFTER
    }

    /// Waits for the next event.
    pub(super) async fn next(&mut self) -> Option<Event> {
        self.receiver.queue.recv().await
    }

    /// Passes a received event to the state machine.
    pub(super) fn offer(&mut self, state_machine: &mut Sending, event: &Event, now: Stamp) {
        self.latest_event = now.mono;
        state_machine.offer(event, now);
    }

    /// Passes all queued events to the state machine, records the events that did not fit into the queue, and advances
    /// the state machine's time.
    pub(super) fn drain(&mut self, state_machine: &mut Sending, now: Stamp) {
        while let Ok(event) = self.receiver.queue.try_recv() {
            self.offer(state_machine, &event, now);
        }
        for gap in self.receiver.overflow.take_gaps() {
            state_machine.record_loss(&gap, now);
        }
        state_machine.tick(now);
    }

    /// Offers the starts of the runs in progress again, because the aggregator may not have these starts.
    // Without the start of its run, the configuration of an iteration is unknown.
    pub(super) fn repeat_run_starts(&self, state_machine: &mut Sending, now: Stamp) {
        for event in self.runs.start_events() {
            let pipeline =
                if let Event::RunStarted(started) = &event { Some(&started.pipeline) } else { None };
            // The state machine gets this event a second time, so it is counted a second time.
            self.receiver.counter.count(pipeline, event.run(), now.wall);
            state_machine.offer(&event, now);
        }
    }

    /// Frees the counter's records of ended runs whose events are all settled. An event is settled if it is in the
    /// spool, if the aggregator stored it, or if it was dropped.
    pub(super) fn release_runs(&self, state_machine: &mut Sending) {
        for (run, events) in state_machine.settled_runs() {
            if self.receiver.counter.release_if_settled(run, events) {
                state_machine.forget_run(run);
            }
        }
    }

    /// Adds the events of the queue, which have not reached the state machine, to the counts of the state machine.
    pub(super) fn add_queue_counts(&self, accounting: &mut Accounting) {
        let (queued_events, dropped_events) =
            (self.receiver.queue.len() as u64, self.receiver.overflow.dropped());
        accounting.produced += queued_events + dropped_events;
        accounting.waiting += queued_events;
        accounting.dropped += dropped_events;
    }

    /// Records, in the counter's file, a batch that is sent without being in the spool.
    pub(super) fn record_sent_unspooled(&self, sent: SentUnspooled) {
        self.receiver.counter.record_sent_unspooled(sent);
    }

    /// Creates the counter's file again if it was deleted.
    pub(super) fn recreate_counter_if_deleted(&self) {
        self.receiver.counter.recreate_if_deleted();
    }

    /// Returns whether the events are counted in a file that survives the process.
    pub(super) fn has_counter_file(&self) -> bool {
        self.receiver.counter.total().is_some()
    }

    /// Removes the counter if all counted events are settled ([`Self::release_runs`]). `settled` is the number of
    /// settled events.
    pub(super) fn remove_counter(&self, settled: u64) {
        if self.receiver.counter.total() == Some(settled) {
            self.receiver.counter.remove();
        }
    }
}
