//! The combinations of the axes' values.

use std::collections::BTreeMap;

use toml::Value;

use super::axis::{Axis, AxisValue, label};

/// Most runs that an experiment may have, so that a slip of the keyboard does not fill the memory.
pub(super) const MOST: usize = 10_000;

/// One value of each axis, in the order of the axes.
pub(super) type Combination<'a> = Vec<(&'a Axis, &'a AxisValue)>;

/// Every combination that is not left out, the last axis changing fastest.
///
/// # Errors
/// A sentence, when an exclusion names what is not there or nothing is left.
pub(super) fn combinations<'a>(
    axes: &'a [Axis],
    exclude: &[BTreeMap<String, Value>],
) -> Result<Vec<Combination<'a>>, String> {
    let count = axes.iter().try_fold(1_usize, |count, axis| count.checked_mul(axis.values.len()));
    if count.is_none_or(|count| count > MOST) {
        return Err(format!("the axes make more than {MOST} combinations"));
    }
    let exclude: Vec<Exclusion> = exclude
        .iter()
        .enumerate()
        .map(|(index, table)| {
            Exclusion::read(axes, table).map_err(|error| format!("experiment.exclude[{index}]: {error}"))
        })
        .collect::<Result<_, _>>()?;
    let all = axes.iter().fold(vec![Vec::new()], |combinations: Vec<Combination<'a>>, axis| {
        let extended = |combination: &Combination<'a>| -> Vec<Combination<'a>> {
            axis.values.iter().map(|value| [combination.as_slice(), &[(axis, value)]].concat()).collect()
        };
        combinations.iter().flat_map(extended).collect()
    });
    let left: Vec<Combination<'_>> =
        all.into_iter().filter(|combination| !exclude.iter().any(|one| one.holds(combination))).collect();
    if left.is_empty() { Err("experiment.exclude: no combination is left".to_owned()) } else { Ok(left) }
}

/// A combination is left out when all of these axes have one of these labels.
struct Exclusion(Vec<(String, Vec<String>)>);

impl Exclusion {
    fn read(axes: &[Axis], table: &BTreeMap<String, Value>) -> Result<Self, String> {
        if table.is_empty() {
            return Err("it names no axis, and would leave nothing".to_owned());
        }
        let read = |(name, value): (&String, &Value)| {
            let axis = axes.iter().find(|axis| axis.name == *name).ok_or_else(|| {
                let known: Vec<&str> = axes.iter().map(|axis| axis.name.as_str()).collect();
                format!("there is no axis {name}; there is {}", known.join(", "))
            })?;
            let values = match value {
                Value::Array(values) => values.as_slice(),
                value => std::slice::from_ref(value),
            };
            let labels = values.iter().map(|value| {
                let known =
                    label(value).filter(|label| axis.values.iter().any(|value| value.label == *label));
                known.ok_or_else(|| format!("{name} is never {value}; there is {}", axis.listed()))
            });
            Ok((name.clone(), labels.collect::<Result<_, String>>()?))
        };
        table.iter().map(read).collect::<Result<_, String>>().map(Self)
    }

    fn holds(&self, combination: &Combination<'_>) -> bool {
        self.0.iter().all(|(name, labels)| {
            combination.iter().any(|(axis, value)| axis.name == *name && labels.contains(&value.label))
        })
    }
}
