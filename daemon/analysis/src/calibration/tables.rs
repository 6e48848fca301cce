//! Tables of a study.

use std::path::Path;

use peernet_clock::{Direction, Span};
use peernet_statistics::number::{
    BITS_PER_MB, EXACT, NONE as UNKNOWN, bytes, decimals, fixed, fixed_or_less_than, join_ends,
};

use super::Study;
use super::direction::{DirectionStudy, Throughput};
use super::passage::Passage;
use super::sample::Sample;
use crate::WriteError;
use crate::message_sizes::SizeSummary;
use crate::table::{decimals_of, text, write_csv};

/// Maximum number of decimals of a number of ms: a tenth of a microsecond.
const MAX_MS_DECIMALS: usize = 4;
/// Columns of one direction, as suffixes of the name of its stage: `upload-bytes`. The column of the delay has no
/// suffix: `upload`.
const PASSAGE_COLUMNS: [&str; 8] = ["bytes", "logger-bytes", "raw", "", "lo", "hi", "source", "verdict"];

/// Writes `samples.csv`, which has a row for each iteration. The units are seconds and bytes.
pub(super) fn write_samples(samples: &[Sample], path: &Path) -> Result<(), WriteError> {
    let columns = |stage: &str| {
        PASSAGE_COLUMNS
            .map(|column| if column.is_empty() { stage.to_owned() } else { format!("{stage}-{column}") })
    };
    let mut header =
        ["iteration", "at", "payload-bytes", "warm-up", "outcome", "total"].map(str::to_owned).to_vec();
    header.extend(columns("upload"));
    header.extend(columns("download"));
    header.push("reason".to_owned());
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    write_csv(path, &header, samples.iter().map(sample_row))
}

fn sample_row(sample: &Sample) -> Vec<String> {
    let mut row = vec![
        sample.number.to_string(),
        format!("{:.6}", sample.at),
        sample.payload_bytes.to_string(),
        u8::from(sample.warm_up).to_string(),
        sample.outcome.name().to_owned(),
        cell(sample.total.map(seconds)),
    ];
    for direction in Direction::ALL {
        row.extend(
            sample
                .passage(direction)
                .map_or_else(|| vec![String::new(); PASSAGE_COLUMNS.len()], passage_cells),
        );
    }
    row.push(cell(sample.reason.clone()));
    row
}

fn passage_cells(passage: &Passage) -> Vec<String> {
    let delay = &passage.delay;
    let span = |span: Span| seconds(span.seconds());
    vec![
        passage.payload_bytes.to_string(),
        passage.metadata_bytes.to_string(),
        span(delay.raw),
        cell(delay.value.map(span)),
        cell(delay.bounds.map(|bounds| span(bounds.lo))),
        cell(delay.bounds.map(|bounds| span(bounds.hi))),
        delay.source.to_string(),
        delay.verdict.to_string(),
    ]
}

/// Writes `summary.csv`, which has a row for each size in each direction. The units are seconds, bytes and bits per
/// second.
pub(super) fn write_summary(study: &Study, path: &Path) -> Result<(), WriteError> {
    let header = [
        "stage",
        "payload-bytes",
        "wire-bytes",
        "count",
        "median",
        "median-error",
        "p5",
        "p95",
        "lo",
        "hi",
        "throughput",
        "throughput-lo",
        "throughput-hi",
    ];
    let rows = study
        .directions()
        .into_iter()
        .flat_map(|direction| direction.sizes.iter().map(|size| summary_row(direction.name(), size)));
    write_csv(path, &header, rows)
}

fn summary_row(stage: &str, size: &SizeSummary) -> Vec<String> {
    let rate = |rate: f64| format!("{rate:.0}");
    vec![
        stage.to_owned(),
        size.payload_bytes.to_string(),
        format!("{:.0}", size.wire_bytes),
        size.count.to_string(),
        seconds(size.median),
        cell(size.median_error.map(seconds)),
        cell(size.tails.map(|tails| seconds(tails.0))),
        cell(size.tails.map(|tails| seconds(tails.1))),
        cell(size.bounds.map(|bounds| seconds(bounds.0))),
        cell(size.bounds.map(|bounds| seconds(bounds.1))),
        cell(size.throughput.map(rate)),
        cell(size.throughput_bounds.map(|bounds| rate(bounds.0))),
        cell(size.throughput_bounds.and_then(|bounds| bounds.1).map(rate)),
    ]
}

/// Formats seconds to the nanosecond.
fn seconds(seconds: f64) -> String {
    format!("{seconds:.9}")
}

/// Returns the text of a cell; empty if the value is unknown.
fn cell(value: Option<String>) -> String {
    value.unwrap_or_default()
}

/// Returns the table of sizes, with both directions in each row.
pub(super) fn sizes_text(study: &Study) -> String {
    let header = [
        "payload",
        "upload ms",
        "p5 – p95",
        "clock bounds",
        "MB/s",
        "download ms",
        "p5 – p95",
        "clock bounds",
        "MB/s",
    ];
    let sizes = &study.setting.sizes_bytes;
    let [up, down] = study.directions().map(|direction| size_columns(direction, sizes));
    let rows = sizes.iter().zip(up.into_iter().zip(down));
    let rows = rows.map(|(payload, (up, down))| [vec![bytes(*payload as f64).plain()], up, down].concat());
    text(&header, &rows.collect::<Vec<_>>())
}

