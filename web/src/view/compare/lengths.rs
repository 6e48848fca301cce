//! Response length against latency: a sample of the iterations as points, the distributions of all of them.

mod growth;
#[cfg(test)]
pub(crate) mod tests;

use peernet_analysis::answer_length::{Growth, LATENCY, answer_length, is_tokens, varies};
use peernet_figures::drawing::{BinnedAxis, Joint};
use peernet_figures::look::stage;
use peernet_figures::plot::Unit;
use peernet_statistics::Summary;
use peernet_statistics::number::{bytes, count, duration, fixed};
use peernet_store::{RunSummary, StageStatistics, Store};

use growth::sentence;

use super::{Comparison, Configuration};
use crate::error::WebError;
use crate::picture::Picture;
use crate::view::counted;

/// Largest number of configurations that are drawn.
const MOST_DRAWN: usize = 6;
/// Largest number of iterations that a page reads, and largest number of one configuration.
const MOST_READ: u64 = 1_500;
const MOST_EACH: u64 = 750;
/// Length of the longest answer, bytes, from which on lengths are shown in kB.
const KILOBYTES: f64 = 10_000.0;

/// A configuration whose answers differ in length.
struct Varying<'a> {
    one: &'a Configuration,
    /// Node with the length of an answer.
    length: &'a str,
    x: &'a Summary,
    y: &'a Summary,
}

impl<'a> Varying<'a> {
    fn of(one: &'a Configuration) -> Option<Self> {
        let names = one.stages.iter().map(|known: &StageStatistics| known.stage.as_str());
        let length = answer_length(names);
        let (x, y) = (one.known(length)?, one.known(LATENCY)?);
        varies(x.moments.min, x.moments.max).then_some(Self { one, length, x, y })
    }

    fn all(comparison: &'a Comparison) -> Vec<Self> {
        comparison.configurations.iter().filter_map(Self::of).collect()
    }

    /// Returns the unit of lengths: its name, its factor from the measured value, the unit of the slope, and the measured length that the
    /// slope is given for.
    fn unit(&self, longest: f64) -> (String, f64, &'static str, f64) {
        if is_tokens(self.length) {
            (self.length.replace(['-', '_'], " "), 1.0, "token", 1.0)
        } else if longest >= KILOBYTES {
            ("kB of answer".to_owned(), 1e-3, "kB", 1e3)
        } else {
            ("bytes of answer".to_owned(), 1.0, "kB", 1e3)
        }
    }

    fn length_of(&self, length: f64) -> String {
        if is_tokens(self.length) {
            format!("{} tokens", fixed(length, 0))
        } else {
            bytes(length).to_string()
        }
    }
}

/// Iterations read of a configuration.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Answers {
    /// Name of the configuration.
    pub name: String,
    /// Length, as measured, and seconds.
    pub points: Vec<(f64, f64)>,
    /// `true` if all that are stored were read.
    pub is_whole: bool,
}

/// Returns whether a number is in the statistics, and so has a place on an axis.
fn counts(value: f64) -> bool {
    Summary::accepts(value)
}

/// Reads a sample of the iterations of each configuration that is drawn; the share of each of its runs is equal.
///
/// # Errors
/// Returns an error when the store cannot be read.
pub(crate) async fn answers(store: &Store, comparison: &Comparison) -> Result<Vec<Answers>, WebError> {
    let varying = Varying::all(comparison);
    let drawn = varying.len().min(MOST_DRAWN);
    let mut all = Vec::with_capacity(drawn);
    for it in &varying[..drawn] {
        let most = (MOST_READ / drawn as u64).min(MOST_EACH);
        let answered = |run: &RunSummary| run.counts.ok.max(1);
        let whole: u64 = it.one.runs.iter().map(answered).sum();
        let mut known = Answers { name: it.one.name.clone(), points: Vec::new(), is_whole: true };
        for run in &it.one.runs {
            // Warm-up and iterations without an answer are read as well, so that a run with room for all of them is read whole.
            let share = if whole <= most { MOST_READ } else { (most * answered(run)).div_ceil(whole) };
            let pairs = store.value_pairs(run.number, [it.length, LATENCY], share as u32).await?;
            known.is_whole &= pairs.is_complete();
            known.points.extend(pairs.points.into_iter().filter(|(x, y)| counts(*x) && counts(*y)));
        }
        all.push(known);
    }
    Ok(all)
}

/// The picture of one configuration.
pub(crate) struct LengthRow {
    pub name: String,
    pub plot: Picture,
    /// `true` if its points are counted into cells.
    is_counted: bool,
    /// Sentences about the contents of the plot and its basis.
    pub said: Vec<String>,
}

