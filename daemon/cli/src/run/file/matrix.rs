//! Combinations of the axes' values.

use std::collections::BTreeMap;

use toml::Value;

use super::axis::{Axis, AxisValue, label};

/// Maximum number of runs of an experiment, so that a typing error does not fill the memory.
pub(super) const MAX_RUNS: usize = 10_000;

/// One value of each axis, in the order of the axes.
pub(super) type Combination<'a> = Vec<(&'a Axis, &'a AxisValue)>;

/// Reason why the axes make no matrix of runs.
#[derive(Debug, thiserror::Error)]
pub(super) enum MatrixError {
    #[error("the axes make more than {MAX_RUNS} combinations")]
    TooManyCombinations,
    #[error("experiment.repeats: the repeats make {0} runs; the maximum is {MAX_RUNS}")]
    TooManyRuns(u64),
    #[error("experiment.exclude[{index}]: {source}")]
    Exclusion { index: usize, source: ExclusionError },
    #[error("experiment.exclude: it excludes all combinations")]
    NothingLeft,
}

/// An invalid table of excluded combinations.
#[derive(Debug, thiserror::Error)]
pub(super) enum ExclusionError {
    #[error("it names no axis, so that it would exclude all combinations")]
    Empty,
    #[error("there is no axis {name}, only {}", .known.join(", "))]
    UnknownAxis { name: String, known: Vec<String> },
    #[error("{axis} has no value {value}, only {known}")]
    UnknownLabel { axis: String, value: Value, known: String },
}

/// Returns every combination that is not excluded, the last axis changing fastest.
///
/// # Errors
/// When there are too many, an exclusion names an unknown axis or label, or nothing is left.
pub(super) fn combinations<'a>(
    axes: &'a [Axis],
    exclude: &[BTreeMap<String, Value>],
) -> Result<Vec<Combination<'a>>, MatrixError> {
    // The combinations are counted before they are made, because too many would fill the memory.
    let count = axes.iter().try_fold(1_usize, |count, axis| count.checked_mul(axis.values.len()));
    if count.is_none_or(|count| count > MAX_RUNS) {
        return Err(MatrixError::TooManyCombinations);
    }
    let exclude: Vec<Exclusion> = exclude
        .iter()
        .enumerate()
        .map(|(index, table)| {
            Exclusion::read(axes, table).map_err(|source| MatrixError::Exclusion { index, source })
        })
        .collect::<Result<_, _>>()?;
    let all = axes.iter().fold(vec![Vec::new()], |combinations: Vec<Combination<'a>>, axis| {
        let extend = |combination: &Combination<'a>| -> Vec<Combination<'a>> {
            axis.values.iter().map(|value| [combination.as_slice(), &[(axis, value)]].concat()).collect()
        };
        combinations.iter().flat_map(extend).collect()
    });
    let remaining: Vec<Combination<'_>> = all
        .into_iter()
        .filter(|combination| !exclude.iter().any(|exclusion| exclusion.covers(combination)))
        .collect();
    if remaining.is_empty() { Err(MatrixError::NothingLeft) } else { Ok(remaining) }
}

/// Axes with labels: a combination is excluded if all of these axes have one of these labels.
struct Exclusion(Vec<(String, Vec<String>)>);

impl Exclusion {
    fn read(axes: &[Axis], table: &BTreeMap<String, Value>) -> Result<Self, ExclusionError> {
        if table.is_empty() {
            return Err(ExclusionError::Empty);
        }
        let read = |(name, value): (&String, &Value)| {
            let axis = axes.iter().find(|axis| axis.name == *name);
            let axis = axis.ok_or_else(|| ExclusionError::UnknownAxis {
                name: name.clone(),
                known: axes.iter().map(|axis| axis.name.clone()).collect(),
            })?;
            let values = match value {
                Value::Array(values) => values.as_slice(),
                value => std::slice::from_ref(value),
            };
            let labels = values.iter().map(|value| {
                let label =
                    label(value).filter(|label| axis.values.iter().any(|value| value.label == *label));
                label.ok_or_else(|| ExclusionError::UnknownLabel {
                    axis: name.clone(),
                    value: value.clone(),
                    known: axis.list_labels(),
                })
            });
            Ok((name.clone(), labels.collect::<Result<_, _>>()?))
        };
        table.iter().map(read).collect::<Result<_, _>>().map(Self)
    }

    fn covers(&self, combination: &Combination<'_>) -> bool {
        self.0.iter().all(|(name, labels)| {
            combination.iter().any(|(axis, value)| axis.name == *name && labels.contains(&value.label))
        })
    }
}