/// Returns the cells of one direction, a row for each payload; all numbers of a column have the same number of
/// decimals.
fn size_columns(direction: &DirectionStudy, payloads: &[u64]) -> Vec<Vec<String>> {
    let sizes = &direction.sizes;
    let ms_decimals = decimals_of(sizes.iter().map(|size| size.median * 1e3));
    let rates = sizes.iter().filter_map(|size| size.throughput);
    let mb_decimals = decimals_of(rates.map(|rate| rate / BITS_PER_MB));
    let range = |(lo, hi): (f64, f64)| join_ends([lo, hi].map(|end| fixed(end * 1e3, ms_decimals)));
    let cells = |size: &SizeSummary| {
        let bounds = if direction.same_clock { Some(EXACT.to_owned()) } else { size.bounds.map(range) };
        let rate = size.throughput.map(|rate| fixed_or_less_than(rate / BITS_PER_MB, mb_decimals));
        vec![
            fixed(size.median * 1e3, ms_decimals),
            or_unknown(size.tails.map(range)),
            or_unknown(bounds),
            or_unknown(rate),
        ]
    };
    let row = |payload: &u64| {
        let size = sizes.iter().find(|size| size.payload_bytes == *payload);
        size.map_or_else(|| vec![UNKNOWN.to_owned(); 4], cells)
    };
    payloads.iter().map(row).collect()
}

/// Returns the table of the fitted lines and of the bounds that the clocks allow.
pub(super) fn fits_text(study: &Study) -> String {
    let header = ["line of best fit", "intercept ms", "95 % confidence", "MB/s", "95 % confidence"];
    let rows: Vec<Vec<String>> = study.directions().into_iter().flat_map(fit_rows).collect();
    if rows.is_empty() { String::new() } else { text(&header, &rows) }
}

/// Returns the rows of one direction: its fitted lines and the clock bounds; all numbers of a column have the same
/// number of decimals.
fn fit_rows(direction: &DirectionStudy) -> Vec<Vec<String>> {
    let Some(fits) = &direction.fits else { return Vec::new() };
    let methods = [
        ("least squares, medians", &fits.medians.least_squares),
        ("Theil–Sen, medians", &fits.medians.theil_sen),
        ("least squares, all samples", &fits.samples.least_squares),
        ("Theil–Sen, all samples", &fits.samples.theil_sen),
        ("as published: raw stamps", &fits.raw),
    ];
    let rates = methods.map(|(_, fit)| Throughput::from_slope(fit.slope));
    let margins = methods.iter().filter_map(|(_, fit)| fit.intercept.margin());
    let decimals_for = |seconds: f64| decimals(seconds * 1e3, 2).min(MAX_MS_DECIMALS);
    let ms_decimals = margins
        .map(decimals_for)
        .max()
        .unwrap_or_else(|| decimals_for(fits.medians.least_squares.intercept.value));
    let mb_decimals = decimals_of(rates.iter().flatten().map(|rate| rate.value / BITS_PER_MB));
    let ms = |seconds: f64| fixed(seconds * 1e3, ms_decimals);
    let mb = |rate: f64| fixed_or_less_than(rate / BITS_PER_MB, mb_decimals);
    let delay_range = |(lo, hi): (f64, f64)| join_ends([ms(lo), ms(hi)]);
    let throughput_range = |(lo, hi): (f64, Option<f64>)| match hi.filter(|hi| hi.is_finite()) {
        // The interval of the slope reaches zero, so the throughput has no upper end.
        None => format!("≥ {}", mb(lo)),
        Some(hi) => join_ends([mb(lo), mb(hi)]),
    };
    let mut rows: Vec<Vec<String>> = methods
        .iter()
        .zip(rates)
        .map(|((method, fit), rate)| {
            let margin =
                fit.intercept.margin().map_or_else(String::new, |margin| format!(" ± {}", ms(margin)));
            vec![
                format!("{}: {method}", direction.name()),
                format!("{}{margin}", ms(fit.intercept.value)),
                or_unknown(fit.intercept.interval.map(delay_range)),
                or_unknown(rate.map(|rate| mb(rate.value))),
                or_unknown(rate.and_then(|rate| rate.interval).map(throughput_range)),
            ]
        })
        .collect();
    let allowed_cells = if direction.same_clock {
        [Some(EXACT.to_owned()), Some(EXACT.to_owned())]
    } else {
        let bounds = direction.throughput.and_then(|throughput| throughput.bounds);
        [direction.allowed.map(|allowed| delay_range(allowed.at_zero)), bounds.map(throughput_range)]
    };
    let [delay, throughput] = allowed_cells.map(or_unknown);
    let name = format!("{}: what the clock bounds allow", direction.name());
    rows.push(vec![name, String::new(), delay, String::new(), throughput]);
    rows
}

/// Returns the text of a cell, or the sign for an unknown value.
fn or_unknown(text: Option<String>) -> String {
    text.unwrap_or_else(|| UNKNOWN.to_owned())
}
