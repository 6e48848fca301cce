//! Sums of the stages of each configuration.

use peernet_analysis::loaded::Loaded;
use peernet_analysis::rows::{LATENESS, RowRef};
use peernet_analysis::slowness::BOTH_DIRECTIONS;
use peernet_analysis::stage_split::StageSplit;
use peernet_logger::{Name, stage};
use peernet_statistics::Moments;
use peernet_statistics::number::{self, fixed};

use super::columns::{count_note, is_drawable, too_large_note};
use super::configuration_groups::{ConfigurationGroups, counted_rows};
use super::missing_data::MissingData;
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::{Bar, Stacked, Unit};

/// Stages of the network, in the order of the verdicts of a row.
const DIRECTIONS: [Name; 2] = [stage::UPLOAD, stage::DOWNLOAD];
/// Maximum number of bars in one figure.
const MAX_BARS: usize = 100;

/// Returns the figure with one bar for each configuration; repeats are pooled.
pub(super) fn drawings(runs: &[Loaded]) -> Result<Vec<Drawing>, MissingData> {
    let ConfigurationGroups { axes, groups } = ConfigurationGroups::from_runs(runs);
    let all_rows = || groups.iter().flat_map(|(_, runs)| counted_rows(runs));
    if all_rows().next().is_none() {
        return Err(MissingData::Iterations);
    }
    // If one iteration has no measured total, all bars are the sums of their stages.
    let total = if all_rows().all(|row| row.value("total").is_some()) { "total" } else { "stages-total" };
    let mut bars: Vec<(&str, BarParts)> = groups
        .iter()
        .filter_map(|(label, runs)| Some((label.as_str(), BarParts::new(runs, total)?)))
        .collect();
    let (bar_count, omitted_groups) = (bars.len(), groups.len() - bars.len());
    bars.truncate(MAX_BARS);
    let has_part = |name: &Name| bars.iter().any(|(_, bar)| bar.mean(name).is_some());
    let stages: Vec<Name> = part_order().filter(has_part).collect();
    let mut notes = vec![format!(
        "configurations: {} · parts: means · whisker and numbers: mean ± standard deviation of the {}",
        axes.join(", "),
        if total == "total" { "measured total" } else { "sum of stages" }
    )];
    let mut missing = Vec::new();
    let rows = runs.iter().flat_map(|run| &run.rows);
    let counts = groups.iter().map(|(_, runs)| counted_rows(runs).count()).filter(|count| *count > 0);
    notes.push(with_count_per_bar(&count_note(&rows, all_rows().count()), &counts.collect::<Vec<_>>()));
    let names: Vec<Name> = part_order().collect();
    let columns: Vec<&str> = names.iter().map(Name::as_str).chain([total]).collect();
    notes.extend(too_large_note(all_rows(), &columns));
    if stages.iter().any(|stage| *stage == LATENESS) {
        notes.push(
            "late start: from the intended start to the actual start · unattributed: the rest of the total, without the late start".to_owned(),
        );
    }
    if omitted_groups > 0 {
        let configurations = number::counted(omitted_groups as u64, "configuration");
        missing.push(format!("left out: {configurations} without a counted iteration"));
    }
    notes.extend(unknown_delays_note(all_rows));
    if bar_count > MAX_BARS {
        missing.push(format!("the first {MAX_BARS} of {} configurations", fixed(bar_count as f64, 0)));
    }
    notes.extend(missing.iter().cloned());
    let stacked = Stacked {
        title: "Latency by configuration".to_owned(),
        unit: Unit::milliseconds("Latency"),
        bars: bars.into_iter().map(|(label, parts)| parts.into_bar(label, &stages)).collect(),
        stages: stages.iter().map(Name::to_string).collect(),
        notes,
    };
    Ok(vec![Drawing::new("stacked", AnyFigure::Stacked(stacked)).with_left_out(missing)])
}

/// Returns the note on counts with the number of iterations of each bar: `n = 88 (44 each)`, `n = 120 (10 to 110 each)`.
fn with_count_per_bar(count_note: &str, counts: &[usize]) -> String {
    let (Some(fewest), Some(most), true) = (counts.iter().min(), counts.iter().max(), counts.len() > 1)
    else {
        return count_note.to_owned();
    };
    let number = |count: &usize| fixed(*count as f64, 0);
    let each = if fewest == most { number(most) } else { format!("{} to {}", number(fewest), number(most)) };
    let (n, rest) = count_note.split_once(" · ").map_or((count_note, None), |(n, rest)| (n, Some(rest)));
    let rest = rest.map_or_else(String::new, |rest| format!(" · {rest}"));
    format!("{n} ({each} each){rest}")
}

