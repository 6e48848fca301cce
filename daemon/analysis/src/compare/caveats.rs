//! Defects of the results that are compared.

use std::path::{Path, PathBuf};

use peernet_clock::Verdict;
use peernet_statistics::Summary;
use peernet_statistics::number::counted;

use super::render::with_name;
use super::{LATENCIES, Line};
use crate::loaded::Loaded;
use crate::rows::RowRef;
use crate::trust::{NOTABLE_SHARE, Starts, publication_caveats};

/// Returns sentences about runs that cannot be published as they are, about skipped starts, replayed latencies and
/// incomplete folders, and about numbers that are missing without a reason.
pub(super) fn sentences(runs: &[Loaded], lines: &[Line]) -> Vec<String> {
    let incomplete: Vec<String> = runs
        .iter()
        .filter_map(|run| Some(format!("{}: {}", run.folder.display(), run.incompleteness()?)))
        .collect();
    let missing_numbers: Vec<String> =
        lines.iter().flat_map(|line| describe_missing_numbers(runs, line)).collect();
    let shared = shared_folder(runs);
    let name = |index: usize| {
        let has_several_edges = lines.iter().any(|line| line.edges > 1 && line.runs.contains(&index));
        let folder = &runs[index].folder;
        // Edges that measured at the same time have one folder each, inside the folder of their common run.
        let folder = folder.parent().filter(|_| has_several_edges).unwrap_or(folder);
        let relative = folder.strip_prefix(&shared).ok().filter(|path| !path.as_os_str().is_empty());
        relative.or_else(|| folder.file_name().map(Path::new)).unwrap_or(folder).display().to_string()
    };
    let reports = runs.iter().enumerate().map(|(index, run)| (name(index), run.record.trust.as_ref()));
    let mut sentences: Vec<String> = publication_caveats(reports).into_iter().map(|(_, text)| text).collect();
    sentences.extend(skipped_starts(lines.iter().map(|line| (line.name.clone(), line.starts))));
    sentences.extend(replayed_configurations(
        lines.iter().map(|line| (line.name.clone(), line.replayed.as_deref())),
    ));
    if !incomplete.is_empty() {
        sentences.push(format!("Incomplete results: {}.", incomplete.join("; ")));
    }
    if !missing_numbers.is_empty() {
        sentences.push(format!(
            "Left out of the mean, because data.csv has no number, or a number beyond ±10¹⁴⁰: {}.",
            missing_numbers.join("; ")
        ));
    }
    sentences
}

/// Returns the innermost folder that contains the folders of all runs.
// The notes name a run by its path inside this folder: a table that is kept with its results must not depend on the
// directory in which the command ran.
fn shared_folder(runs: &[Loaded]) -> PathBuf {
    let parents = runs.iter().map(|run| run.folder.parent().unwrap_or(Path::new("")).to_owned());
    let shared = |a: PathBuf, b: PathBuf| {
        a.components().zip(b.components()).take_while(|(a, b)| a == b).map(|(a, _)| a).collect()
    };
    parents.reduce(shared).unwrap_or_default()
}

/// Returns a sentence about the configurations with a [notable share](NOTABLE_SHARE) of skipped starts. Each
/// configuration is given by its name and its starts. The name may be empty if there is a single configuration. `None`
/// if no configuration has such a share.
pub fn skipped_starts(configurations: impl IntoIterator<Item = (String, Starts)>) -> Option<String> {
    let describe = |(name, starts): (String, Starts)| {
        (starts.skipped_share() > NOTABLE_SHARE).then_some(())?;
        Some(with_name(&name, &starts.skipped_text()?))
    };
    let descriptions: Vec<String> = configurations.into_iter().filter_map(describe).collect();
    (!descriptions.is_empty()).then(|| {
        format!(
            "Starts were skipped because the pipeline could not keep up; these latencies are not those of the configured \
             rate: {}.",
            descriptions.join("; ")
        )
    })
}

/// Returns a sentence about the configurations whose latencies are drawn from a distribution. Each configuration is
/// given by its name and its [description](crate::trust::ReplayedLatencies::describe_all). The name may be empty if
/// there is a single configuration. `None` if no latency is drawn.
pub fn replayed_configurations<'a>(
    configurations: impl IntoIterator<Item = (String, Option<&'a str>)>,
) -> Option<String> {
    let describe = |(name, distribution): (String, Option<&str>)| Some(with_name(&name, distribution?));
    let descriptions: Vec<String> = configurations.into_iter().filter_map(describe).collect();
    (!descriptions.is_empty())
        .then(|| format!("Replayed latencies, not measured: {}.", descriptions.join("; ")))
}

