//! Formatting of a summary as tables.

use std::collections::BTreeMap;

use peernet_analysis::accuracy::{ACCURACIES, ACCURACY_TITLES};
use peernet_analysis::compare::replayed_configurations;
use peernet_analysis::outcomes::failed_texts;
use peernet_analysis::record::DelayQuality;
use peernet_analysis::rows::Units;
use peernet_analysis::summary::{Quantity, Scale, Summary, is_reported_as_count};
use peernet_analysis::table::{Table, csv_text, decimals_of};
use peernet_analysis::trust::Starts;
use peernet_statistics::number::{
    self, NONE as UNKNOWN, bound_ms, column_decimals, count, fixed, fixed_ms, is_exact, join_ends,
    join_mean_std,
};

/// Columns of the *Tabulated Metrics* in the paper's appendix, with their names in the paper, and as
/// the last two entries the totals.
const PAPER_METRICS: [(&str, &str); 10] = [
    ("sensing", "Sensing Time"),
    ("upload-bytes", "Upload Size"),
    ("upload", "Upload Latency"),
    ("upload-throughput", "Upload Throughput"),
    ("inference", "Inference Latency"),
    ("download-bytes", "Download Size"),
    ("download", "Download Latency"),
    ("download-throughput", "Download Throughput"),
    ("stages-total", "Total (sum of stages)"),
    ("total", "Total (measured)"),
];
/// Names of further columns that are clearer than the names of the columns in `data.csv`.
const COLUMN_NAMES: [(&str, &str); 6] = [
    ("ipc", "IPC with the model's process"),
    ("capture_capture-ipc", "IPC with the sensor's process"),
    ("actuation_actuation-ipc", "IPC with the actuator's process"),
    ("restart", "Restart of the model's process"),
    ("capture_capture-restart", "Restart of the sensor's process"),
    ("actuation_actuation-restart", "Restart of the actuator's process"),
];

/// Formats a summary as Markdown for documents: the table, then sentences about the iterations, clocks and deadlines.
pub fn markdown(summary: &Summary) -> String {
    let title = if summary.title.is_empty() { String::new() } else { format!("# {}\n\n", summary.title) };
    format!("{title}{}\n{}\n", table(summary).markdown(), sentences(summary))
}

/// Formats a summary for the terminal.
pub fn text(summary: &Summary) -> String {
    format!("{}\n\n{}", table(summary).text(), sentences(summary))
}

/// Formats a summary as LaTeX for papers, with booktabs.
pub fn latex(summary: &Summary) -> String {
    table(summary).latex(&[summary.title.as_str(), &sentences(summary).replace('\n', " ")].join(". "))
}

/// Formats a summary as CSV for programs: seconds, bytes, bits per second, with all digits.
pub fn csv(summary: &Summary) -> String {
    let header = ["column", "count", "mean", "std", "median", "median-lo", "median-hi", "p95", "p99", "max"];
    let cell = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
    let row = |quantity: &Quantity| {
        let Quantity { count, mean, std, median, p95, p99, max, bounds, .. } = *quantity;
        let numbers =
            [Some(mean), std, Some(median), bounds.map(|b| b.0), bounds.map(|b| b.1), p95, p99, Some(max)];
        [quantity.column.to_string(), count.to_string()].into_iter().chain(numbers.map(cell)).collect()
    };
    csv_text(&header, &summary.quantities.iter().map(row).collect::<Vec<_>>())
}

/// Returns the table: the metrics of the paper first, then all other columns.
fn table(summary: &Summary) -> Table {
    let paper_metrics =
        PAPER_METRICS.iter().filter_map(|(column, name)| Some((summary.quantity(column)?, *name)));
    let rest = summary
        .quantities
        .iter()
        .filter(|quantity| PAPER_METRICS.iter().all(|(name, _)| *name != quantity.column))
        // The sentences below the table report these columns.
        .filter(|quantity| !is_reported_as_count(&quantity.column));
    let rest = rest.map(|quantity| {
        let column = quantity.column.as_ref();
        (
            quantity,
            COLUMN_NAMES
                .iter()
                .find(|(name, _)| *name == column)
                .map_or(column, |(_, clear_name)| clear_name),
        )
    });
    let digits = Digits::for_summary(summary);
    let header = ["metric", "unit", "count", "mean ± std", "median", "clock bounds", "p95", "p99", "max"];
    Table {
        header: header.map(str::to_owned).to_vec(),
        label_columns: 2,
        rows: paper_metrics
            .chain(rest)
            .map(|(quantity, name)| cells(quantity, name, &summary.units, digits))
            .collect(),
        marked: None,
    }
}

/// Returns the sentences below the table, one per line.
fn sentences(summary: &Summary) -> String {
    let has_uncertain_bounds =
        |quantity: &Quantity| quantity.bounds.is_some_and(|(lo, hi)| !is_exact(hi - lo));
    let needs_explanation = summary.quantities.iter().any(has_uncertain_bounds);
    let bounds = if needs_explanation { "Clock bounds contain the median of the true values." } else { "" };
    let unknown_labels = summary.unknown_labels.as_ref().map(|labels| labels.sentence(summary.counts.ok));
    let replayed = replayed_configurations([(String::new(), summary.replayed.as_deref())]);
    let paragraphs = [
        replayed.unwrap_or_default(),
        outcomes(summary),
        deadline(summary),
        accuracies(summary),
        summary.actuator.sentences(summary.counts.ok).join("\n"),
        starts(&summary.starts),
        clocks(&summary.clocks.upload, &summary.clocks.download),
        bounds.to_owned(),
        unknown_labels.unwrap_or_default(),
    ];
    paragraphs.into_iter().filter(|paragraph| !paragraph.is_empty()).collect::<Vec<_>>().join("\n")
}

