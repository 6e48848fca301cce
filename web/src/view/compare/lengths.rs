//! Response length against latency: some of the iterations as points, and the distributions of all iterations.

#[cfg(test)]
pub(crate) mod tests;

use peernet_analysis::answer_length::{
    Growth, LATENCY, NO_USAGE, answer_length, is_tokens, lacks_usage, varies,
};
use peernet_figures::drawing::{BinnedAxis, Joint};
use peernet_figures::look::stage;
use peernet_figures::plot::Unit;
use peernet_logger::IterationValues;
use peernet_statistics::Summary;
use peernet_statistics::number::{self, bytes, count, duration, fixed};
use peernet_store::{RunSummary, StageStatistics, Store};

use super::{Comparison, Configuration};
use crate::error::WebError;
use crate::picture::Picture;

/// Maximum number of configurations that are drawn.
const MAX_CONFIGURATIONS: usize = 6;
/// Maximum number of iterations that a page reads, of all configurations together.
const MAX_READ: u64 = 1_500;
/// Maximum number of iterations that a page reads of one configuration.
const MAX_READ_PER_CONFIGURATION: u64 = 750;
/// Lengths are shown in kB if the longest answer has at least this number of bytes.
const MIN_BYTES_FOR_KB: f64 = 10_000.0;

/// A configuration whose answers differ in length.
struct VaryingLengths<'a> {
    configuration: &'a Configuration,
    /// Name of the node with the length of an answer.
    length_name: &'a str,
    lengths: &'a Summary,
    latencies: &'a Summary,
}

impl<'a> VaryingLengths<'a> {
    fn of(configuration: &'a Configuration) -> Option<Self> {
        let names = configuration.stages.iter().map(|statistics: &StageStatistics| statistics.stage.as_str());
        let length_name = answer_length(names);
        let (lengths, latencies) = (configuration.summary(length_name)?, configuration.summary(LATENCY)?);
        varies(lengths.moments.min, lengths.moments.max).then_some(Self {
            configuration,
            length_name,
            lengths,
            latencies,
        })
    }

    fn all(comparison: &'a Comparison) -> Vec<Self> {
        comparison.configurations.iter().filter_map(Self::of).collect()
    }

    /// Returns the unit of lengths: its name, and the factor from the measured value to this unit.
    fn unit(&self, longest: f64) -> (String, f64) {
        if is_tokens(self.length_name) {
            (self.length_name.replace(['-', '_'], " "), 1.0)
        } else if longest >= MIN_BYTES_FOR_KB {
            ("kB of answer".to_owned(), 1e-3)
        } else {
            ("bytes of answer".to_owned(), 1.0)
        }
    }

    /// Formats a length with its unit.
    fn format_length(&self, length: f64) -> String {
        if is_tokens(self.length_name) {
            format!("{} tokens", fixed(length, 0))
        } else {
            bytes(length).to_string()
        }
    }
}

/// Iterations of a configuration that were read from the store.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Answers {
    /// Name of the configuration.
    pub name: String,
    /// For each iteration the length of the answer in the measured unit, and the latency in seconds.
    pub points: Vec<(f64, f64)>,
    /// `true` if all stored iterations were read.
    pub is_whole: bool,
}

/// Returns whether statistics can include a value. Any other value has no position on an axis.
fn is_included(value: f64) -> bool {
    Summary::accepts(value)
}

/// Reads some iterations of each configuration that is drawn: the same share of the iterations of each run.
///
/// # Errors
/// Returns an error when the store cannot be read.
pub(crate) async fn answers(store: &Store, comparison: &Comparison) -> Result<Vec<Answers>, WebError> {
    let varying = VaryingLengths::all(comparison);
    let drawn = varying.len().min(MAX_CONFIGURATIONS);
    let mut all = Vec::with_capacity(drawn);
    for varying_configuration in &varying[..drawn] {
        // The page has a fixed budget of iterations, which the drawn configurations share equally.
        let max_read = (MAX_READ / drawn as u64).min(MAX_READ_PER_CONFIGURATION);
        // The number is at least 1, so that the divisor `all_answered` is not 0.
        let answered = |run: &RunSummary| run.counts.ok.max(1);
        let all_answered: u64 = varying_configuration.configuration.runs.iter().map(answered).sum();
        let mut answers = Answers {
            name: varying_configuration.configuration.name.clone(),
            points: Vec::new(),
            is_whole: true,
        };
        for run in &varying_configuration.configuration.runs {
            // The limit of `value_pairs` also counts warm-up and failed iterations. If the
            // successful iterations of all runs fit into `max_read`, each run is therefore read
            // with the larger limit `MAX_READ`, so that successful iterations are omitted only if
            // the run has more than `MAX_READ` iterations of any kind.
            let limit = if all_answered <= max_read {
                MAX_READ
            } else {
                (max_read * answered(run)).div_ceil(all_answered)
            };
            let pairs = store
                .value_pairs(run.number, [varying_configuration.length_name, LATENCY], limit as u32)
                .await?;
            answers.is_whole &= pairs.is_complete();
            answers
                .points
                .extend(pairs.points.into_iter().filter(|(x, y)| is_included(*x) && is_included(*y)));
        }
        all.push(answers);
    }
    Ok(all)
}

