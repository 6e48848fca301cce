//! The two lanes: events on their way through the machine, the spool and the connection; live figures beside them.

use peernet_clock::Stamp;
use peernet_stream::{Action, Event, ToAggregator, codec};

use super::Sender;
use crate::live::Receipt;
use crate::outbox::connection::Connection;
use crate::outbox::line::Line;
use crate::outbox::spool::{Done, Order, SpoolTaskError};

impl Sender {
    /// Empties the feed, and lets time pass for the machine.
    pub(super) fn take(&mut self) {
        let now = self.clock.stamp();
        while let Ok(event) = self.exit.queue.try_recv() {
            self.offer(&event, now);
        }
        for gap in self.exit.overflow.take_gaps() {
            self.machine.lost(&gap, now);
        }
        self.machine.tick(now);
    }

    /// An event came out of the feed.
    pub(super) fn offer(&mut self, event: &Event, now: Stamp) {
        self.fed = now.mono;
        self.machine.offer(event, now);
    }

    /// Does what the machine wants.
    pub(super) fn act(&mut self, line: &Line) -> Result<(), SpoolTaskError> {
        if self.due
            && let Line::Open(connection) = line
        {
            self.show(connection);
        }
        while let Some(action) = self.machine.next(self.clock.mono()) {
            let order = match action {
                Action::Send(frame) => {
                    if let Some(sent) = self.machine.sent_unspooled() {
                        self.exit.counter.sent_unspooled(sent);
                    }
                    self.held.push_back(frame);
                    continue;
                }
                Action::Append { batches, totals } => Order::Append { batches, totals },
                Action::Load { from, bytes } => Order::Load { from, bytes },
                Action::Delete { through, chain } => Order::Delete { through, chain },
                Action::Renew { stream, previous, first, events_before_first } => {
                    Order::Renew { stream, previous, first, events_before_first }
                }
            };
            self.spool.order(order)?;
        }
        let Line::Open(connection) = line else { return Ok(()) };
        while let Some(frame) = self.held.pop_front() {
            if let Err(back) = connection.send(frame) {
                self.held.push_front(back);
                break;
            }
        }
        Ok(())
    }

    /// The spool's task did something.
    pub(super) fn spooled(&mut self, done: Done) {
        let now = self.clock.stamp();
        let notice = match done {
            Done::Appended(Ok(())) => {
                let notice = self.machine.appended(now);
                self.release_runs();
                notice
            }
            Done::Appended(Err(reason)) => self.machine.append_failed(reason.to_string(), now),
            Done::Loaded(Ok(loaded)) => {
                if let Some(what) = loaded.rotten {
                    self.reports.rotten(what);
                }
                self.machine.loaded(loaded.batches, now)
            }
            Done::Loaded(Err(reason)) => self.machine.load_failed(reason.to_string(), now),
            Done::Deleted(Ok(())) => {
                self.machine.deleted();
                None
            }
            Done::Deleted(Err(reason)) => self.machine.delete_failed(reason.to_string(), now),
            Done::Renewed(Ok(())) => {
                self.machine.renewed(now);
                None
            }
            Done::Renewed(Err(reason)) => self.machine.renew_failed(reason.to_string(), now),
        };
        if let Some(notice) = notice {
            self.noticed(notice);
        }
    }

    /// Runs that have ended and are safe give their places in the counter to others.
    fn release_runs(&mut self) {
        for (run, events) in self.machine.settled_runs() {
            if self.exit.counter.release(run, events) {
                self.machine.forget_run(run);
            }
        }
    }

    /// Sends a live update, before all that waits for the connection: it is worth nothing later. On a slow link it is
    /// made when it can go, not earlier.
    fn show(&mut self, connection: &Connection) {
        if !self.machine.is_up() {
            // The aggregator wants none.
            self.due = false;
            return;
        }
        self.blocked = false;
        if !self.machine.may_show() {
            return;
        }
        let (frame, receipt) = self.update();
        let bytes = frame.len();
        self.blocked = connection.send(frame).is_err();
        if !self.blocked {
            self.due = false;
            self.machine.shown(bytes);
            self.live.board.delivered(&receipt);
        }
    }

    /// How everything is now.
    fn update(&self) -> (Vec<u8>, Receipt) {
        let (update, receipt) = self.live.update(self.machine.host(), self.clock.wall(), self.count());
        let message = ToAggregator::Live(update);
        let frame =
            if self.machine.compresses() { codec::encode_packed(&message) } else { codec::encode(&message) };
        (frame, receipt)
    }

    /// What is said when everything has ended: how it ended, and goodbye. The aggregator hears of this host no more, and
    /// shows for good what it heard last.
    pub(super) fn last_words(&mut self) -> Vec<Vec<u8>> {
        let update = self.machine.is_up().then(|| self.update().0);
        update.into_iter().chain(self.machine.goodbye()).collect()
    }
}
