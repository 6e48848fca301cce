//! Wishes to end, of which one may come as two signals.

use std::time::Duration;

use tokio::signal::unix::SignalKind;
use tokio::time::Instant;

/// Signals of one kind within this time are one wish: `timeout` signals a process and then its group, of which the process
/// is a part.
const ONE_WISH: Duration = Duration::from_millis(500);

/// Tells signals that repeat a wish from those that are another.
#[derive(Debug, Default)]
pub struct Wishes {
    last: Option<(SignalKind, Instant)>,
}

impl Wishes {
    /// Whether a signal that has come now is a wish of its own.
    pub fn is_another(&mut self, kind: SignalKind, now: Instant) -> bool {
        let repeats = |(before, at): (SignalKind, Instant)| before == kind && now - at < ONE_WISH;
        if self.last.is_some_and(repeats) {
            return false;
        }
        self.last = Some((kind, now));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_of_a_kind_in_a_moment_are_one_wish() {
        let (mut wishes, begin) = (Wishes::default(), Instant::now());
        let mut come = |kind, ms| wishes.is_another(kind, begin + Duration::from_millis(ms));
        let (terminate, interrupt) = (SignalKind::terminate(), SignalKind::interrupt());
        assert!(come(terminate, 0));
        assert!(!come(terminate, 0) && !come(terminate, 499));
        assert!(come(terminate, 500), "somebody insists");
        assert!(come(interrupt, 501), "another signal is another wish");
    }
}
