//! How much may be sent now: what the other end's socket buffer holds, what arrived lately, and a configured rate.
//!
//! The other end says how many bytes may be on their way to it and how far it has come. Within that the window grows
//! with what arrives and is halved when messages are lost, much as TCP's does (RFC 5681), so that the rate follows the
//! slowest link on the way. After a loss it grows with time and not with what arrives, as CUBIC's does (RFC 9438): every
//! loss costs a whole message, so the size that was too much is tried again after seconds and not within the next message.

use std::collections::VecDeque;

use peernet_clock::{MonoTime, Span};

use super::packet::Terms;

/// Bytes that an end receives before it says how far it has come.
pub(crate) const PROGRESS_BYTES: u32 = 16 * 1024;

/// The least that may be on its way: more than goes unsaid for.
const MIN_WINDOW: u32 = 4 * PROGRESS_BYTES;

/// What may be on its way at first.
const FIRST_WINDOW: u32 = 256 * 1024;

/// Without word from the other end for so long, what was sent is taken for arrived or lost.
const SILENCE: Span = Span::from_millis(200);

/// How far ahead of the configured rate sending may be.
const BURST: Span = Span::from_millis(2);

/// Growth in a second after a loss, as a part of the size: it doubles in three seconds.
const GROWTH_AFTER_LOSS: f64 = 0.25;

/// The state of one direction of a connection.
#[derive(Debug)]
pub(crate) struct SendWindow {
    most: u32,
    size: u32,
    /// Below it the window doubles with each round trip.
    threshold: u32,
    sent: u64,
    arrived: u64,
    /// Sequence, end in its message, and position in the stream of all bytes of each datagram on its way.
    marks: VecDeque<(u64, u32, u64)>,
    heard: MonoTime,
    /// When something last arrived.
    progressed: MonoTime,
    /// What was on its way at the last loss: what is lost of it counts once.
    recovery: u64,
    bytes_per_second: Option<u64>,
    /// When the configured rate allows the next datagram.
    next: MonoTime,
}

impl SendWindow {
    /// A window for the other end's terms; `bits_per_second` is the configured rate.
    pub(crate) fn new(terms: Terms, bits_per_second: Option<u64>, now: MonoTime) -> Self {
        let most = terms.window.max(MIN_WINDOW);
        Self {
            most,
            size: FIRST_WINDOW.min(most),
            threshold: most,
            sent: 0,
            arrived: 0,
            marks: VecDeque::new(),
            heard: now,
            progressed: now,
            recovery: 0,
            bytes_per_second: bits_per_second.map(|bits| (bits / 8).max(1)),
            next: now,
        }
    }

    /// Bytes that may be on their way.
    #[cfg(test)]
    pub(crate) const fn size(&self) -> u32 {
        self.size
    }

    /// Whether another datagram may leave now.
    pub(crate) fn is_open(&self, now: MonoTime) -> bool {
        self.sent - self.arrived < u64::from(self.size) && self.next <= now + BURST
    }

    /// When it may be open again, if nothing is heard until then.
    pub(crate) fn opens_at(&self) -> MonoTime {
        if self.sent - self.arrived >= u64::from(self.size) {
            return self.heard + SILENCE;
        }
        self.next - BURST
    }

    /// A datagram left, with the part of a message that ends there.
    pub(crate) fn sent(&mut self, sequence: u64, end: u32, bytes: u32, now: MonoTime) {
        if self.sent == self.arrived {
            self.heard = now;
        }
        self.sent += u64::from(bytes);
        self.marks.push_back((sequence, end, self.sent));
        if let Some(rate) = self.bytes_per_second {
            let nanos = u64::from(bytes).saturating_mul(1_000_000_000) / rate;
            self.next = self.next.max(now) + Span::from_nanos(i64::try_from(nanos).unwrap_or(i64::MAX));
        }
    }

