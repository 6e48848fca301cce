//! Choice of the latency by which runs are compared: the measured total or the sum of the stages.

use peernet_logger::{Name, stage};

use crate::rows::RowRef;

/// Latency of a whole iteration by which runs are compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TotalColumn {
    /// Time from the intended start of an iteration to its end.
    #[default]
    Measured,
    /// Sum of the stages. Results of other programs often have only stages.
    SumOfStages,
}

impl TotalColumn {
    /// Returns the latency by which rows are compared, by the rule of [`Self::from_counts`]. Rows that are not in the
    /// statistics are ignored.
    pub fn from_rows<'a>(rows: impl IntoIterator<Item = RowRef<'a>>) -> Self {
        let [mut iterations, mut totals, mut sums] = [0; 3];
        for row in rows.into_iter().filter(RowRef::is_in_statistics) {
            iterations += 1;
            totals += u64::from(row.value(Self::Measured.name()).is_some());
            sums += u64::from(row.value(Self::SumOfStages.name()).is_some());
        }
        Self::from_counts(iterations, totals, sums)
    }

    /// Returns the latency by which runs are compared. `iterations` is the number of iterations in the statistics, in
    /// all runs together. `totals` of them have a total, and `sums` of them have a sum of stages.
    ///
    /// A total cannot be compared with a sum of stages, because the total is longer than its stages. If at least one
    /// iteration has no total, all iterations are therefore compared by the sum of their stages. If no iteration has
    /// such a sum either, the total is returned.
    pub fn from_counts(iterations: u64, totals: u64, sums: u64) -> Self {
        if totals < iterations && sums > 0 { Self::SumOfStages } else { Self::Measured }
    }

    /// Returns the name of the column and of the node.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Measured => "total",
            Self::SumOfStages => "stages-total",
        }
    }

    /// Returns the nodes with the latency of a run's iterations, the preferred node first: results of other programs
    /// may have `sensing` and no total.
    pub const fn latency_names(self) -> [Name; 2] {
        [Name::from_static(self.name()), stage::SENSING]
    }

    /// Returns `measured total` or `sum of stages`.
    pub const fn description(self) -> &'static str {
        match self {
            Self::Measured => "measured total",
            Self::SumOfStages => "sum of stages",
        }
    }

    /// Returns the title of an axis: `Total` or `Sum of stages`.
    pub const fn title(self) -> &'static str {
        match self {
            Self::Measured => "Total",
            Self::SumOfStages => "Sum of stages",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::{Outcome, Rows};
    use crate::testing::row_of_values;

    fn rows(totals: &[Option<f64>], outcome: Outcome) -> Rows {
        let values = |total: &Option<f64>| {
            total.map(|total| ("total", total)).into_iter().chain([("stages-total", 1.0)])
        };
        totals.iter().map(|total| row_of_values(outcome, &values(total).collect::<Vec<_>>())).collect()
    }

    #[test]
    fn sum_of_stages_is_used_if_one_total_is_missing() {
        let column = |rows: &Rows| TotalColumn::from_rows(rows);
        assert_eq!(column(&rows(&[Some(2.0), Some(2.0)], Outcome::Ok)), TotalColumn::Measured);
        assert_eq!(column(&rows(&[Some(2.0), None], Outcome::Ok)), TotalColumn::SumOfStages);
        assert_eq!(
            column(&rows(&[None], Outcome::Lost)),
            TotalColumn::Measured,
            "the iteration without a total is not in the statistics"
        );
        assert_eq!(
            TotalColumn::from_counts(100, 99, 0),
            TotalColumn::Measured,
            "no iteration has a sum of stages"
        );
    }
}
