//! Histograms of a run: the six published histograms, or the histogram of a column.

use peernet_statistics::number::{fixed, range_ms, throughput_between};
use peernet_stream::PlacementKind;

use super::columns::{count_note, heading, too_large_note, unit, values, with_run_name};
use super::missing_data::MissingData;
use super::written::{Drawing, Shown};
use crate::drawing::Histogram;
use peernet_analysis::figure_files::HISTOGRAMS;
use peernet_analysis::loaded::Loaded;
use peernet_analysis::order::SortedValues;
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::Rows;
use peernet_analysis::summary::Scale;

/// Returns the published histograms that a run has the data for.
pub(super) fn published(record: &RunRecord, rows: &Rows) -> Vec<Drawing> {
    let is_at = |kind| record.placement.is(kind);
    let remote = !is_at(PlacementKind::Local) && !is_at(PlacementKind::None);
    let drawings = HISTOGRAMS.iter().filter_map(|(stem, column, what)| {
        let histogram = histogram(record, rows, column, what);
        let expected = match *column {
            "sensing" => true,
            "inference" => !is_at(PlacementKind::None),
            _ => remote,
        };
        (expected || !histogram.values.is_empty()).then(|| Drawing::new(*stem, Shown::Histogram(histogram)))
    });
    drawings.collect()
}

/// Returns the published histograms, or the histogram of `column`.
pub(super) fn drawings(run: &Loaded, column: Option<&str>) -> Result<Vec<Drawing>, MissingData> {
    let Some(column) = column else { return Ok(published(&run.record, &run.rows)) };
    let histogram = histogram(&run.record, &run.rows, column, &heading(column));
    if histogram.values.is_empty() {
        return Err(MissingData::Column(column.to_owned()));
    }
    Ok(vec![Drawing::new(format!("{column}-histogram"), Shown::Histogram(histogram))])
}

fn histogram(record: &RunRecord, rows: &Rows, column: &str, what: &str) -> Histogram {
    let values = values(rows, column);
    let mut notes = vec![count_note(&rows.iter(), values.len())];
    notes.extend(too_large_note(rows.iter(), &[column]));
    notes.extend(clocks(rows, column));
    notes.extend(impossible(column, &values));
    Histogram {
        title: with_run_name(what, &record.title),
        unit: unit(&record.units, column, what),
        stage: column.to_owned(),
        values,
        notes,
    }
}

/// Returns a note on delays below zero, which are impossible. They occur if the clocks are not related, as in results of other programs.
fn impossible(column: &str, values: &SortedValues) -> Option<String> {
    let count = values.values().partition_point(|value| *value < 0.0) as u64;
    let is_delay = ["upload", "download"].contains(&column);
    (is_delay && count > 0).then(|| format!("below zero, by the clocks' error: {}", fixed(count as f64, 0)))
}

/// Returns a note on the bounds of the true median by the clock bounds: it lies between the medians of the lower and the upper bounds.
/// `None` if the column has no bounds, or one clock measured both ends.
fn clocks(rows: &Rows, column: &str) -> Option<String> {
    let end = |end: &str| -> Option<f64> {
        let name = format!("{column}-{end}");
        let counted = rows.iter().filter(|row| row.is_counted() && row.value(column).is_some());
        counted.map(|row| row.value(&name)).collect::<Option<SortedValues>>()?.median()
    };
    if !["upload", "download", "upload-throughput", "download-throughput"].contains(&column) {
        return None;
    }
    let (lo, hi) = (end("lo")?, end("hi")?);
    let between = match Scale::for_column(column, None) {
        Scale::MegabytesPerSecond => {
            format!("{} MB/s", throughput_between((lo, Some(hi))))
        }
        _ => format!("{} ms", range_ms((lo, hi))),
    };
    (lo < hi).then(|| format!("clock bounds of the median: {between}"))
}
