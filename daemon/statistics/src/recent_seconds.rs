//! Statistics of the last seconds, one cell per second, in constant memory.

use crate::Merge;

/// Ring of one-second cells. The cell of a new second overwrites the oldest cell, and the cells of any number of the
/// last seconds can be merged.
///
/// The caller numbers the seconds, usually since the Unix epoch. A second that is further in the past than the ring
/// reaches clears the ring.
// Such a second means that the wall clock was set back. Without clearing, the ring would ignore all updates until the
// clock reaches the newest second again.
///
/// ```
/// # use peernet_statistics::{RecentSeconds, Summary};
/// let mut seconds = RecentSeconds::<Summary>::new(60);
/// seconds.record(100, |cell| cell.record(0.25));
/// seconds.record(101, |cell| cell.record(0.75));
/// assert_eq!(seconds.last(101, 1).count(), 1);
/// assert_eq!(seconds.last(101, 10).moments.mean, 0.5);
/// ```
#[derive(Clone, Debug)]
pub struct RecentSeconds<C> {
    /// Cells, each with its second. The index of a cell is its second modulo the length of the ring.
    cells: Box<[Option<(i64, C)>]>,
    /// Newest second with a cell; `None` while the ring is empty.
    newest: Option<i64>,
}

impl<C: Merge + Default> RecentSeconds<C> {
    /// Creates a ring of `seconds` cells, at least one.
    pub fn new(seconds: usize) -> Self {
        Self { cells: (0..seconds.max(1)).map(|_| None).collect(), newest: None }
    }

    /// Returns the number of seconds that the ring covers: the number of its cells.
    pub fn seconds(&self) -> usize {
        self.cells.len()
    }

    /// Returns the newest second with a cell; `None` while the ring is empty.
    pub fn newest(&self) -> Option<i64> {
        self.newest
    }

    /// Calls `add` with the cell of a second, which is created if the ring does not have it.
    pub fn record(&mut self, second: i64, add: impl FnOnce(&mut C)) {
        add(self.cell(second));
    }

    /// Replaces the cell of a second. For updates that each contain all numbers of the second so far.
    pub fn replace(&mut self, second: i64, cell: C) {
        *self.cell(second) = cell;
    }

    /// Returns the cell of a second; creates it if the ring does not have it.
    fn cell(&mut self, second: i64) -> &mut C {
        let length = self.cells.len() as i64;
        if self.newest.is_some_and(|newest| newest.saturating_sub(second) >= length) {
            self.clear();
        }
        self.newest = Some(self.newest.map_or(second, |newest| newest.max(second)));
        let slot = &mut self.cells[second.rem_euclid(length) as usize];
        let (cell_second, cell) = slot.get_or_insert_with(|| (second, C::default()));
        if *cell_second != second {
            (*cell_second, *cell) = (second, C::default());
        }
        cell
    }

    /// Removes the cells of `second` and of all later seconds.
    // A clock that was set back reaches these seconds again. New values must not be mixed with the old cells.
    pub fn remove_from(&mut self, second: i64) {
        for slot in &mut self.cells {
            slot.take_if(|(cell_second, _)| *cell_second >= second);
        }
        self.newest = self.cells.iter().flatten().map(|(cell_second, _)| *cell_second).max();
    }

    /// Returns the cell of a second; `None` if the ring does not have it.
    pub fn get(&self, second: i64) -> Option<&C> {
        let slot = self.cells[second.rem_euclid(self.cells.len() as i64) as usize].as_ref();
        slot.filter(|(cell_second, _)| *cell_second == second).map(|(_, cell)| cell)
    }

    /// Iterates over seconds and their cells: the last `seconds` seconds up to and including `now`, oldest first. At
    /// most as many seconds as the ring has cells are covered. Seconds without a cell are left out.
    pub fn iter(&self, now: i64, seconds: usize) -> impl Iterator<Item = (i64, &C)> {
        let length = seconds.min(self.cells.len()) as i64;
        // Each number of the range is increased by one, because `now + 1` as the end of the range could overflow.
        (now.saturating_sub(length)..now)
            .map(|second_before| second_before + 1)
            .filter_map(|second| self.get(second).map(|cell| (second, cell)))
    }

    /// Merges the cells of the last `seconds` seconds up to and including `now`.
    pub fn last(&self, now: i64, seconds: usize) -> C {
        let mut merged = C::default();
        self.iter(now, seconds).for_each(|(_, cell)| merged.merge(cell));
        merged
    }

    /// Removes all cells.
    pub fn clear(&mut self) {
        self.cells.iter_mut().for_each(|cell| *cell = None);
        self.newest = None;
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    struct Count(u64);

    impl Merge for Count {
        fn merge(&mut self, other: &Self) {
            self.0 += other.0;
        }
    }

    proptest! {
        #[test]
        fn merged_seconds_equal_sum_of_recorded_seconds(
            steps in prop::collection::vec((0_i64..4, 0_i64..5), 1..200), length in 5_usize..30, window in 1_usize..40,
        ) {
            let mut recent_seconds = RecentSeconds::<Count>::new(length);
            let mut all = BTreeMap::<i64, u64>::new();
            let mut now = -20;
            for (forward, late) in steps {
                now += forward;
                recent_seconds.record(now - late, |cell| cell.0 += 1);
                *all.entry(now - late).or_default() += 1;
            }
            let newest = recent_seconds.newest().expect("recorded");
            let expected: u64 = all.range(newest - window.min(length) as i64 + 1..).map(|(_, count)| count).sum();
            prop_assert_eq!(recent_seconds.last(newest, window), Count(expected));
        }
    }

    #[test]
    fn replace_overwrites_cell() {
        let mut recent_seconds = RecentSeconds::new(3);
        recent_seconds.replace(7, Count(1));
        recent_seconds.replace(7, Count(5));
        assert_eq!(
            (recent_seconds.last(7, 3), recent_seconds.get(7), recent_seconds.get(4)),
            (Count(5), Some(&Count(5)), None)
        );
    }

    #[test]
    fn wall_clock_set_back_clears_the_ring() {
        let mut recent_seconds = RecentSeconds::new(60);
        recent_seconds.replace(10_000, Count(1));
        recent_seconds.replace(6_400, Count(2));
        assert_eq!((recent_seconds.newest(), recent_seconds.last(6_400, 60)), (Some(6_400), Count(2)));
        assert_eq!(recent_seconds.last(10_000, 60), Count(0));
    }

    #[test]
    fn any_distance_of_seconds_is_accepted() {
        let mut recent_seconds = RecentSeconds::new(4);
        for second in [i64::MIN, i64::MAX, 0] {
            recent_seconds.replace(second, Count(1));
            assert_eq!(recent_seconds.get(second), Some(&Count(1)));
            assert!(recent_seconds.last(second, 4).0 <= 1);
        }
    }

    #[test]
    fn removing_second_removes_later_seconds() {
        let mut recent_seconds = RecentSeconds::<Count>::new(10);
        for second in 95..=104 {
            recent_seconds.record(second, |cell| cell.0 += 1);
        }
        recent_seconds.remove_from(100);
        assert_eq!((recent_seconds.newest(), recent_seconds.last(104, 10)), (Some(99), Count(5)));
        recent_seconds.record(100, |cell| cell.0 += 1);
        assert_eq!((recent_seconds.newest(), recent_seconds.last(100, 10)), (Some(100), Count(6)));
        recent_seconds.remove_from(0);
        assert_eq!(recent_seconds.newest(), None);
    }
}
