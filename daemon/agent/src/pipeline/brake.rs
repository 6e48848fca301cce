//! Keeps a closed loop from spinning while everything fails. No I/O.

use peernet_clock::{MonoTime, Span};
use peernet_stream::Outcome;

/// A closed loop goes on at once after an answer. When there is none, because a model's queue is full or
/// every picture is broken, it would go on as fast as it can fail; so it waits longer and longer instead.
#[derive(Debug, Default)]
pub(super) struct Brake {
    failures: u32,
    until: Option<MonoTime>,
}

impl Brake {
    /// Failures in a row that cost nothing: single bad samples.
    const FREE: u32 = 3;
    const LONGEST: Span = Span::from_seconds(1);

    /// Notes how an iteration ended.
    pub(super) fn note(&mut self, outcome: &Outcome, now: MonoTime) {
        if *outcome == Outcome::Ok {
            *self = Self::default();
            return;
        }
        self.failures = self.failures.saturating_add(1);
        let over = self.failures.saturating_sub(Self::FREE);
        let pause = Span::from_millis(1 << over.min(10)).min(Self::LONGEST);
        self.until = (over > 0).then(|| now + pause);
    }

    /// When the loop may go on; `None` when it may now.
    pub(super) fn holds_until(&self, now: MonoTime) -> Option<MonoTime> {
        self.until.filter(|until| *until > now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_failures_are_free_many_slow_down_and_a_success_lets_go() {
        let (mut brake, now) = (Brake::default(), MonoTime::from_nanos(0));
        let failed = Outcome::Failed("broken".into());
        let pauses: Vec<i64> = (0..16)
            .map(|_| {
                brake.note(&failed, now);
                brake.holds_until(now).map_or(0, |until| (until - now).nanos() / 1_000_000)
            })
            .collect();
        assert_eq!(pauses, [0, 0, 0, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1000, 1000, 1000, 1000]);
        brake.note(&Outcome::Ok, now);
        assert_eq!(brake.holds_until(now), None);
    }
}
