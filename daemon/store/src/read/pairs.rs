//! Pairs of values of two quantities, one pair per iteration. Not all iterations are read, because a run may have ten
//! million.

use std::collections::BTreeMap;

use futures::future::try_join_all;
use peernet_logger::{IterationValues, NodeId, NodeRole};
use sqlx::FromRow;

use super::{corrupt_data, sql};
use crate::error::StoreError;
use crate::readers::Readers;
use crate::types::ValuePairs;

/// Name of the requested data in errors.
const WHAT: &str = "pairs of values";
/// Number of concurrent reads; each reads an equal part of the selected iterations.
const CONCURRENT_READS: usize = 4;
/// Fractional part of the golden ratio. From one interval of [`select_numbers`] to the next, the
/// position within the interval moves by this share of the interval's length. Multiples of an
/// irrational number never have the same fraction, so positions do not repeat.
const GOLDEN_RATIO_FRACTION: f64 = 0.618_033_988_749_895;

/// A node with one of the two names, or a node `sensing`, which may be the parent of such a node.
#[derive(FromRow)]
struct Row {
    iteration: i64,
    node: u32,
    parent: Option<u32>,
    #[sqlx(rename = "text")]
    name: String,
    value: Option<f64>,
}

/// The values of an iteration by name.
#[derive(Default)]
struct Values {
    iteration_values: IterationValues,
    /// Sum of the values of each custom name.
    others: Vec<(String, f64)>,
}

impl Values {
    /// Adds a node. Nodes must be added in the order of their tree.
    fn add(&mut self, Row { node, parent, name, value, .. }: Row) {
        let role = self.iteration_values.add(NodeId(node), parent.map(NodeId), &name, value);
        let (NodeRole::Other, Some(value)) = (role, value) else { return };
        match self.others.iter_mut().find(|(other, _)| *other == name) {
            Some((_, sum)) => *sum += value,
            None => self.others.push((name, value)),
        }
    }

    /// Returns the iteration's value of a name: the sum of all nodes that count for the name. Custom code may log one
    /// name at several places of a tree. Pages group nodes by name, so these nodes are one quantity here; `data.csv`
    /// has a column for each place.
    fn get(&self, name: &str) -> Option<f64> {
        let other = || Some(self.others.iter().find(|(other, _)| other == name)?.1);
        self.iteration_values.get(name).or_else(other)
    }
}

pub(crate) async fn value_pairs(
    readers: &Readers,
    run: i64,
    [x, y]: [&str; 2],
    max_pairs: u32,
) -> Result<ValuePairs, StoreError> {
    let neighbour = async |statement: &'static str, from: i64| {
        let number: Option<i64> = sqlx::query_scalar(statement)
            .bind(run)
            .bind(from)
            .fetch_one(&readers.pool())
            .await
            .map_err(readers.error_for(WHAT))?;
        Ok(number)
    };
    let ends = neighbour(sql::NEXT, 0).await?.zip(neighbour(sql::PREVIOUS, i64::MAX).await?);
    let Some((first, last)) = ends else { return Ok(ValuePairs::default()) };
    let numbers = select_numbers(first, last, max_pairs);
    let read = async |numbers: &[i64]| -> Result<Vec<Row>, StoreError> {
        sqlx::query_as(sql::PAIRS)
            .bind(run)
            .bind(serde_json::to_string(numbers).map_err(|error| corrupt_data(WHAT, error))?)
            .bind(x)
            .bind(y)
            .fetch_all(&readers.pool())
            .await
            .map_err(readers.error_for(WHAT))
    };
    // The iterations are read concurrently, because in a long run they are far from each other in the file, and each
    // read waits for the disk.
    let part_length = numbers.len().div_ceil(CONCURRENT_READS).max(1);
    let rows = try_join_all(numbers.chunks(part_length).map(read)).await?;
    let mut by_iteration = BTreeMap::<i64, Values>::new();
    for row in rows.into_iter().flatten() {
        by_iteration.entry(row.iteration).or_default().add(row);
    }
    let point = |values: &Values| Some((values.get(x)?, values.get(y)?));
    Ok(ValuePairs {
        points: by_iteration.values().filter_map(point).collect(),
        read_iterations: numbers.len() as u64,
        stored_iterations: length(first, last),
    })
}

/// Returns how many numbers are in the range from `first` to `last`.
const fn length(first: i64, last: i64) -> u64 {
    last.abs_diff(first).saturating_add(1)
}

/// Returns at most `max_pairs` numbers from the first to the last, in ascending order: all of them, or one from each of
/// `max_pairs` intervals of equal length.
///
/// The position within the interval changes from one interval to the next. With evenly spaced numbers, a run that
/// repeats its data set would always contribute the same few samples of the data set.
fn select_numbers(first: i64, last: i64, max_pairs: u32) -> Vec<i64> {
    let total = length(first, last);
    if total <= u64::from(max_pairs) {
        return (first..=last).collect();
    }
    let start = |interval: u32| (u128::from(total) * u128::from(interval) / u128::from(max_pairs)) as u64;
    let number = |interval: u32| {
        let (from, to) = (start(interval), start(interval + 1));
        let position = ((to - from) as f64 * (f64::from(interval) * GOLDEN_RATIO_FRACTION).fract()) as u64;
        first.saturating_add_unsigned(from + position.min(to - from - 1))
    };
    (0..max_pairs).map(number).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn selection_covers_repeating_data_set() {
        for period in [7, 30, 100] {
            let numbers = select_numbers(1, 1_500 * period, 1_500);
            let samples: HashSet<i64> = numbers.iter().map(|number| number % period).collect();
            assert_eq!(samples.len() as i64, period);
        }
    }

    proptest! {
        #[test]
        fn each_interval_has_one_number(first in 1i64..i64::MAX, total in 1i64..3_000_000, max_pairs in 0u32..4_000) {
            let last = first.saturating_add(total - 1);
            let (numbers, total) = (select_numbers(first, last, max_pairs), length(first, last));
            prop_assert_eq!(numbers.len() as u64, total.min(u64::from(max_pairs)));
            prop_assert!(numbers.windows(2).all(|pair| pair[0] < pair[1]));
            prop_assert!(numbers.iter().all(|number| (first..=last).contains(number)));
            let interval = total as f64 / f64::from(max_pairs.max(1));
            let has_wide_gap = numbers.windows(2).any(|pair| (pair[1] - pair[0]) as f64 > 2.0 * interval + 2.0);
            prop_assert!(!has_wide_gap, "numbers are more than two intervals apart");
        }
    }
}
