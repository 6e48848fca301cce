//! Reduction of many values over time to few columns.

use peernet_analysis::order::SortedValues;

/// Statistics of the values in one column. A column is one of the equal periods into which the time axis is divided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Column {
    /// Index of the column, from the left.
    pub(super) index: usize,
    /// Smallest value.
    pub(super) min: f64,
    /// Median of the values.
    pub(super) median: f64,
    /// Largest value.
    pub(super) max: f64,
}

/// Divides the time between `from` and `to` evenly into `count` columns, and returns the columns that have values, from
/// left to right. Each item of `values` has a time and a value. Values that are not finite, and values whose time is
/// not between `from` and `to`, are left out.
pub(super) fn columns(values: &[(f64, f64)], (from, to): (f64, f64), count: usize) -> Vec<Column> {
    let inside = |(at, value): &&(f64, f64)| value.is_finite() && (from..=to).contains(at);
    // A time at the end of the range belongs to the last column.
    let column_index =
        |at: f64| (((at - from) / (to - from) * count as f64) as usize).min(count.saturating_sub(1));
    let mut values_by_column: Vec<(usize, f64)> =
        values.iter().filter(inside).map(|(at, value)| (column_index(*at), *value)).collect();
    values_by_column.sort_by_key(|(index, _)| *index);
    let column = |group: &[(usize, f64)]| {
        let values: SortedValues = group.iter().map(|(_, value)| *value).collect();
        let (min, max) = (*values.values().first()?, *values.values().last()?);
        Some(Column { index: group[0].0, min, median: values.median()?, max })
    };
    values_by_column.chunk_by(|a, b| a.0 == b.0).filter_map(column).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn column_keeps_extremes_of_many_values() {
        let mut values: Vec<(f64, f64)> = (0..100_000).map(|i| (f64::from(i), f64::from(i % 7))).collect();
        values[55_555].1 = 1000.0;
        values[70_000].1 = f64::NAN;
        let columns = columns(&values, (0.0, 99_999.0), 300);
        assert_eq!(columns.len(), 300);
        let highest = columns.iter().max_by(|a, b| a.max.total_cmp(&b.max)).expect("columns");
        assert_eq!((highest.index, highest.max, highest.median), (166, 1000.0, 3.0));
        assert!(columns.iter().all(|column| column.min == 0.0));
    }

    #[test]
    fn gap_in_time_has_no_columns() {
        let values = [(0.0, 1.0), (1.0, 2.0), (9.0, 3.0), (10.0, 4.0), (11.0, 5.0)];
        let indexes: Vec<usize> =
            columns(&values, (0.0, 10.0), 10).iter().map(|column| column.index).collect();
        assert_eq!(indexes, [0, 1, 9]);
    }
}
