//! Defects of the results that are compared.

use peernet_clock::Verdict;
use peernet_statistics::Summary;
use peernet_statistics::number::counted;

use super::render::with_name;
use super::{LATENCIES, Line, NEARLY_ALL};
use crate::loaded::Loaded;
use crate::rows::RowRef;
use crate::trust::{Starts, replayed_latencies};

/// Returns sentences about skipped starts, incomplete folders, and numbers that are missing without a reason.
pub(super) fn sentences(runs: &[Loaded], lines: &[Line]) -> Vec<String> {
    let lacking: Vec<String> = runs
        .iter()
        .filter_map(|run| Some(format!("{}: {}", run.folder.display(), run.incompleteness()?)))
        .collect();
    let missing: Vec<String> = lines.iter().flat_map(|line| missing(runs, line)).collect();
    let mut told: Vec<String> =
        skipped_starts(lines.iter().map(|line| (line.name(), line.starts))).into_iter().collect();
    told.extend(replayed(runs, lines));
    if !lacking.is_empty() {
        told.push(format!("Incomplete results: {}.", lacking.join("; ")));
    }
    if !missing.is_empty() {
        told.push(format!(
            "Without a number in data.csv, or with one beyond ±10¹⁴⁰, and left out of the mean: {}.",
            missing.join("; ")
        ));
    }
    told
}

/// Returns a sentence about configurations of which starts were skipped, each by its name; a single one may have none. `None` if no start
/// was skipped.
pub fn skipped_starts(of: impl IntoIterator<Item = (String, Starts)>) -> Option<String> {
    let told = |(name, starts): (String, Starts)| Some(with_name(&name, &starts.skipped_text()?));
    let told: Vec<String> = of.into_iter().filter_map(told).collect();
    (!told.is_empty()).then(|| {
        format!(
            "Starts were skipped because the pipeline could not keep up; these latencies are not those of the configured \
             rate: {}.",
            told.join("; ")
        )
    })
}

/// Returns a sentence about configurations whose latencies are drawn from a distribution.
fn replayed(runs: &[Loaded], lines: &[Line]) -> Option<String> {
    let of = |line: &Line| {
        let distribution = line.runs.iter().find_map(|run| replayed_latencies(&runs[*run].record.facts))?;
        Some(with_name(&line.name(), distribution))
    };
    let told: Vec<String> = lines.iter().filter_map(of).collect();
    (!told.is_empty()).then(|| format!("Replayed latencies, not measured: {}.", told.join("; ")))
}

fn missing(runs: &[Loaded], line: &Line) -> Vec<String> {
    let rows = || line.runs.iter().flat_map(|run| &runs[*run].rows).filter(|row| row.is_counted());
    let told = |(name, latency): (&str, &Option<super::Latency>)| {
        let known = (*latency)?.count as f64 / line.count as f64;
        // If many delays are unknown, a different sentence covers them.
        (known >= NEARLY_ALL || !["upload", "download"].contains(&name)).then_some(())?;
        let lacking = rows().filter(|row| is_missing(*row, name)).count();
        let iterations = format!("{lacking} of {}", counted(line.count, "iteration"));
        (lacking > 0).then(|| format!("{name} of {} {iterations}", line.name()))
    };
    LATENCIES.into_iter().zip(&line.latencies).filter_map(told).collect()
}

/// Returns whether the number is missing without a recorded reason, or too large for the statistics.
fn is_missing(row: RowRef<'_>, name: &str) -> bool {
    let [up, down] = row.verdicts();
    let unknown = |verdict: Option<Verdict>| {
        verdict.is_some_and(|verdict| !matches!(verdict, Verdict::Ok | Verdict::Limited))
    };
    match (row.value(name), name) {
        (Some(value), _) => !Summary::accepts(value),
        (None, "upload") => !unknown(up),
        (None, "download") => !unknown(down),
        (None, "stages-total") => !unknown(up) && !unknown(down),
        (None, _) => true,
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::paper;
    use crate::compare::{Comparison, is_compared};

    #[test]
    fn too_large_number_is_not_reported_as_infinite() {
        let mut runs = paper();
        runs[1].rows.change(|row| {
            if row.iteration == 50 {
                row.values
                    .iter_mut()
                    .filter(|(name, _)| name == "sensing")
                    .for_each(|(_, value)| *value = 1e300);
            }
        });
        let told = "Without a number in data.csv, or with one beyond ±10¹⁴⁰, and left out of the mean: sensing of cuda:0, lan 1 of 100 iterations.";
        let text = Comparison::new(&runs).text();
        assert!(text.contains(told), "{text}");
    }

    #[test]
    fn replayed_latencies_are_noted_below_table() {
        let mut runs = paper();
        runs[1].record.facts.push(("Replayed".to_owned(), "inference is drawn from x".to_owned()));
        let text = Comparison::new(&runs).text();
        assert!(
            text.contains("Replayed latencies, not measured: cuda:0, lan: inference is drawn from x."),
            "{text}"
        );
        assert!(!Comparison::new(&paper()).text().contains("Replayed"));
    }

    #[test]
    fn skipped_starts_are_noted_below_table() {
        let mut runs = paper();
        runs[1].rows.change(|row| {
            row.values.push(("skipped-starts".into(), if row.iteration == 50 { 101.0 } else { 0.0 }));
        });
        let text = Comparison::new(&runs).text();
        assert!(text.contains(" of the configured rate: cuda:0, lan: 101 of 202 starts (50.0 %)."), "{text}");
        assert!(!Comparison::new(&paper()).text().contains("skipped"));
        assert!(is_compared("skipped-starts"), "else it is not read");
    }
}
