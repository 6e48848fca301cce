//! Times of exchanges, thinned, which tell whether a time has recent exchanges.

use std::collections::VecDeque;

use crate::{RawTime, Span};

/// Largest number of times kept per window.
const MOST: i64 = 1024;

/// Times of exchanges in order, no two closer than `gap`, except for the newest.
#[derive(Clone, Debug)]
pub(super) struct Presence {
    times: VecDeque<RawTime>,
    newest: Option<RawTime>,
    gap: Span,
    window: Span,
}

impl Presence {
    pub(super) fn new(fresh: Span, window: Span) -> Self {
        // A fraction of `fresh`, so that thinning hardly changes whether an exchange counts as recent.
        let gap = (fresh.nanos() / 8).max(window.nanos() / MOST).max(1);
        Self { times: VecDeque::new(), newest: None, gap: Span::from_nanos(gap), window }
    }

    pub(super) fn note(&mut self, at: RawTime) {
        self.newest = self.newest.max(Some(at));
        let place = self.times.partition_point(|time| *time <= at);
        let close = |time: Option<&RawTime>| time.is_some_and(|time| (*time - at).abs() < self.gap);
        if close(self.times.get(place))
            || close(place.checked_sub(1).and_then(|before| self.times.get(before)))
        {
            return;
        }
        self.times.insert(place, at);
        let start = self.newest.unwrap_or(at) - self.window;
        while self.times.front().is_some_and(|time| *time < start) {
            self.times.pop_front();
        }
    }

    /// Returns whether an exchange took place from `within` before `from` to `within` after `to`.
    pub(super) fn near(&self, from: RawTime, to: RawTime, within: Span) -> bool {
        let (from, to) = (from - within, to + within);
        let place = self.times.partition_point(|time| *time < from);
        // The newest exchange may not be among the thinned times.
        [self.times.get(place).copied(), self.newest]
            .into_iter()
            .flatten()
            .any(|time| from <= time && time <= to)
    }

    pub(super) fn clear(&mut self) {
        self.times.clear();
        self.newest = None;
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.times.capacity() * size_of::<RawTime>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_times_are_kept_and_none_with_company_is_taken_for_lonely() {
        let second = |seconds: f64| RawTime::from_nanos((seconds * 1e9) as i64);
        let mut presence = Presence::new(Span::from_seconds(10), Span::from_seconds(600));
        for n in 0..200_000 {
            presence.note(second(f64::from(n * 7919 % 200_000) / 100.0));
        }
        assert!(presence.times.len() as i64 <= MOST, "{}", presence.times.len());
        assert!(presence.times.iter().is_sorted());
        for at in [1_400.0, 1_700.5, 2_005.0, 2_009.5] {
            assert!(presence.near(second(at), second(at), Span::from_seconds(10)), "{at}");
        }
        for at in [2_011.0, 3_000.0, -20.0] {
            assert!(!presence.near(second(at), second(at), Span::from_seconds(10)), "{at}");
        }
    }
}
