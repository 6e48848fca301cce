//! A study as tables.

use std::path::Path;

use peernet_clock::{Direction, Span};
use peernet_statistics::number::{
    self, EXACT, NONE as UNKNOWN, bytes, mean_std, milliseconds, range_ms, throughput_between,
};

use super::Study;
use super::direction::{DirectionStudy, SizeSummary, Throughput};
use super::sample::Sample;
use crate::fit::Fit;
use crate::table::{csv, text};
use crate::{Passage, WriteError};

const PASSAGE: [&str; 8] = ["bytes", "logger-bytes", "raw", "", "lo", "hi", "source", "verdict"];

/// One row per iteration: seconds, bytes.
pub(super) fn samples(samples: &[Sample], path: &Path) -> Result<(), WriteError> {
    let columns = |stage: &str| {
        PASSAGE.map(|column| if column.is_empty() { stage.to_owned() } else { format!("{stage}-{column}") })
    };
    let mut header =
        ["iteration", "at", "payload-bytes", "warm-up", "outcome", "total"].map(str::to_owned).to_vec();
    header.extend(columns("upload"));
    header.extend(columns("download"));
    header.push("reason".to_owned());
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    csv(path, &header, samples.iter().map(sample_row))
}

fn sample_row(sample: &Sample) -> Vec<String> {
    let mut row = vec![
        sample.number.to_string(),
        format!("{:.6}", sample.at),
        sample.payload_bytes.to_string(),
        sample.warm_up.to_string(),
        sample.outcome.to_owned(),
        cell(sample.total.map(seconds)),
    ];
    for direction in [Direction::Up, Direction::Down] {
        row.extend(
            sample.passage(direction).map_or_else(|| vec![String::new(); PASSAGE.len()], passage_cells),
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
        passage.logger_bytes.to_string(),
        span(delay.raw),
        cell(delay.value.map(span)),
        cell(delay.bounds.map(|bounds| span(bounds.lo))),
        cell(delay.bounds.map(|bounds| span(bounds.hi))),
        delay.source.to_string(),
        delay.verdict.to_string(),
    ]
}

/// One row per size and direction: seconds, bytes, bits per second.
pub(super) fn summary(study: &Study, path: &Path) -> Result<(), WriteError> {
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
    csv(path, &header, rows)
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

/// To the nanosecond.
fn seconds(seconds: f64) -> String {
    format!("{seconds:.9}")
}

/// Empty where nothing is known.
fn cell(value: Option<String>) -> String {
    value.unwrap_or_default()
}

/// What each size took, both directions side by side.
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
    let rows: Vec<Vec<String>> = study
        .setting
        .sizes_bytes
        .iter()
        .map(|&payload| {
            let of = |direction: &DirectionStudy| {
                let size = direction.sizes.iter().find(|size| size.payload_bytes == payload);
                size.map_or_else(
                    || vec![UNKNOWN.to_owned(); 4],
                    |size| size_cells(size, direction.same_clock),
                )
            };
            let [up, down] = study.directions().map(of);
            [vec![bytes(payload as f64).plain()], up, down].concat()
        })
        .collect();
    text(&header, &rows)
}

fn size_cells(size: &SizeSummary, same_clock: bool) -> Vec<String> {
    let bounds = if same_clock { Some(EXACT.to_owned()) } else { size.bounds.map(range_ms) };
    vec![
        milliseconds(size.median),
        known(size.tails.map(range_ms)),
        known(bounds),
        known(size.throughput.map(number::throughput)),
    ]
}

/// The lines that were fitted, and what the clocks claim beside them.
pub(super) fn fits_text(study: &Study) -> String {
    let header = ["line of best fit", "intercept ms", "95 % confidence", "MB/s", "95 % confidence"];
    let mut rows = Vec::new();
    for direction in study.directions() {
        let Some(fits) = &direction.fits else { continue };
        let ways = [
            ("least squares, medians", &fits.medians.least_squares),
            ("Theil–Sen, medians", &fits.medians.theil_sen),
            ("least squares, all samples", &fits.samples.least_squares),
            ("Theil–Sen, all samples", &fits.samples.theil_sen),
            ("as published: raw stamps", &fits.raw),
        ];
        rows.extend(ways.map(|(way, fit)| fit_row(format!("{}: {way}", direction.name()), fit)));
        rows.push(bounds_row(direction));
    }
    if rows.is_empty() { String::new() } else { text(&header, &rows) }
}

fn fit_row(name: String, fit: &Fit) -> Vec<String> {
    let throughput = Throughput::of(fit.slope);
    vec![
        name,
        mean_std(fit.intercept.value, fit.intercept.margin()),
        known(fit.intercept.interval.map(range_ms)),
        known(throughput.map(|throughput| number::throughput(throughput.value))),
        known(throughput.and_then(|throughput| throughput.interval).map(throughput_between)),
    ]
}

/// What the clock bounds allow, to stand below the lines.
fn bounds_row(direction: &DirectionStudy) -> Vec<String> {
    let throughput = direction.throughput.and_then(|throughput| throughput.bounds);
    let (delay, throughput) = if direction.same_clock {
        (Some(EXACT.to_owned()), Some(EXACT.to_owned()))
    } else {
        let claim = direction.claimed.map(|claim| range_ms(claim.at_zero));
        (claim, throughput.map(throughput_between))
    };
    vec![
        format!("{}: what the clock bounds allow", direction.name()),
        String::new(),
        known(delay),
        String::new(),
        known(throughput),
    ]
}

fn known(figure: Option<String>) -> String {
    figure.unwrap_or_else(|| UNKNOWN.to_owned())
}