/// The picture of one configuration.
pub(crate) struct LengthRow {
    pub name: String,
    pub plot: Picture,
    /// `true` if the plot has cells that count points, because there are too many points to draw.
    has_cells: bool,
    /// Sentences about the plot, and about the iterations from which it is drawn.
    pub sentences: Vec<String>,
}

/// Pictures of the configurations, side by side.
pub(crate) struct Lengths {
    pub rows: Vec<LengthRow>,
    /// Names of the configurations that are not drawn; `None` if all are drawn.
    pub others: Option<String>,
    /// Sentence about the configurations whose servers reported no numbers of tokens; `None` if there are none.
    pub without_usage: Option<String>,
    /// `true` if any plot has cells that count points.
    pub has_cells: bool,
}

/// Returns `A; B: the server sent no …`: the configurations with language models whose servers reported no numbers of
/// tokens. `None` if there are none.
fn without_usage(comparison: &Comparison) -> Option<String> {
    let lacking = |one: &&Configuration| {
        lacks_usage(one.stages.iter().map(|statistics: &StageStatistics| statistics.stage.as_str()))
    };
    let names: Vec<&str> =
        comparison.configurations.iter().filter(lacking).map(|one| one.name.as_str()).collect();
    (!names.is_empty()).then(|| {
        format!("{}: {NO_USAGE} with peernet plot --kind length on the files of the runs.", names.join("; "))
    })
}

/// Draws the configurations whose answers differ in length, on shared axes. Also names the configurations whose servers
/// reported no numbers of tokens. `None` if there are no configurations of either kind.
pub(crate) fn lengths(comparison: &Comparison, answers: &[Answers]) -> Option<Lengths> {
    let mut varying = VaryingLengths::all(comparison);
    let not_drawn = varying.split_off(varying.len().min(MAX_CONFIGURATIONS));
    let without_usage = without_usage(comparison);
    // If no configuration is drawn, there are no values for an axis.
    let Some(vertical) = BinnedAxis::from_zero(
        varying.iter().map(|varying_configuration| varying_configuration.latencies),
        Unit::symbol("ms", 1e3),
    ) else {
        return without_usage.map(|sentence| Lengths {
            rows: Vec::new(),
            others: None,
            without_usage: Some(sentence),
            has_cells: false,
        });
    };
    let row = |varying_configuration: &VaryingLengths<'_>| {
        let same_unit = || {
            varying
                .iter()
                .filter(|other| other.length_name == varying_configuration.length_name)
                .map(|other| other.lengths)
        };
        let longest = same_unit().map(|lengths| lengths.moments.max).fold(0.0, f64::max);
        let (unit, per_si) = varying_configuration.unit(longest);
        let horizontal = BinnedAxis::from_zero(same_unit(), Unit::symbol(&unit, per_si))?;
        let sample = answers.iter().find(|sample| sample.name == varying_configuration.configuration.name);
        let sample = sample.cloned().unwrap_or_default();
        let growth = Growth::from_iterations(&sample.points);
        let slope = match &growth {
            Ok(growth) => growth.describe_slope(varying_configuration.length_name),
            Err(no_line) => format!("No line: {no_line}."),
        };
        let medians = medians_sentence(varying_configuration);
        let joint = Joint {
            stage: stage(LATENCY),
            points: &sample.points,
            x: (&horizontal, varying_configuration.lengths),
            y: (&vertical, varying_configuration.latencies),
            line: growth.ok().and_then(|growth| growth.line().ok()),
        };
        let label = format!(
            "{}: inference against the length of the answer. {medians}",
            varying_configuration.configuration.name
        );
        let label = format!("{label} {slope}");
        Some(LengthRow {
            name: varying_configuration.configuration.name.clone(),
            plot: Picture::of_plot(&joint.plot(), "joint", &label),
            has_cells: joint.has_cells(),
            sentences: [medians, slope]
                .into_iter()
                .chain([amount_sentence(varying_configuration, &sample)])
                .chain(beyond_axes_sentence(varying_configuration, (&horizontal, &vertical)))
                .collect(),
        })
    };
    let rows: Vec<LengthRow> = varying.iter().filter_map(row).collect();
    let others: Vec<&str> = not_drawn
        .iter()
        .map(|varying_configuration| varying_configuration.configuration.name.as_str())
        .collect();
    Some(Lengths {
        has_cells: rows.iter().any(|row| row.has_cells),
        others: (!others.is_empty()).then(|| others.join("; ")),
        without_usage,
        rows,
    })
}

