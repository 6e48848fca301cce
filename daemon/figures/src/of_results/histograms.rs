//! Histograms of a run: the six histograms of the paper's original program, or the histogram of a column.

use peernet_logger::stage;
use peernet_statistics::number::{fixed, interval_ms, is_exact, throughput_between};
use peernet_stream::PlacementKind;

use super::columns::{count_note, heading, too_large_note, unit, values};
use super::missing_data::MissingData;
use super::replayed::title_of_column;
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::Histogram;
use peernet_analysis::figure_files::HISTOGRAMS;
use peernet_analysis::loaded::Loaded;
use peernet_analysis::order::SortedValues;
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::Rows;
use peernet_analysis::summary::{Scale, median_bounds_of};

/// Returns the histograms of the paper's original program. A histogram without values is left out if runs at the
/// placement of this run do not have such values.
pub(super) fn original_histograms(record: &RunRecord, rows: &Rows) -> Vec<Drawing> {
    let has_placement = |kind| record.placement.is(kind);
    let is_remote = !has_placement(PlacementKind::Local) && !has_placement(PlacementKind::None);
    let drawings = HISTOGRAMS.iter().filter_map(|(stem, column, title)| {
        let histogram = histogram(record, rows, column, title);
        // Every run senses. A run without a placement has only a sensor and no model. Only a cloud is reached over a
        // network.
        let is_expected = match *column {
            "sensing" => true,
            "inference" => !has_placement(PlacementKind::None),
            _ => is_remote,
        };
        (is_expected || !histogram.values.is_empty())
            .then(|| Drawing::new(*stem, AnyFigure::Histogram(histogram)))
    });
    drawings.collect()
}

/// Returns the histogram of `column`. If no column is given, returns the histograms of the paper's original program.
pub(super) fn drawings(run: &Loaded, column: Option<&str>) -> Result<Vec<Drawing>, MissingData> {
    let Some(column) = column else { return Ok(original_histograms(&run.record, &run.rows)) };
    let histogram = histogram(&run.record, &run.rows, column, &heading(column));
    if histogram.values.is_empty() {
        return Err(MissingData::Column(column.to_owned()));
    }
    Ok(vec![Drawing::new(format!("{column}-histogram"), AnyFigure::Histogram(histogram))])
}

fn histogram(record: &RunRecord, rows: &Rows, column: &str, title: &str) -> Histogram {
    let values = values(rows, column);
    let mut notes = vec![count_note(&rows.iter(), values.len())];
    notes.extend(too_large_note(rows.iter(), &[column]));
    notes.extend(clock_bounds_note(rows, column));
    notes.extend(negative_delays_note(column, &values));
    Histogram {
        title: title_of_column(title, column, record),
        unit: unit(&record.units, column, title),
        stage: column.to_owned(),
        values,
        notes,
    }
}

/// Returns a note on the number of delays below zero; `None` if there are none. Negative delays are impossible. They
/// are measured if the clocks are not related, as in results of other programs.
fn negative_delays_note(column: &str, values: &SortedValues) -> Option<String> {
    let count = values.values().partition_point(|value| *value < 0.0) as u64;
    (stage::is_one_way(column) && count > 0)
        .then(|| format!("below zero because of the clocks' error: {}", fixed(count as f64, 0)))
}

/// Returns a note on the bounds of the true median. The true median lies between the median of the lower clock bounds
/// and the median of the upper clock bounds. `None` if a value of the column in the statistics has no bounds, or if the
/// two medians are equal because one clock stamped both departure and arrival of all messages.
fn clock_bounds_note(rows: &Rows, column: &str) -> Option<String> {
    let (lo, hi) = median_bounds_of(rows, column)?;
    // The scale of a column with clock bounds follows from its name, so no logged unit is needed.
    let interval = match Scale::for_column(column, None) {
        Scale::MegabytesPerSecond => {
            format!("{} MB/s", throughput_between((lo, Some(hi))))
        }
        _ => format!("{} ms", interval_ms(lo, hi)),
    };
    (!is_exact(hi - lo)).then(|| format!("clock bounds of the median: {interval}"))
}