/// Returns a note on the numbers of unknown delays; `None` if all delays are known.
fn unknown_delays_note<'a, I: Iterator<Item = RowRef<'a>>>(all_rows: impl Fn() -> I) -> Option<String> {
    let counts: Vec<String> = DIRECTIONS
        .iter()
        .enumerate()
        .filter_map(|(index, direction)| {
            let is_unknown =
                |row: &RowRef<'_>| row.verdicts()[index].is_some() && row.value(direction).is_none();
            let count = all_rows().filter(is_unknown).count();
            (count > 0).then(|| format!("{} of {direction}", fixed(count as f64, 0)))
        })
        .collect();
    (!counts.is_empty()).then(|| format!("left out of the means: unknown delays, {}", counts.join(", ")))
}

/// Returns the names of all parts of a bar in their order.
fn part_order() -> impl Iterator<Item = Name> {
    let both_directions =
        |name: &Name| (*name == stage::UPLOAD).then_some(Name::from_static(BOTH_DIRECTIONS));
    let stages =
        stage::ORDER.into_iter().flat_map(move |name| both_directions(&name).into_iter().chain([name]));
    stages.chain([Name::from_static(LATENESS), stage::UNATTRIBUTED])
}

/// Parts of the bar of a configuration.
struct BarParts {
    /// Mean of each part, seconds. The late start is not a part of the unattributed time here.
    means: Vec<(Name, f64)>,
    totals: Moments,
}

impl BarParts {
    /// Returns the parts of these runs, whose totals are in the column `total`; `None` without a counted iteration.
    fn new(runs: &[&Loaded], total: &str) -> Option<Self> {
        let mut nodes: Vec<(Name, Moments)> = part_order().map(|name| (name, Moments::default())).collect();
        let (mut totals, mut sent, mut count) = (Moments::default(), [0; 2], 0_u64);
        for row in counted_rows(runs) {
            let record = |moments: &mut Moments, column: &str| {
                row.value(column)
                    .filter(|value| is_drawable(*value))
                    .into_iter()
                    .for_each(|value| moments.record(value));
            };
            count += 1;
            nodes.iter_mut().for_each(|(name, moments)| record(moments, name));
            record(&mut totals, total);
            // Results of other programs have delays without verdicts.
            let directions = DIRECTIONS.into_iter().zip(row.verdicts());
            for (sent, (direction, verdict)) in sent.iter_mut().zip(directions) {
                *sent += u64::from(verdict.is_some() || row.value(&direction).is_some());
            }
        }
        let node = |name: &str| {
            let (_, moments) = nodes.iter().find(|(node, _)| node == name)?;
            (moments.count > 0).then_some((moments.count, moments.mean))
        };
        let sum_of_stages = || stage::ORDER.iter().filter_map(|name| node(name)).map(|(_, mean)| mean).sum();
        let total_mean =
            if totals.count > 0 { (totals.count, totals.mean) } else { (count, sum_of_stages()) };
        let split =
            StageSplit::new(sent, |name| if *name == *stage::TOTAL { Some(total_mean) } else { node(name) });
        let late_start = (Name::from_static(LATENESS), split.late_start);
        let unattributed = (stage::UNATTRIBUTED, split.unattributed_without_late_start());
        // Without a measured total, nothing is known about the time outside of stages.
        let outside_stages = [late_start, unattributed].into_iter().filter(|_| stage::TOTAL == *total);
        let stages = split.parts.into_iter().filter(|(name, _)| *name != stage::UNATTRIBUTED);
        let means = stages.chain(outside_stages.filter(|(name, _)| node(name).is_some())).collect();
        (count > 0).then_some(Self { means, totals })
    }

    fn mean(&self, name: &Name) -> Option<f64> {
        self.means.iter().find(|(part, _)| part == name).map(|(_, mean)| *mean)
    }

    /// Returns the bar with the parts `stages`.
    fn into_bar(self, label: &str, stages: &[Name]) -> Bar {
        let means: Vec<f64> = stages.iter().map(|stage| self.mean(stage).unwrap_or_default()).collect();
        let total = if self.totals.count > 0 { self.totals.mean } else { means.iter().sum() };
        Bar { label: label.to_owned(), means, total, std: self.totals.std() }
    }
}