/// Returns `Median 412 ms; answers of 20 to 320 tokens, median 96 tokens.`
fn medians_sentence(varying_configuration: &VaryingLengths<'_>) -> String {
    let median = |summary: &Summary| summary.quantile(0.5).unwrap_or_default();
    // In `20 to 320 tokens`, only the second number has the unit. Each number of bytes has its own unit, because the
    // units may differ.
    let range = (varying_configuration.lengths.moments.min, varying_configuration.lengths.moments.max);
    format!(
        "Median {}; answers of {} to {}, median {}.",
        duration(median(varying_configuration.latencies)),
        if is_tokens(varying_configuration.length_name) {
            fixed(range.0, 0)
        } else {
            varying_configuration.format_length(range.0)
        },
        varying_configuration.format_length(range.1),
        varying_configuration.format_length(median(varying_configuration.lengths))
    )
}

/// Returns a sentence about the number of iterations that are drawn as points.
fn amount_sentence(varying_configuration: &VaryingLengths<'_>, sample: &Answers) -> String {
    let points = sample.points.len() as u64;
    let [lengths, latencies] =
        [varying_configuration.lengths, varying_configuration.latencies].map(Summary::count);
    // If several nodes of one iteration have the name of the length, the number of lengths says nothing about
    // iterations.
    let has_one_length = IterationValues::has_one_value(varying_configuration.length_name);
    let iterations = if has_one_length { lengths.max(latencies) } else { latencies };
    let complete = lengths.min(latencies);
    let incomplete = iterations - complete;
    let rest = if incomplete > 0 {
        format!(" {} of {} iterations lack a valid length or latency.", count(incomplete), count(iterations))
    } else {
        String::new()
    };
    let has_deleted_iterations =
        varying_configuration.configuration.runs.iter().any(|run| run.last_deleted_iteration > 0);
    match (sample.is_whole, has_deleted_iterations) {
        _ if points == 0 => {
            format!("No iteration is stored any more; histograms of all {}.", count(complete))
        }
        (true, false) if incomplete > 0 => format!(
            "{} of {} iterations; the others lack a valid length or latency.",
            count(points),
            count(points + incomplete)
        ),
        (true, false) => format!("All {} iterations.", count(points)),
        (true, true) => format!(
            "{} iterations, all that are still stored; histograms of all {}.{rest}",
            count(points),
            count(complete)
        ),
        (false, has_deleted_iterations) => {
            let range = if has_deleted_iterations { " over what is still stored" } else { "" };
            format!(
                "{} of {} iterations, evenly spread{range}; histograms of all.{rest}",
                count(points),
                count(complete)
            )
        }
    }
}

/// Returns a sentence about the number of values beyond the axes; `None` if there are none.
fn beyond_axes_sentence(
    varying_configuration: &VaryingLengths<'_>,
    (horizontal, vertical): (&BinnedAxis, &BinnedAxis),
) -> Option<String> {
    let outside = |axis: &BinnedAxis, values: &Summary| {
        let (below, above) = axis.beyond(values);
        below + above
    };
    let outside = [
        (outside(horizontal, varying_configuration.lengths), "length", "lengths"),
        (outside(vertical, varying_configuration.latencies), "latency", "latencies"),
    ];
    let counts: Vec<String> = outside
        .iter()
        .filter(|(many, ..)| *many > 0)
        .map(|(many, one, several)| number::counted_with_plural(*many, one, several))
        .collect();
    (!counts.is_empty()).then(|| format!("Beyond the axes: {}.", counts.join(", ")))
}
