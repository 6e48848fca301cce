//! Flow control of one direction. It depends on the size of the other end's socket buffer, on recent arrivals, and on a
//! configured rate.
//!
//! The other end reports how many bytes may be in flight to it and how far it has received. Within that limit the
//! window grows with the bytes that arrive and is halved when a message is lost, like the window of TCP (RFC 5681). The
//! rate thus follows the slowest link of the path.
//!
//! After a loss the window grows with time and not with the bytes that arrive, like the window of CUBIC (RFC 9438). The
//! reason is that every loss costs a whole message: a size that was too large is tried again after seconds and not
//! within the next message. With a receiver whose buffer is too small, such as the buffer of libzmq, a message is lost
//! every few seconds instead of nearly every message.

mod congestion;
mod in_flight;
mod pacing;

use peernet_clock::MonoTime;

use self::congestion::CongestionWindow;
use self::in_flight::BytesInFlight;
use self::pacing::Pacer;
use super::packet::Terms;

/// Number of bytes after which an end reports its progress.
pub(crate) const PROGRESS_INTERVAL_BYTES: u32 = 16 * 1024;

/// Flow control state of one direction of a connection.
#[derive(Debug)]
pub(crate) struct SendWindow {
    congestion: CongestionWindow,
    in_flight: BytesInFlight,
    pacer: Pacer,
}

impl SendWindow {
    /// Creates a window for the other end's terms. `bits_per_second` is the configured rate.
    pub(crate) fn new(terms: Terms, bits_per_second: Option<u64>, now: MonoTime) -> Self {
        Self {
            congestion: CongestionWindow::new(terms.window, now),
            in_flight: BytesInFlight::new(now),
            pacer: Pacer::new(bits_per_second, now),
        }
    }

    /// Returns the number of bytes that may be in flight.
    #[cfg(test)]
    pub(crate) const fn size(&self) -> u32 {
        self.congestion.size()
    }

    fn is_full(&self) -> bool {
        self.in_flight.bytes() >= u64::from(self.congestion.size())
    }

    /// Returns whether another datagram may be sent now.
    pub(crate) fn is_open(&self, now: MonoTime) -> bool {
        !self.is_full() && self.pacer.opens_at() <= now
    }

    /// Returns the time at which the window may be open again if nothing arrives until then.
    pub(crate) fn opens_at(&self) -> MonoTime {
        if self.is_full() { self.in_flight.expires_at() } else { self.pacer.opens_at() }
    }

    /// Records that a datagram with a part of message `sequence` was sent; the part ends at offset `end` of the
    /// message.
    pub(crate) fn record_sent(&mut self, sequence: u64, end: u32, bytes: u32, now: MonoTime) {
        self.in_flight.record_sent((sequence, end), bytes, now);
        self.pacer.record_sent(bytes, now);
    }

    /// Handles a report of the other end's progress.
    pub(crate) fn record_progress(&mut self, sequence: u64, end: u32, now: MonoTime) {
        let progress_bytes = self.in_flight.record_progress((sequence, end), now);
        if progress_bytes > 0 {
            self.congestion.grow(progress_bytes, now);
        }
    }

    /// Records that a message was lost.
    pub(crate) fn record_loss(&mut self) {
        self.congestion.shrink(self.in_flight.sent_bytes(), self.in_flight.arrived_or_lost());
    }

    /// Treats bytes in flight as arrived or lost after a long silence.
    pub(crate) fn tick(&mut self, now: MonoTime) {
        self.in_flight.tick(now);
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::Span;

    use super::congestion::{INITIAL_WINDOW, MIN_WINDOW};
    use super::*;

    const TERMS: Terms = Terms { window: 1 << 20, max_datagram_bytes: 1_200 };

    fn at(millis: i64) -> MonoTime {
        MonoTime::default() + Span::from_millis(millis)
    }

    fn fill(window: &mut SendWindow, now: MonoTime) -> u32 {
        let mut count = 0;
        while window.is_open(now) {
            count += 1;
            window.record_sent(0, count, 1_000, now);
        }
        count
    }

    #[test]
    fn window_grows_with_arrived_bytes_up_to_receivers_window() {
        let mut window = SendWindow::new(TERMS, None, at(0));
        let sent = fill(&mut window, at(0));
        assert_eq!(sent, INITIAL_WINDOW.div_ceil(1_000));
        window.record_progress(0, sent / 2, at(1));
        assert!(window.is_open(at(1)) && window.size() > INITIAL_WINDOW);
        for round in 0..20 {
            let sent = fill(&mut window, at(round));
            window.record_progress(0, sent, at(round));
            window.record_progress(u64::MAX, 0, at(round));
        }
        assert!(window.size() <= TERMS.window);
    }

    #[test]
    fn losses_of_one_flight_halve_window_once() {
        let mut window = SendWindow::new(TERMS, None, at(0));
        fill(&mut window, at(0));
        window.record_loss();
        window.record_loss();
        assert_eq!(window.size(), INITIAL_WINDOW / 2);
        assert!(!window.is_open(at(1)));
        for _ in 0..10 {
            window.tick(at(1_000));
            window.record_loss();
            fill(&mut window, at(1_000));
        }
        assert_eq!(window.size(), MIN_WINDOW, "the window never shrinks below the minimum");
    }

    #[test]
    fn lossy_window_size_is_retried_after_seconds() {
        let mut window = SendWindow::new(TERMS, None, at(0));
        fill(&mut window, at(0));
        window.record_loss();
        let mut grown_at = None;
        for millis in 1..10_000 {
            fill(&mut window, at(millis));
            window.record_progress(u64::MAX, u32::MAX, at(millis));
            if window.size() >= INITIAL_WINDOW {
                grown_at.get_or_insert(millis);
            }
        }
        assert!(grown_at.is_some_and(|millis| (2_000..5_000).contains(&millis)), "{grown_at:?}");
    }

    #[test]
    fn window_reopens_after_silence() {
        let mut window = SendWindow::new(TERMS, None, at(0));
        fill(&mut window, at(0));
        assert_eq!(window.opens_at(), at(200));
        window.tick(at(199));
        assert!(!window.is_open(at(199)));
        window.tick(at(200));
        assert!(window.is_open(at(200)));
    }

    #[test]
    fn configured_rate_is_reached_and_not_exceeded() {
        let mut window = SendWindow::new(TERMS, Some(8_000_000), at(0));
        let mut sent = 0;
        for millis in 0..1_000 {
            while window.is_open(at(millis)) {
                window.record_sent(sent, 1, 1_000, at(millis));
                window.record_progress(sent, 1, at(millis));
                sent += 1;
            }
        }
        assert!((990..=1_010).contains(&sent), "{sent} kB in a second at 1 MB/s");
    }
}
