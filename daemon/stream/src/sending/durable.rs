//! What the durable lane hands over next.

use peernet_clock::MonoTime;

use super::super::{ToAggregator, batch_weight, codec};
use super::Sending;
use super::link::Link;
use super::rest::Rest;

/// What may be under way and not stored, in units of what may be on the way: enough for a store that takes its time and
/// for what compression saves.
const UNSTORED: u64 = 8;

impl Sending {
    /// The next of the durable lane: a batch or a part of one, or a question how it goes.
    pub(super) fn durable(&mut self, next: u64, heard: MonoTime, now: MonoTime) -> Option<Vec<u8>> {
        let part = self.flow.part();
        let fits = |bytes: usize| bytes.min(part) + Rest::OVERHEAD;
        if let Some(rest) = self.rest.as_ref().map(Rest::len) {
            return self.ask(!self.flow.has_room(fits(rest)), false, now).or_else(|| self.part(part));
        }
        let (through, unspooled) = self.sendable();
        let batch = self.backlog.get(next, unspooled).filter(|_| next <= through);
        let Some(body) = batch.map(|batch| batch.body.len()) else {
            self.pace.is_idle(self.flow.is_slow(), now);
            self.flow.is_spared();
            return self.ask(false, false, now);
        };
        if self.under_way.is_full(body, self.allowance()) {
            self.pace.is_full(now);
            self.flow.is_spared();
            return self.ask(false, false, now);
        }
        let waits = !self.flow.has_room(fits(body));
        if waits {
            self.pace.is_full(now);
        }
        if let question @ Some(_) = self.ask(waits, !waits, now) {
            return question;
        }
        if waits {
            return None;
        }
        let (head, body) = self.backlog.send(next, unspooled, (self.host.id, self.process))?;
        // Patience begins when there is something to wait for.
        let idle = next == self.backlog.oldest();
        self.link = Link::Up { next: next + 1, heard: if idle { now } else { heard } };
        let frame = codec::batch_frame(&head, &body, self.pace.compresses());
        self.under_way.push(head.number, body.len(), frame.len());
        self.rest = Some(Rest::new(head.number, frame.into()));
        self.part(part)
    }

    /// The next part of a batch, if there is room for it on the way.
    fn part(&mut self, most: usize) -> Option<Vec<u8>> {
        let rest = self.rest.as_mut()?;
        if !self.flow.has_room(rest.len().min(most) + Rest::OVERHEAD) {
            return None;
        }
        let frame = rest.next(self.host.id, most);
        let end = self.flow.hand_over(frame.len() as u64);
        if self.rest.take_if(|rest| rest.len() == 0).is_some() {
            self.under_way.handed_over(end);
        }
        Some(frame)
    }

    /// Asks how long the way is, when that is due.
    fn ask(&mut self, waits: bool, begins: bool, now: MonoTime) -> Option<Vec<u8>> {
        let bytes = self.flow.ask(waits, begins, now)?;
        Some(codec::encode(&ToAggregator::Echo { host: self.host.id, bytes }))
    }

    /// What may be under way and not stored, by weight: what is not stored in the end has to cross a slow link again.
    fn allowance(&self) -> u64 {
        let window = u64::from(self.window) * batch_weight(self.config.batch_bytes);
        if self.flow.is_slow() { window.min(UNSTORED * self.flow.allowance()) } else { window }
    }
}