/// Returns the row of a quantity.
fn cells(quantity: &Quantity, name: &str, units: &Units, digits: Digits) -> Vec<String> {
    let unit = units.of(&quantity.column);
    let scale = Scale::for_column(&quantity.column, unit);
    let decimals = match scale {
        Scale::Milliseconds => digits.milliseconds,
        Scale::MegabytesPerSecond => digits.megabytes_per_second,
        Scale::Bytes | Scale::AsMeasured => scale.decimals(quantity.median),
    };
    let format_number = |value: f64| {
        if value.is_infinite() { "∞".to_owned() } else { fixed(value * scale.factor(), decimals) }
    };
    let format_value = |value: f64| {
        if scale == Scale::Milliseconds { fixed_ms(value, decimals) } else { format_number(value) }
    };
    let quantile_cell = |value: Option<f64>| value.map_or_else(|| UNKNOWN.to_owned(), format_value);
    let bounds = match quantity.bounds {
        None => String::new(),
        Some((lo, hi)) if is_exact(hi - lo) => number::EXACT.to_owned(),
        Some((lo, hi)) => join_ends([format_number(lo), format_number(hi)]),
    };
    vec![
        name.to_owned(),
        scale.symbol(unit.unwrap_or_default()).to_owned(),
        count(quantity.count),
        join_mean_std((format_value(quantity.mean), quantity.std.map(format_number))),
        quantile_cell(Some(quantity.median)),
        bounds,
        quantile_cell(quantity.p95),
        quantile_cell(quantity.p99),
        quantile_cell(Some(quantity.max)),
    ]
}

/// Numbers of decimals for ms and for MB/s. They are the same in all rows, so that the numbers of a column can be compared.
#[derive(Clone, Copy)]
struct Digits {
    milliseconds: usize,
    megabytes_per_second: usize,
}

impl Digits {
    fn for_summary(summary: &Summary) -> Self {
        let with_scale = |scale: Scale| {
            let has_scale = move |quantity: &&Quantity| {
                Scale::for_column(&quantity.column, summary.units.of(&quantity.column)) == scale
            };
            summary.quantities.iter().filter(has_scale)
        };
        Self {
            milliseconds: column_decimals(with_scale(Scale::Milliseconds).map(|quantity| quantity.std)),
            megabytes_per_second: decimals_of(
                with_scale(Scale::MegabytesPerSecond)
                    .map(|quantity| quantity.median * Scale::MegabytesPerSecond.factor()),
            ),
        }
    }
}

/// Returns the sentence about the outcomes of the iterations.
fn outcomes(summary: &Summary) -> String {
    let counts = &summary.counts;
    let warm_up = match summary.failed_in_warm_up {
        0 => "warm-up, left out".to_owned(),
        failed => format!("warm-up, left out ({} of them failed)", count(failed)),
    };
    let others = [(counts.warm_up, warm_up), (counts.unseen, "measured but not recorded".to_owned())];
    let others = others.into_iter().filter(|(number, _)| *number > 0);
    let texts: Vec<String> = std::iter::once(format!("{} succeeded", count(counts.ok)))
        .chain(failed_texts(&counts.outcomes()))
        .chain(others.map(|(number, text)| format!("{} {text}", count(number))))
        .collect();
    format!("Iterations: {}.", texts.join("; "))
}

/// Returns the sentence about missed deadlines; empty without a deadline.
fn deadline(summary: &Summary) -> String {
    let text = summary.misses.and_then(|misses| misses.text(summary.deadline_s));
    text.map_or_else(String::new, |text| format!("{text}."))
}

/// Returns the sentences about the accuracies of the model; empty if the right answers are not known.
fn accuracies(summary: &Summary) -> String {
    let sentence = |(column, name): (&str, &str)| {
        let accuracy = summary.accuracy.get(column)?;
        Some(format!("{name}: {accuracy}."))
    };
    ACCURACIES.into_iter().zip(ACCURACY_TITLES).filter_map(sentence).collect::<Vec<_>>().join("\n")
}

/// Returns the sentence about skipped starts; empty if no start was skipped.
fn starts(starts: &Starts) -> String {
    starts.skipped_text().map_or_else(String::new, |text| format!("Skipped: {text}."))
}

/// Returns the sentence about the clock verdicts of the delays; empty if there are no delays.
fn clocks(up: &DelayQuality, down: &DelayQuality) -> String {
    let list = |counts: &BTreeMap<String, u64>| {
        let items = counts.iter().map(|(name, count)| format!("{} {name}", number::count(*count)));
        items.collect::<Vec<_>>().join(", ")
    };
    let direction = |name: &str, quality: &DelayQuality| {
        let sources: Vec<&str> = quality.sources.keys().map(String::as_str).collect();
        let width = quality.median_width.map(|width| bound_ms(width / 2.0));
        let width = width.map(|width| if width == number::EXACT { width } else { format!("{width} ms") });
        let sources_and_width: Vec<&str> = sources.into_iter().chain(width.as_deref()).collect();
        let has_delays = !quality.verdicts.is_empty();
        has_delays.then(|| format!("{name} {} ({})", list(&quality.verdicts), sources_and_width.join(", ")))
    };
    let directions: Vec<String> =
        [direction("upload", up), direction("download", down)].into_iter().flatten().collect();
    if directions.is_empty() { String::new() } else { format!("Clock verdicts: {}.", directions.join("; ")) }
}
