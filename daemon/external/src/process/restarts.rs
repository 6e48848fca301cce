//! Delays before restarts of a process that died. No I/O.

use peernet_clock::{MonoTime, Span};

/// Exponential backoff for restarts: no delay after a process that worked, growing delays while processes die without
/// having worked.
#[derive(Clone, Copy, Debug, Default)]
pub struct Restarts {
    /// Number of consecutive ends without a successful call in between.
    vain: u32,
    /// Earliest time of the next start.
    until: Option<MonoTime>,
}

impl Restarts {
    const FIRST: Span = Span::from_millis(100);
    const LONGEST: Span = Span::from_seconds(10);

    /// Resets the delay after a successful call.
    pub fn worked(&mut self) {
        *self = Self::default();
    }

    /// Records that the process died or could not be started.
    pub fn died(&mut self, now: MonoTime) {
        let pause = match self.vain {
            0 => Span::ZERO,
            vain => {
                Span::from_nanos(Self::FIRST.nanos() << vain.saturating_sub(1).min(10)).min(Self::LONGEST)
            }
        };
        self.vain = self.vain.saturating_add(1);
        self.until = Some(now + pause);
    }

    /// Returns the time left before the next start; `None` if the process may be started now.
    pub fn wait(&self, now: MonoTime) -> Option<Span> {
        self.until.map(|until| until - now).filter(|left| *left > Span::ZERO)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_while_it_dies_at_once_and_vanish_when_it_works() {
        let (mut restarts, mut now) = (Restarts::default(), MonoTime::from_nanos(0));
        let mut pauses = Vec::new();
        for _ in 0..10 {
            restarts.died(now);
            let pause = restarts.wait(now).unwrap_or(Span::ZERO);
            pauses.push(pause.nanos() / 1_000_000);
            now = now + pause;
            assert_eq!(restarts.wait(now), None);
        }
        assert_eq!(pauses, [0, 100, 200, 400, 800, 1600, 3200, 6400, 10_000, 10_000]);
        restarts.worked();
        restarts.died(now);
        assert_eq!(restarts.wait(now), None);
    }
}
