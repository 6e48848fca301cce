//! Bytes in flight to the other end.

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Span};

/// Without word from the other end for so long, what was sent is taken for arrived or lost.
pub(super) const SILENCE: Span = Span::from_millis(200);

/// Bytes of datagrams that have left, and of those that arrived by the other end's reports of progress.
#[derive(Debug)]
pub(super) struct BytesInFlight {
    sent: u64,
    /// At most `sent`.
    arrived: u64,
    /// The datagrams in flight, in the order in which they left.
    marks: VecDeque<Mark>,
    /// When the other end last came further, or the first of these datagrams left.
    heard: MonoTime,
}

/// A datagram in flight.
#[derive(Clone, Copy, Debug)]
struct Mark {
    /// Its message, and where its part of the message ends.
    end: (u64, u32),
    /// Bytes that had left with it.
    sent: u64,
}

impl BytesInFlight {
    pub(super) const fn new(now: MonoTime) -> Self {
        Self { sent: 0, arrived: 0, marks: VecDeque::new(), heard: now }
    }

    /// Bytes in flight.
    pub(super) const fn bytes(&self) -> u64 {
        self.sent - self.arrived
    }

    /// All bytes that have left.
    pub(super) const fn sent(&self) -> u64 {
        self.sent
    }

    /// All bytes that have left and are not in flight any more.
    pub(super) const fn arrived(&self) -> u64 {
        self.arrived
    }

    /// When the bytes in flight are taken for arrived or lost.
    pub(super) fn ends_at(&self) -> MonoTime {
        self.heard + SILENCE
    }

    /// Notes a datagram that left, and where its part of a message ends.
    pub(super) fn send(&mut self, end: (u64, u32), bytes: u32, now: MonoTime) {
        // Silence counts while something is in flight only.
        if self.bytes() == 0 {
            self.heard = now;
        }
        self.sent += u64::from(bytes);
        self.marks.push_back(Mark { end, sent: self.sent });
    }

    /// Takes a report of progress. Returns the bytes that arrived since the last one.
    pub(super) fn progress(&mut self, end: (u64, u32), now: MonoTime) -> u64 {
        let before = self.arrived;
        while let Some(mark) = self.marks.pop_front_if(|mark| mark.end <= end) {
            self.arrived = mark.sent;
        }
        let arrived = self.arrived - before;
        if arrived > 0 {
            self.heard = now;
        }
        arrived
    }

    /// Takes the bytes in flight for arrived or lost after a long silence.
    pub(super) fn tick(&mut self, now: MonoTime) {
        if self.bytes() > 0 && now >= self.ends_at() {
            self.arrived = self.sent;
            self.marks.clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> MonoTime {
        MonoTime::default() + Span::from_millis(millis)
    }

    #[test]
    fn progress_takes_all_datagrams_up_to_its_end() {
        let mut in_flight = BytesInFlight::new(at(0));
        for end in [(0, 100), (0, 200), (1, 50)] {
            in_flight.send(end, 110, at(0));
        }
        assert_eq!(in_flight.progress((0, 99), at(1)), 0);
        assert_eq!(in_flight.progress((0, 300), at(2)), 220);
        assert_eq!(in_flight.progress((0, 300), at(3)), 0, "an older one changes nothing");
        assert_eq!((in_flight.bytes(), in_flight.ends_at()), (110, at(202)));
        assert_eq!(in_flight.progress((1, 50), at(4)), 110);
        assert_eq!((in_flight.sent(), in_flight.arrived()), (330, 330));
    }

    #[test]
    fn silence_takes_what_is_on_its_way_for_gone() {
        let mut in_flight = BytesInFlight::new(at(0));
        in_flight.send((0, 1), 10, at(100));
        in_flight.tick(at(299));
        assert_eq!(in_flight.bytes(), 10);
        in_flight.tick(at(300));
        assert_eq!(in_flight.bytes(), 0);
        assert_eq!(in_flight.progress((0, 1), at(301)), 0, "late word");
    }
}
