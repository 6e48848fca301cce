//! How the outbox spends the time that it has for stopping. No I/O: time comes in as an argument.

use std::time::Duration;

use tokio::time::Instant;

/// Kept for what must not be left out when there is no time for everything.
const RESERVE: Duration = Duration::from_millis(500);

/// The last moments of the outbox.
#[derive(Debug)]
pub(super) struct Farewell {
    deadline: Instant,
    /// When there is no time for everything any more.
    everything: Instant,
    /// How long it may stay silent over there.
    quiet: Duration,
    /// When something was last stored, and how much by then.
    heard: Instant,
    stored: u64,
    given_up: bool,
}

/// What to do now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Next {
    /// Go on, and look again then at the latest.
    Wait(Instant),
    /// Give up what waits and send only that the runs ended.
    Frames,
    /// It is over.
    Leave,
}

impl Farewell {
    /// Told `now` to end by `deadline`; so many events are stored already.
    pub(super) fn begin(now: Instant, deadline: Instant, stored: u64) -> Self {
        let whole = deadline.saturating_duration_since(now);
        let everything = deadline.checked_sub(RESERVE.min(whole / 4)).unwrap_or(now);
        Self { deadline, everything, quiet: whole / 2, heard: now, stored, given_up: false }
    }

    /// Looks at how many events are stored and how many wait.
    pub(super) fn next(&mut self, now: Instant, stored: u64, waiting: u64) -> Next {
        if waiting == 0 || now >= self.deadline {
            return Next::Leave;
        }
        if stored > self.stored {
            (self.stored, self.heard) = (stored, now);
        }
        if self.given_up {
            return Next::Wait(self.deadline);
        }
        let until = self.everything.min(self.heard + self.quiet);
        if now < until {
            return Next::Wait(until);
        }
        self.given_up = true;
        Next::Frames
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seconds(seconds: f64) -> Duration {
        Duration::from_secs_f64(seconds)
    }

    #[tokio::test]
    async fn the_whole_time_is_used_while_there_is_progress() {
        let now = Instant::now();
        let at = |after: f64| now + seconds(after);
        let mut farewell = Farewell::begin(now, at(4.0), 10);
        assert_eq!(farewell.next(now, 10, 90), Next::Wait(at(2.0)));
        assert_eq!(farewell.next(at(1.9), 20, 80), Next::Wait(at(3.5)));
        assert_eq!(farewell.next(at(3.4), 30, 70), Next::Wait(at(3.5)));
        assert_eq!(farewell.next(at(3.5), 30, 70), Next::Frames);
        assert_eq!(farewell.next(at(3.5), 30, 2), Next::Wait(at(4.0)));
        assert_eq!(farewell.next(at(3.6), 32, 0), Next::Leave);
    }

    #[tokio::test]
    async fn nobody_waits_long_for_an_aggregator_that_takes_nothing() {
        let now = Instant::now();
        let at = |after: f64| now + seconds(after);
        let mut farewell = Farewell::begin(now, at(4.0), 10);
        assert_eq!(farewell.next(at(2.0), 10, 90), Next::Frames);
        assert_eq!(farewell.next(at(4.0), 10, 2), Next::Leave);
        assert_eq!(Farewell::begin(now, now, 0).next(now, 0, 1), Next::Leave, "no time at all");
    }
}
