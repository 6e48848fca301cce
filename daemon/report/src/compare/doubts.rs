//! What is wrong with the results that are compared.

use peernet_clock::Verdict;

use super::{LATENCIES, Line, NEARLY_ALL};
use crate::number::counted;
use crate::results::{Loaded, RowRef};

/// The damage of folders and the numbers that are missing without a reason, in sentences.
pub(super) fn sentences(runs: &[Loaded], lines: &[Line]) -> Vec<String> {
    let damaged: Vec<String> =
        runs.iter().filter_map(|run| Some(format!("{}: {}", run.folder.display(), run.damage()?))).collect();
    let missing: Vec<String> = lines.iter().flat_map(|line| missing(runs, line)).collect();
    let mut told = Vec::new();
    if !damaged.is_empty() {
        told.push(format!("Results are not whole: {}.", damaged.join("; ")));
    }
    if !missing.is_empty() {
        told.push(format!(
            "Without a finite number in data.csv, and left out of the mean: {}.",
            missing.join("; ")
        ));
    }
    told
}

fn missing(runs: &[Loaded], line: &Line) -> Vec<String> {
    let rows = || line.runs.iter().flat_map(|run| &runs[*run].rows).filter(|row| row.counts());
    let told = |(name, latency): (&str, &Option<super::Latency>)| {
        let known = (*latency)?.count as f64 / line.count as f64;
        // Of many delays that are not known another sentence tells.
        (known >= NEARLY_ALL || !["upload", "download"].contains(&name)).then_some(())?;
        let lacking = rows().filter(|row| is_missing(*row, name)).count();
        let iterations = format!("{lacking} of {}", counted(line.count, "iteration"));
        (lacking > 0).then(|| format!("{name} of {} {iterations}", line.name()))
    };
    LATENCIES.into_iter().zip(&line.latencies).filter_map(told).collect()
}

/// Whether the number is not there although nothing says why.
fn is_missing(row: RowRef<'_>, name: &str) -> bool {
    let [up, down] = row.verdicts();
    let unknown = |verdict: Option<Verdict>| {
        verdict.is_some_and(|verdict| !matches!(verdict, Verdict::Ok | Verdict::Limited))
    };
    match (row.value(name), name) {
        (Some(value), _) => !value.is_finite(),
        (None, "upload") => !unknown(up),
        (None, "download") => !unknown(down),
        (None, "stages-total") => !unknown(up) && !unknown(down),
        (None, _) => true,
    }
}