    /// The other end has come so far.
    pub(crate) fn progress(&mut self, sequence: u64, end: u32, now: MonoTime) {
        let before = self.arrived;
        while let Some((marked, at, position)) = self.marks.front().copied()
            && (marked, at) <= (sequence, end)
        {
            self.arrived = position;
            self.marks.pop_front();
        }
        let arrived = self.arrived - before;
        if arrived == 0 {
            return;
        }
        let growth = if self.size < self.threshold {
            arrived
        } else {
            let elapsed = (now - self.progressed).min(SILENCE).seconds();
            (f64::from(self.size) * GROWTH_AFTER_LOSS * elapsed).round() as u64
        };
        (self.heard, self.progressed) = (now, now);
        self.size = u64::from(self.size).saturating_add(growth).min(u64::from(self.most)) as u32;
    }

    /// A message was lost on the way.
    pub(crate) fn lost(&mut self) {
        if self.arrived < self.recovery {
            return;
        }
        self.recovery = self.sent;
        self.size = (self.size / 2).max(MIN_WINDOW);
        self.threshold = self.size;
    }

    /// Takes what is on its way for gone when nothing was heard of it for long.
    pub(crate) fn tick(&mut self, now: MonoTime) {
        if self.sent > self.arrived && now - self.heard >= SILENCE {
            self.arrived = self.sent;
            self.marks.clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TERMS: Terms = Terms { window: 1 << 20, datagram: 1_200 };

    fn at(millis: i64) -> MonoTime {
        MonoTime::default() + Span::from_millis(millis)
    }

    fn fill(window: &mut SendWindow, now: MonoTime) -> u32 {
        let mut count = 0;
        while window.is_open(now) {
            count += 1;
            window.sent(0, count, 1_000, now);
        }
        count
    }

    #[test]
    fn window_grows_with_what_arrives_up_to_what_fits() {
        let mut window = SendWindow::new(TERMS, None, at(0));
        let sent = fill(&mut window, at(0));
        assert_eq!(sent, FIRST_WINDOW.div_ceil(1_000));
        window.progress(0, sent / 2, at(1));
        assert!(window.is_open(at(1)) && window.size() > FIRST_WINDOW);
        for round in 0..20 {
            let sent = fill(&mut window, at(round));
            window.progress(0, sent, at(round));
            window.marks.clear();
            window.arrived = window.sent;
        }
        assert!(window.size() <= TERMS.window);
    }

    #[test]
    fn losses_of_one_flight_halve_window_once() {
        let mut window = SendWindow::new(TERMS, None, at(0));
        fill(&mut window, at(0));
        window.lost();
        window.lost();
        assert_eq!(window.size(), FIRST_WINDOW / 2);
        assert!(!window.is_open(at(1)));
        for _ in 0..10 {
            window.tick(at(1_000));
            window.lost();
            fill(&mut window, at(1_000));
        }
        assert_eq!(window.size(), MIN_WINDOW, "and never below the least");
    }

    #[test]
    fn size_that_was_too_much_is_tried_again_after_seconds() {
        let mut window = SendWindow::new(TERMS, None, at(0));
        fill(&mut window, at(0));
        window.lost();
        let mut grown_at = None;
        for millis in 1..10_000 {
            fill(&mut window, at(millis));
            window.progress(u64::MAX, u32::MAX, at(millis));
            if window.size() >= FIRST_WINDOW {
                grown_at.get_or_insert(millis);
            }
        }
        assert!(grown_at.is_some_and(|millis| (2_000..5_000).contains(&millis)), "{grown_at:?}");
    }

    #[test]
    fn silence_opens_window_again() {
        let mut window = SendWindow::new(TERMS, None, at(0));
        fill(&mut window, at(0));
        assert_eq!(window.opens_at(), at(200));
        window.tick(at(199));
        assert!(!window.is_open(at(199)));
        window.tick(at(200));
        assert!(window.is_open(at(200)));
    }

    #[test]
    fn configured_rate_is_kept() {
        let mut window = SendWindow::new(TERMS, Some(8_000_000), at(0));
        let mut sent = 0;
        for millis in 0..1_000 {
            while window.is_open(at(millis)) {
                window.sent(sent, 1, 1_000, at(millis));
                window.progress(sent, 1, at(millis));
                sent += 1;
            }
        }
        assert!((990..=1_010).contains(&sent), "{sent} kB in a second at 1 MB/s");
    }
}
