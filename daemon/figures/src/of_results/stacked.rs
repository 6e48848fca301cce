//! Figure of the stacked stages of each configuration.

use peernet_analysis::compare::LatencyBar;
use peernet_analysis::loaded::Loaded;
use peernet_analysis::rows::{LATENESS, RowRef};
use peernet_analysis::stage_split::part_order;
use peernet_analysis::total_column::TotalColumn;
use peernet_analysis::transfer::DirectionNodes;
use peernet_logger::Name;
use peernet_statistics::number;

use super::columns::{excluded_note, too_large_note};
use super::configuration_groups::{ConfigurationGroups, rows_in_statistics};
use super::missing_data::MissingData;
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::Stacked;

/// Maximum number of bars in one figure.
const MAX_BARS: usize = 100;

/// Returns the figure with one bar for each configuration. Repeats of a configuration are pooled.
pub(super) fn drawings(runs: &[Loaded]) -> Result<Vec<Drawing>, MissingData> {
    let ConfigurationGroups { axes, groups } = ConfigurationGroups::from_runs(runs);
    let all_rows = || groups.iter().flat_map(|(_, runs)| rows_in_statistics(runs));
    if all_rows().next().is_none() {
        return Err(MissingData::Iterations);
    }
    let total = TotalColumn::from_rows(all_rows());
    let bar = |(label, runs): &(String, Vec<&Loaded>)| {
        Some((label.clone(), LatencyBar::from_rows(total, &rows_in_statistics(runs))?))
    };
    let mut bars: Vec<(String, LatencyBar)> = groups.iter().filter_map(bar).collect();
    let (bar_count, omitted_groups) = (bars.len(), groups.len() - bars.len());
    bars.truncate(MAX_BARS);
    // The iterations of configurations without a bar do not count in the notes on the values of the
    // bars.
    let shown_groups: Vec<&Vec<&Loaded>> = groups
        .iter()
        .map(|(_, runs)| runs)
        .filter(|runs| rows_in_statistics(runs).next().is_some())
        .take(MAX_BARS)
        .collect();
    let shown_rows = || shown_groups.iter().flat_map(|runs| rows_in_statistics(runs));
    let mut notes = vec![format!(
        "configurations: {} · parts: means · whisker and numbers: mean ± standard deviation of the {}",
        axes.join(", "),
        total.description()
    )];
    let mut left_out = Vec::new();
    let counts: Vec<u64> = shown_groups.iter().map(|runs| rows_in_statistics(runs).count() as u64).collect();
    let excluded = excluded_note(&runs.iter().flat_map(|run| &run.rows));
    notes.push(std::iter::once(bar_counts_note(&counts)).chain(excluded).collect::<Vec<_>>().join(" · "));
    let names: Vec<Name> = part_order().collect();
    let columns: Vec<&str> = names.iter().map(Name::as_str).chain([total.name()]).collect();
    notes.extend(too_large_note(shown_rows(), &columns));
    if bars.iter().any(|(_, bar)| bar.part(LATENESS).is_some()) {
        notes.push(
            "late start: from the intended start to the actual start · rest of unattributed: unattributed without the late start".to_owned(),
        );
    }
    if omitted_groups > 0 {
        let configurations = number::counted(omitted_groups as u64, "configuration");
        left_out.push(format!("left out: {configurations} without a successful iteration after the warm-up"));
    }
    notes.extend(unknown_delays_note(shown_rows));
    if bar_count > MAX_BARS {
        left_out.push(format!(
            "shown: the first {MAX_BARS} of {} configurations",
            number::count(bar_count as u64)
        ));
    }
    notes.extend(left_out.iter().cloned());
    let stacked = Stacked::new("Latency by configuration", &bars, notes);
    Ok(vec![Drawing::new("stacked", AnyFigure::Stacked(stacked)).with_left_out(left_out)])
}

/// Returns the note on the numbers of iterations of all bars together and of each bar:
/// `n = 88 (44 each)`, `n = 120 (10 to 110 each)`. `counts` has the number of each bar. The note on
/// a single bar has one number: `n = 44`.
fn bar_counts_note(counts: &[u64]) -> String {
    let n = format!("n = {}", number::count(counts.iter().sum()));
    match number::range_of_counts(counts.iter().copied()) {
        Some(each) if counts.len() > 1 => format!("{n} ({each} each)"),
        _ => n,
    }
}

/// Returns a note on the number of unknown delays of each direction; `None` if all delays are known.
fn unknown_delays_note<'a, I: Iterator<Item = RowRef<'a>>>(rows: impl Fn() -> I) -> Option<String> {
    let counts: Vec<String> = DirectionNodes::both()
        .into_iter()
        .filter_map(|nodes| {
            let count = rows().filter(|row| row.has_unknown_delay(&nodes.delay)).count();
            (count > 0).then(|| format!("{} of {}", number::count(count as u64), nodes.delay))
        })
        .collect();
    (!counts.is_empty())
        .then(|| format!("unknown delays count as the mean of the known ones: {}", counts.join(", ")))
}
