//! Column of numbers, stored in the form that needs the least memory and still returns each number exactly.

use super::chunks::Chunks;

/// Element of [`Numbers::Multiples`] that stands for a missing number.
const MISSING: i32 = i32::MIN;
/// Divisors that are tried for [`Numbers::Multiples`]: 1 for whole numbers, 10⁹ for durations in seconds that are whole
/// nanoseconds.
const DIVISORS: [f64; 2] = [1.0, 1e9];

/// Numbers, one for each row. Any of them may be missing.
///
/// Most columns of a run do not need eight bytes for a number: sizes and flags stay the same, iteration numbers count
/// upwards, and durations of up to two seconds are whole nanoseconds, which fit into 32 bits. The numbers determine the
/// form. Each number is read back when it is appended. If the current form cannot represent the number exactly, all
/// numbers are converted to a wider form.
#[derive(Clone, Debug)]
pub(super) enum Numbers {
    /// Numbers with the constant difference `step`. `first` is `None` if all numbers are missing.
    Linear { first: Option<f64>, step: f64, count: usize },
    /// Each number is a whole number from `dividends`, divided by `divisor`: for example, seconds are nanoseconds
    /// divided by 10⁹.
    Multiples { divisor: f64, dividends: Chunks<i32> },
    /// Unchanged numbers; NaN stands for a missing number.
    Exact(Chunks<f64>),
}

impl Numbers {
    /// Returns `count` missing numbers.
    pub(super) const fn missing(count: usize) -> Self {
        Self::Linear { first: None, step: 0.0, count }
    }

    pub(super) fn len(&self) -> usize {
        match self {
            Self::Linear { count, .. } => *count,
            Self::Multiples { dividends, .. } => dividends.len(),
            Self::Exact(numbers) => numbers.len(),
        }
    }

    /// Returns the number of a row; `None` if it is missing.
    pub(super) fn get(&self, row: usize) -> Option<f64> {
        match self {
            Self::Linear { first, step, .. } => first.map(|first| first + step * row as f64),
            Self::Multiples { divisor, dividends } => Some(dividends[row])
                .filter(|dividend| *dividend != MISSING)
                .map(|dividend| f64::from(dividend) / divisor),
            Self::Exact(numbers) => Some(numbers[row]).filter(|number| !number.is_nan()),
        }
    }

    /// Appends a number. NaN is stored as missing.
    pub(super) fn push(&mut self, number: Option<f64>) {
        let number = number.filter(|number| !number.is_nan());
        if !self.try_push(number) {
            *self = Self::narrowest_form((0..self.len()).map(|row| self.get(row)).chain([number]));
        }
    }

    /// Appends a number if the current form represents it exactly; otherwise changes nothing. Returns whether the
    /// number was appended.
    fn try_push(&mut self, number: Option<f64>) -> bool {
        match self {
            Self::Linear { first, step, count } => {
                match (*count, *first, number) {
                    // The first two numbers determine `first` and `step`.
                    (0, ..) => *first = number,
                    (1, Some(first), Some(number)) if (number - first).is_finite() => *step = number - first,
                    _ => {}
                }
                let expected = first.map(|first| first + *step * *count as f64);
                let fits = is_same(expected, number);
                match (fits, *count) {
                    (true, _) => *count += 1,
                    // The second number does not fit, so it must not determine the step.
                    (false, 1) => *step = 0.0,
                    (false, _) => {}
                }
                fits
            }
            Self::Multiples { divisor, dividends } => {
                let dividend = dividend_of(number, *divisor);
                dividend.into_iter().for_each(|dividend| dividends.push(dividend));
                dividend.is_some()
            }
            Self::Exact(numbers) => {
                numbers.push(number.unwrap_or(f64::NAN));
                true
            }
        }
    }

    /// Returns the narrowest form, other than [`Numbers::Linear`], that can represent these numbers.
    // Every column begins as linear and is converted only if a number does not fit, so the linear form is not tried
    // again.
    fn narrowest_form(numbers: impl Iterator<Item = Option<f64>> + Clone) -> Self {
        let fits = |divisor: &f64| numbers.clone().all(|number| dividend_of(number, *divisor).is_some());
        match DIVISORS.into_iter().find(fits) {
            Some(divisor) => Self::Multiples {
                divisor,
                dividends: numbers.filter_map(|number| dividend_of(number, divisor)).collect(),
            },
            None => Self::Exact(numbers.map(|number| number.unwrap_or(f64::NAN)).collect()),
        }
    }
}