/// Pictures side by side.
pub(crate) struct Lengths {
    pub rows: Vec<LengthRow>,
    /// Names of the configurations for which there is no room.
    pub others: Option<String>,
    /// `true` if points are counted into cells.
    pub is_counted: bool,
}

/// Returns the configurations whose answers differ in length, on shared axes; `None` where there are none.
pub(crate) fn lengths(comparison: &Comparison, answers: &[Answers]) -> Option<Lengths> {
    let mut varying = Varying::all(comparison);
    let rest = varying.split_off(varying.len().min(MOST_DRAWN));
    let up = BinnedAxis::from_zero(varying.iter().map(|it| it.y), Unit::symbol("ms", 1e3))?;
    let row = |it: &Varying<'_>| {
        let alike = || varying.iter().filter(|other| other.length == it.length).map(|other| other.x);
        let longest = alike().map(|known| known.moments.max).fold(0.0, f64::max);
        let (unit, per_si, what, each) = it.unit(longest);
        let across = BinnedAxis::from_zero(alike(), Unit::symbol(&unit, per_si))?;
        let known = answers.iter().find(|known| known.name == it.one.name);
        let known = known.cloned().unwrap_or_default();
        let growth = Growth::from_iterations(&known.points);
        let slope = growth.as_ref().map(|growth| sentence(growth, what, each));
        let summed = sums(it);
        let joint = Joint {
            stage: stage(LATENCY),
            points: &known.points,
            x: (&across, it.x),
            y: (&up, it.y),
            line: growth.as_ref().and_then(Growth::line),
        };
        let label = format!("{}: inference against the length of the answer. {summed}", it.one.name);
        let label = slope.iter().fold(label, |label, slope| format!("{label} {slope}"));
        Some(LengthRow {
            name: it.one.name.clone(),
            plot: Picture::of_plot(&joint.plot(), "joint", &label),
            is_counted: joint.has_cells(),
            said: std::iter::once(summed)
                .chain(slope)
                .chain([amount(it, &known)])
                .chain(beyond(it, (&across, &up)))
                .collect(),
        })
    };
    let rows: Vec<LengthRow> = varying.iter().filter_map(row).collect();
    let others: Vec<&str> = rest.iter().map(|it| it.one.name.as_str()).collect();
    Some(Lengths {
        is_counted: rows.iter().any(|row| row.is_counted),
        others: (!others.is_empty()).then(|| others.join("; ")),
        rows,
    })
}

/// Returns `Median 412 ms; answers of 20 to 320 tokens, median 96 tokens.`
fn sums(it: &Varying<'_>) -> String {
    let median = |known: &Summary| known.quantile(0.5).unwrap_or_default();
    let ends = (it.x.moments.min, it.x.moments.max);
    format!(
        "Median {}; answers of {} to {}, median {}.",
        duration(median(it.y)),
        if is_tokens(it.length) { fixed(ends.0, 0) } else { it.length_of(ends.0) },
        it.length_of(ends.1),
        it.length_of(median(it.x))
    )
}

/// Returns a sentence about the number of iterations that are drawn as points.
fn amount(it: &Varying<'_>, known: &Answers) -> String {
    let points = known.points.len() as u64;
    let (all, answered) = (it.x.count().min(it.y.count()), it.x.count().max(it.y.count()));
    let lacking = answered - all;
    let rest = if lacking > 0 {
        format!(" {} of {} iterations have no such number.", count(lacking), count(answered))
    } else {
        String::new()
    };
    let is_deleted = it.one.runs.iter().any(|run| run.nodes_from > 0);
    match (known.is_whole, is_deleted) {
        _ if points == 0 => format!("No iteration is stored any more; histograms of all {}.", count(all)),
        (true, false) if lacking > 0 => format!(
            "{} of {} iterations; the others have no such number.",
            count(points),
            count(points + lacking)
        ),
        (true, false) => format!("All {} iterations.", count(points)),
        (true, true) => format!(
            "{} iterations, all that are still stored; histograms of all {}.{rest}",
            count(points),
            count(all)
        ),
        (false, is_deleted) => {
            let of = if is_deleted { " over what is still stored" } else { "" };
            format!(
                "{} of {} iterations, evenly spread{of}; histograms of all.{rest}",
                count(points),
                count(all)
            )
        }
    }
}

/// Returns a sentence about the number of values beyond the axes; `None` if there are none.
fn beyond(it: &Varying<'_>, (across, up): (&BinnedAxis, &BinnedAxis)) -> Option<String> {
    let lost = [(across.beyond(it.x), "length", "lengths"), (up.beyond(it.y), "latency", "latencies")];
    let told: Vec<String> = lost
        .iter()
        .filter(|(many, ..)| *many > 0)
        .map(|(many, one, several)| counted(*many as usize, one, several))
        .collect();
    (!told.is_empty()).then(|| format!("Beyond the axes: {}.", told.join(", ")))
}
