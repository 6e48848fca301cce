//! Times of exchanges, which show whether an exchange took place near a given time. Only some of the times are kept.

use std::collections::VecDeque;

use crate::{RawTime, Span};

/// Maximum number of times that are kept, apart from the newest.
const MAX_TIMES: i64 = 1024;

/// Some of the times of exchanges, in order: no two times are closer than `min_gap`. The newest time is stored
/// separately.
#[derive(Clone, Debug)]
pub(super) struct ExchangeTimes {
    times: VecDeque<RawTime>,
    newest: Option<RawTime>,
    min_gap: Span,
    /// Times that are more than this before the newest are removed.
    retention: Span,
}

impl ExchangeTimes {
    pub(super) fn new(max_fresh_age: Span, retention: Span) -> Self {
        // The gap is a fraction of `max_fresh_age`, so that the removal of times hardly changes whether an exchange
        // counts as recent.
        let min_gap = (max_fresh_age.nanos() / 8).max(retention.nanos() / MAX_TIMES).max(1);
        Self { times: VecDeque::new(), newest: None, min_gap: Span::from_nanos(min_gap), retention }
    }

    /// Inserts the time of an exchange and removes times that are more than `retention` before the newest.
    pub(super) fn insert(&mut self, at: RawTime) {
        self.newest = self.newest.max(Some(at));
        let index = self.times.partition_point(|time| *time <= at);
        let is_close = |time: Option<&RawTime>| time.is_some_and(|time| (*time - at).abs() < self.min_gap);
        if is_close(self.times.get(index))
            || is_close(index.checked_sub(1).and_then(|previous| self.times.get(previous)))
        {
            return;
        }
        self.times.insert(index, at);
        let start = self.newest.unwrap_or(at) - self.retention;
        while self.times.front().is_some_and(|time| *time < start) {
            self.times.pop_front();
        }
    }

    /// Returns whether an exchange took place between `from - max_distance` and `to + max_distance`.
    pub(super) fn has_exchange_near(&self, from: RawTime, to: RawTime, max_distance: Span) -> bool {
        let (from, to) = (from - max_distance, to + max_distance);
        let index = self.times.partition_point(|time| *time < from);
        // `times` need not include the newest exchange.
        [self.times.get(index).copied(), self.newest]
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
    fn kept_times_show_all_nearby_exchanges() {
        let second = |seconds: f64| RawTime::from_nanos((seconds * 1e9) as i64);
        let mut exchange_times = ExchangeTimes::new(Span::from_seconds(10), Span::from_seconds(600));
        // The times from 0 to 2,000 s come in a shuffled order. Those from 1,400 s on are kept.
        for n in 0..200_000 {
            exchange_times.insert(second(f64::from(n * 7919 % 200_000) / 100.0));
        }
        assert!(exchange_times.times.len() as i64 <= MAX_TIMES, "{}", exchange_times.times.len());
        assert!(exchange_times.times.iter().is_sorted());
        for at in [1_400.0, 1_700.5, 2_005.0, 2_009.5] {
            assert!(exchange_times.has_exchange_near(second(at), second(at), Span::from_seconds(10)), "{at}");
        }
        for at in [2_011.0, 3_000.0, -20.0] {
            assert!(
                !exchange_times.has_exchange_near(second(at), second(at), Span::from_seconds(10)),
                "{at}"
            );
        }
    }
}