/// Returns n for a number that is n / `divisor`, and [`MISSING`] for a missing number. `None` if n is not a whole
/// number or is too large.
fn dividend_of(number: Option<f64>, divisor: f64) -> Option<i32> {
    let Some(number) = number else { return Some(MISSING) };
    // The cast of a number that is too large saturates. The result then differs from the original, so that it is
    // rejected.
    let dividend = (number * divisor).round() as i32;
    (dividend != MISSING && is_same(Some(f64::from(dividend) / divisor), Some(number))).then_some(dividend)
}

/// Compares bit by bit, so that the sign of a zero counts.
fn is_same(a: Option<f64>, b: Option<f64>) -> bool {
    a.map(f64::to_bits) == b.map(f64::to_bits)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn column_of(numbers: &[Option<f64>]) -> Numbers {
        let mut column = Numbers::missing(0);
        numbers.iter().for_each(|number| column.push(*number));
        column
    }

    fn bytes_per_number(numbers: &[Option<f64>]) -> f64 {
        let bytes = match column_of(numbers) {
            Numbers::Linear { .. } => 0,
            Numbers::Multiples { dividends, .. } => dividends.len() * 4,
            Numbers::Exact(numbers) => numbers.len() * 8,
        };
        bytes as f64 / numbers.len() as f64
    }

    #[test]
    fn typical_columns_need_few_bytes() {
        let column =
            |value: fn(u32) -> Option<f64>| bytes_per_number(&(1..=300).map(value).collect::<Vec<_>>());
        assert_eq!(column(|_| None), 0.0);
        assert_eq!(column(|_| Some(150_528.0)), 0.0, "a size");
        assert_eq!(column(|n| Some(f64::from(n))), 0.0, "the iteration's own number");
        assert_eq!(column(|n| (n > 3).then_some(1.0)), 4.0, "the first numbers are missing");
        assert_eq!(column(|n| Some(f64::from(n.pow(2)) / 1e9)), 4.0, "durations");
        assert_eq!(column(|n| Some(1e8 / f64::from(n))), 8.0, "throughputs");
    }

    #[test]
    fn column_widens_when_number_does_not_fit() {
        let additions: [&[f64]; 4] =
            [&[2.0, 2.0], &[1.0, -1.0], &[0.25, 1e-9], &[3.0, f64::INFINITY, -0.0, 1e-300]];
        let mut all = Vec::new();
        for added in additions {
            all.extend(added.iter().copied().map(Some));
            let column = column_of(&all);
            assert!((0..all.len()).all(|at| is_same(column.get(at), all[at])), "{all:?}: {column:?}");
        }
        assert!(matches!(column_of(&all[..2]), Numbers::Linear { .. }));
        assert!(matches!(column_of(&all[..4]), Numbers::Multiples { divisor: 1.0, .. }));
        assert!(matches!(column_of(&all[..6]), Numbers::Multiples { divisor: 1e9, .. }));
        assert!(matches!(column_of(&all), Numbers::Exact(_)));
    }

    proptest! {
        #[test]
        fn every_number_is_read_back_exactly(
            numbers in prop::collection::vec(
                prop::option::of(prop_oneof![
                    prop::num::f64::NORMAL | prop::num::f64::ZERO | prop::num::f64::SUBNORMAL | prop::num::f64::INFINITE,
                    (-3_000_000_000_i64..3_000_000_000).prop_map(|nanos| nanos as f64 / 1e9),
                    (-3_i32..3).prop_map(f64::from),
                ]),
                0..40,
            ),
        ) {
            let column = column_of(&numbers);
            prop_assert_eq!(column.len(), numbers.len());
            for (at, number) in numbers.iter().enumerate() {
                prop_assert!(is_same(column.get(at), *number), "{} of {:?}", at, column);
            }
        }
    }
}
