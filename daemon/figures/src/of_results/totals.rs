//! Distributions of the totals of configurations.

use peernet_statistics::number::{self, fixed};

use super::columns::{excluded_note, is_drawable, too_large_note};
use super::configured::{Configured, counted_rows};
use super::missing_data::MissingData;
use super::written::{Drawing, Shown};
use crate::drawing::{Cumulative, CumulativeCurve, MOST_CURVES, Unit};
use crate::look::series;
use peernet_analysis::loaded::Loaded;
use peernet_analysis::order::SortedValues;
use peernet_analysis::rows::RowRef;

/// Width of a curve, points.
const LINE_WIDTH: f64 = 1.0;

/// Returns one curve for each configuration, four to a figure; repeats are merged.
pub(super) fn drawings(runs: &[Loaded]) -> Result<Vec<Drawing>, MissingData> {
    let Configured { axes, groups } = Configured::from_runs(runs);
    let all = || groups.iter().flat_map(|(_, runs)| counted_rows(runs));
    // If one iteration has no measured total, all curves are the sums of their stages.
    let total = if all().all(|row| row.value("total").is_some()) { "total" } else { "stages-total" };
    let values = |runs: &[&Loaded]| -> SortedValues {
        let totals = counted_rows(runs).filter_map(|row: RowRef<'_>| row.value(total));
        totals.filter(|value| is_drawable(*value)).collect()
    };
    let known: Vec<(&String, SortedValues)> = groups
        .iter()
        .map(|(label, runs)| (label, values(runs)))
        .filter(|(_, values)| !values.is_empty())
        .collect();
    if known.is_empty() {
        return Err(MissingData::Total);
    }
    let without = groups.len() - known.len();
    let mut missing = Vec::new();
    if without > 0 {
        missing
            .push(format!("left out: {} without a total", number::counted(without as u64, "configuration")));
    }
    let what = if total == "total" { "measured total" } else { "sum of stages" };
    let mut notes = vec![format!("configurations: {} · {what}", axes.join(", "))];
    notes.extend(excluded_note(&runs.iter().flat_map(|run| &run.rows)));
    notes.extend(too_large_note(all(), &[total]));
    notes.extend(missing.iter().cloned());
    let pictures = known.chunks(MOST_CURVES).enumerate().map(|(number, known)| {
        let suffix = if number == 0 { String::new() } else { format!("-{}", number + 1) };
        let counts = || known.iter().map(|(_, values)| values.len());
        let [fewest, most] =
            [counts().min(), counts().max()].map(|count| fixed(count.unwrap_or_default() as f64, 0));
        let each = if fewest == most { most } else { format!("{fewest} to {most}") };
        let shown = Cumulative {
            title: "Total by configuration".to_owned(),
            unit: Unit::milliseconds("Total"),
            curves: known.iter().enumerate().map(|(number, known)| curve(known, number)).collect(),
            notes: std::iter::once(format!("n = {each} each")).chain(notes.iter().cloned()).collect(),
        };
        let drawing = Drawing::new(format!("totals{suffix}"), Shown::Cumulative(shown));
        // All figures have these notes, so other texts need them only once.
        if number == 0 { drawing.without(missing.clone()) } else { drawing }
    });
    Ok(pictures.collect())
}

fn curve((label, values): &(&String, SortedValues), number: usize) -> CumulativeCurve {
    let look = series(number);
    let mark = (look.mark, look.marks());
    CumulativeCurve { name: (*label).clone(), line: look.line(LINE_WIDTH), mark, values: values.clone() }
}
