//! How the outbox spends the time that it has for stopping. No I/O: time comes in as an argument.

use std::time::Duration;

use tokio::time::Instant;

/// The last moments of the outbox: everything into the spool, and over there what is taken in time.
#[derive(Debug)]
pub(super) struct Farewell {
    deadline: Instant,
    /// How long it may stay silent over there.
    quiet: Duration,
    /// When something was last stored, and how much by then.
    heard: Instant,
    stored: u64,
}

/// How things are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Standing {
    /// Nothing is in memory only.
    pub(super) spooled: bool,
    /// The aggregator is known to be away.
    pub(super) away: bool,
    /// Events that it has stored.
    pub(super) stored: u64,
    /// Events that it has not.
    pub(super) waiting: u64,
}

impl Farewell {
    /// Told `now` to end by `deadline`; so many events are stored already.
    pub(super) fn begin(now: Instant, deadline: Instant, stored: u64) -> Self {
        Self { deadline, quiet: deadline.saturating_duration_since(now) / 2, heard: now, stored }
    }

    /// Until when to go on, and look again then at the latest; `None` when it is over.
    pub(super) fn next(&mut self, now: Instant, standing: Standing) -> Option<Instant> {
        let Standing { spooled, away, stored, waiting } = standing;
        if stored > self.stored {
            (self.stored, self.heard) = (stored, now);
        }
        let until = match (spooled, away) {
            // What is in memory only is lost otherwise.
            (false, _) => self.deadline,
            (true, true) => now,
            // The next start delivers what nobody takes now.
            (true, false) => self.deadline.min(self.heard + self.quiet),
        };
        (waiting > 0 && now < until).then_some(until)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SAFE: Standing = Standing { spooled: true, away: false, stored: 10, waiting: 90 };

    fn seconds(seconds: f64) -> Duration {
        Duration::from_secs_f64(seconds)
    }

    #[tokio::test]
    async fn the_whole_time_is_used_while_there_is_progress() {
        let now = Instant::now();
        let at = |after: f64| now + seconds(after);
        let mut farewell = Farewell::begin(now, at(4.0), 10);
        assert_eq!(farewell.next(now, SAFE), Some(at(2.0)));
        assert_eq!(farewell.next(at(1.9), Standing { stored: 20, ..SAFE }), Some(at(3.9)));
        assert_eq!(farewell.next(at(3.4), Standing { stored: 30, ..SAFE }), Some(at(4.0)));
        assert_eq!(farewell.next(at(3.5), Standing { stored: 100, waiting: 0, ..SAFE }), None);
        assert_eq!(farewell.next(at(4.0), Standing { stored: 31, ..SAFE }), None, "the deadline");
    }

    #[tokio::test]
    async fn nobody_waits_for_an_aggregator_that_takes_nothing_once_all_is_safe() {
        let now = Instant::now();
        let at = |after: f64| now + seconds(after);
        let mut farewell = Farewell::begin(now, at(4.0), 10);
        assert_eq!(farewell.next(at(2.0), SAFE), None, "silent");
        assert_eq!(farewell.next(at(0.1), Standing { away: true, ..SAFE }), None, "away");
        assert_eq!(Farewell::begin(now, now, 0).next(now, SAFE), None, "no time at all");
    }

    #[tokio::test]
    async fn what_is_in_memory_only_is_waited_for_until_the_deadline() {
        let now = Instant::now();
        let at = |after: f64| now + seconds(after);
        let mut farewell = Farewell::begin(now, at(4.0), 10);
        let unsafe_yet = Standing { spooled: false, away: true, ..SAFE };
        assert_eq!(farewell.next(at(3.9), unsafe_yet), Some(at(4.0)));
        assert_eq!(farewell.next(at(3.95), Standing { spooled: true, ..unsafe_yet }), None);
        assert_eq!(farewell.next(at(4.0), unsafe_yet), None);
    }
}