/// Returns a description of the missing numbers of each latency of a line.
fn describe_missing_numbers(runs: &[Loaded], line: &Line) -> Vec<String> {
    let rows = || line.runs.iter().flat_map(|run| &runs[*run].rows).filter(|row| row.is_in_statistics());
    let describe = |name: &str| {
        // If many delays are unknown, another note says which share of them is known.
        (line.latency(name).is_some() && line.small_known_share(name).is_none()).then_some(())?;
        let missing_count = rows().filter(|row| is_missing_or_too_large(*row, name)).count();
        let iterations = format!("{missing_count} of {}", counted(line.count, "iteration"));
        (missing_count > 0).then(|| format!("{name} of {}: {iterations}", line.name))
    };
    LATENCIES.into_iter().filter_map(describe).collect()
}

/// Returns whether the number of a column is missing without a recorded reason, or too large for the statistics. A
/// delay is missing for a reason if its verdict says that it cannot be known.
fn is_missing_or_too_large(row: RowRef<'_>, name: &str) -> bool {
    let [up, down] = row.verdicts();
    let explains_missing = |verdict: Option<Verdict>| {
        verdict.is_some_and(|verdict| !matches!(verdict, Verdict::Ok | Verdict::Limited))
    };
    match (row.value(name), name) {
        (Some(value), _) => !Summary::accepts(value),
        (None, "upload") => !explains_missing(up),
        (None, "download") => !explains_missing(down),
        (None, "stages-total") => !explains_missing(up) && !explains_missing(down),
        (None, _) => true,
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::paper;
    use super::skipped_starts;
    use crate::compare::{Comparison, needs_column};
    use crate::loaded::Loaded;
    use crate::trust::{Publish, Report, Starts, TrustInput};

    #[test]
    fn too_large_number_is_reported_as_left_out_of_mean() {
        let mut runs = paper();
        runs[1].rows.change(|row| {
            if row.iteration == 50 {
                row.values
                    .iter_mut()
                    .filter(|(name, _)| name == "sensing")
                    .for_each(|(_, value)| *value = 1e300);
            }
        });
        let sentence = "Left out of the mean, because data.csv has no number, or a number beyond ±10¹⁴⁰: sensing of cuda:0, lan: 1 of 100 iterations.";
        let text = Comparison::new(&runs).text();
        assert!(text.contains(sentence), "{text}");
    }

    #[test]
    fn unpublishable_run_is_noted_below_table() {
        let mut runs = paper();
        let input = TrustInput { failure: Some("the cloud is gone".to_owned()), ..TrustInput::default() };
        let report = Report::new(&input);
        assert_eq!(report.verdict, Publish::No);
        runs[1].record.trust = Some(report);
        let text = Comparison::new(&runs).text();
        assert!(text.contains("cannot be published: ") && text.contains("the trust report"), "{text}");
        assert!(!Comparison::new(&paper()).text().contains("be published"));
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
        let replayed_cells = |runs: &[Loaded]| {
            let csv = Comparison::new(runs).csv();
            csv.lines().map(|line| line.rsplit(',').next().unwrap_or_default().to_owned()).collect::<Vec<_>>()
        };
        assert_eq!(replayed_cells(&runs), ["replayed", "0", "1", "0"]);
        assert_eq!(replayed_cells(&paper()), ["replayed", "0", "0", "0"]);
    }

    #[test]
    fn skipped_starts_are_noted_below_table() {
        let mut runs = paper();
        runs[1].rows.change(|row| {
            row.values.push(("skipped-starts".into(), if row.iteration == 50 { 101.0 } else { 0.0 }));
        });
        let text = Comparison::new(&runs).text();
        assert!(
            text.contains(" of the configured rate: cuda:0, lan: 101 of 202 starts (50\u{202f}%)."),
            "{text}"
        );
        assert!(!Comparison::new(&paper()).text().contains("skipped"));
        // The trust report calls a share of 0.1 % good.
        let starts = |started: u64| Starts { started, skipped: 1, ..Starts::default() };
        let sentence = |started: u64| skipped_starts([("lan".to_owned(), starts(started))]);
        assert_eq!((sentence(999), sentence(998).is_some()), (None, true));
        assert!(needs_column("skipped-starts"), "a comparison reads only the columns that it needs");
    }
}
