//! Caveats about the means of stored runs, such as skipped starts, and the commands that compare the runs by single
//! iterations.

use peernet_analysis::compare::{replayed_configurations, skipped_starts};
use peernet_analysis::outcomes::failed_share;
use peernet_analysis::run_selection::RunState;
use peernet_analysis::trust::{NOTABLE_SHARE, ReplayedLatencies, publication_caveats};
use peernet_statistics::number::count;
use peernet_store::RunSummary;
use peernet_stream::{Grade, OutcomeCounts};

use super::{Comparison, Configuration};
use crate::view::chip::Chip;
use crate::view::notes::REPLAYED;
use crate::view::trust::chip;

/// Address of the dashboard in commands if the request has no Host header, or one with characters that a shell could
/// interpret.
const DEFAULT_ADDRESS: &str = "127.0.0.1:8040";

/// Returns the caveats, each with its chip: runs that cannot be published as they are, replayed latencies, unfinished
/// runs, and notable shares of skipped starts and of failed iterations.
pub(crate) fn caveats(comparison: &Comparison) -> Vec<(Chip, String)> {
    let configurations = &comparison.configurations;
    let reports = configurations.iter().flat_map(|one| {
        one.runs.iter().map(move |run| {
            (name_with_other_edges(comparison, one, run), comparison.trust_by_run.get(&run.number))
        })
    });
    let publication = publication_caveats(reports).into_iter().map(|(grade, text)| (chip(grade), text));
    let replayed_descriptions = configurations.iter().map(|one| {
        let runs = one.runs.iter().filter_map(|run| comparison.replayed_by_run.get(&run.number).cloned());
        (one.name.clone(), ReplayedLatencies::describe_all(runs))
    });
    let replayed_descriptions: Vec<(String, Option<String>)> = replayed_descriptions.collect();
    let replayed = replayed_configurations(
        replayed_descriptions.iter().map(|(name, text)| (name.clone(), text.as_deref())),
    );
    // The trust report has a finding about a run that ended early, but none about a run without a recorded end.
    let open: Vec<String> = comparison
        .runs()
        .filter(|run| RunState::from_end_reason(run.reason.as_ref()) == RunState::Open)
        .map(|run| format!("#{}", run.number))
        .collect();
    let open = (!open.is_empty()).then(|| {
        let state = RunState::Open;
        format!(
            "Without a recorded end ({state}), but compared because you selected them: {}.",
            open.join(", ")
        )
    });
    let skipped = skipped_starts(configurations.iter().map(|one| (one.name.clone(), one.starts())));
    let failed_texts = configurations.iter().filter_map(|one| {
        let mut counts = OutcomeCounts::default();
        one.runs.iter().for_each(|run| counts.merge(&run.counts));
        (failed_share(&counts)? > NOTABLE_SHARE).then(|| {
            format!(
                "{}: {} of {} iterations failed; the figures are those of the others.",
                one.name,
                count(counts.all_failed()),
                count(counts.total())
            )
        })
    });
    let others = open.into_iter().chain(skipped).chain(failed_texts);
    let others = others.map(|text| (chip(Grade::Doubtful), text));
    publication.chain(replayed.map(|text| (REPLAYED, text))).chain(others).collect()
}

/// Returns the name of a run, such as `#11`. If several edges of an experiment measured at the same time, each edge has
/// a stored run, but the tables of `peernet compare` show one run for all edges. The name of such a run has the numbers
/// of all stored runs: `#11 + #12`.
fn name_with_other_edges(comparison: &Comparison, configuration: &Configuration, run: &RunSummary) -> String {
    let edges = comparison.edges_of_run(configuration, run);
    let numbers: Vec<String> = edges.iter().map(|edge| format!("#{}", edge.number)).collect();
    numbers.join(" + ")
}

/// Returns a sentence for each configuration with samples whose label is not a class of its model.
pub(crate) fn unknown_labels(comparison: &Comparison) -> Vec<String> {
    let sentences = comparison.configurations.iter().filter_map(|one| {
        let unknown = one.runs.iter().filter_map(|run| comparison.unknown_labels_by_run.get(&run.number));
        let unknown = unknown.cloned().reduce(|all, more| all.merged_with(&more))?;
        let all = one.runs.iter().map(|run| run.counts.ok).sum();
        Some(format!("{}. {}", one.name, unknown.sentence(all)))
    });
    sentences.collect()
}

/// Returns the commands that download the runs from this dashboard and compare them by single iterations instead of
/// stored statistics. `host` is the address by which the browser reaches the dashboard. Returns `None` for fewer than
/// two runs. Also returns `None` for an experiment, because the command that ran the experiment wrote the results to a
/// folder.
pub(crate) fn commands(comparison: &Comparison, host: &str) -> Option<String> {
    let runs: Vec<String> = comparison.runs().map(|run| run.number.to_string()).collect();
    (comparison.experiment.is_none() && runs.len() > 1).then_some(())?;
    let is_plain = |char: char| char.is_ascii_alphanumeric() || ".:[]-_".contains(char);
    let host =
        Some(host).filter(|host| !host.is_empty() && host.chars().all(is_plain)).unwrap_or(DEFAULT_ADDRESS);
    let files: Vec<String> = runs.iter().map(|run| format!("run-{run}.csv")).collect();
    // curl replaces `#1` in the name of the file by the number of the run.
    Some(format!(
        "curl -sSf \"http://{host}/api/v1/runs/{{{}}}/export\" -o \"run-#1.csv\"\npeernet compare {}",
        runs.join(","),
        files.join(" ")
    ))
}

#[cfg(test)]
mod tests {
    use peernet_analysis::accuracy::UnknownLabels;
    use peernet_analysis::trust::{Report, TrustInput};
    use peernet_stream::ExperimentPosition;
    use peernet_stream::PlacementKind::Local;

    use super::super::tests::{comparison, configuration};
    use super::*;

    #[test]
    fn commands_download_and_compare_runs() {
        let mut two = comparison((0..2).map(|at| configuration(at, Local, 1.0, 1e3)).collect());
        assert_eq!(
            commands(&two, "localhost:8040"),
            None,
            "the results of an experiment are in a folder already"
        );
        two.experiment = None;
        let plain = "curl -sSf \"http://localhost:8040/api/v1/runs/{1,2}/export\" -o \"run-#1.csv\"\n\
                     peernet compare run-1.csv run-2.csv";
        assert_eq!(commands(&two, "localhost:8040").as_deref(), Some(plain));
        for odd in ["", "$(reboot)", "a\"b", "a b"] {
            let text = commands(&two, odd).expect("two runs");
            assert!(text.contains("http://127.0.0.1:8040/") && !text.contains("reboot"), "{text}");
        }
        two.configurations.truncate(1);
        assert_eq!(commands(&two, "localhost:8040"), None);
    }

    #[test]
    fn skipped_starts_have_the_same_text_as_in_terminal() {
        let one = configuration(0, Local, 1.0, 1e3);
        let mut other = configuration(1, Local, 2.0, 1e3);
        let mut run = other.runs[0].clone();
        (run.counts.ok, run.counts.timeout, run.skipped_starts) = (90, 37, 73);
        other.runs[0].counts.ok = 0;
        other.runs.push(run);
        assert!(caveats(&comparison(vec![one.clone()])).is_empty());
        let text = "Starts were skipped because the pipeline could not keep up; these latencies are not those of the \
                    configured rate: B: 73 of 200 starts (36\u{202f}%).";
        let failed = "B: 37 of 127 iterations failed; the figures are those of the others.";
        assert_eq!(texts(&comparison(vec![one, other])), [text, failed]);
    }

    #[test]
    fn losses_that_trust_calls_good_are_no_caveat() {
        let mut one = configuration(0, Local, 1.0, 1e3);
        (one.runs[0].counts.ok, one.runs[0].counts.timeout, one.runs[0].skipped_starts) = (1_999, 1, 1);
        assert!(texts(&comparison(vec![one])).is_empty(), "0.05 %");
    }

    #[test]
    fn unpublishable_run_is_a_caveat() {
        let mut two = comparison((0..2).map(|at| configuration(at, Local, 1.0, 1e3)).collect());
        let input = TrustInput { failure: Some("the cloud is gone".to_owned()), ..TrustInput::default() };
        two.trust_by_run.insert(2, Report::new(&input));
        let sentences = caveats(&two);
        assert!(sentences[0].1.contains("cannot be published: #2 ("), "{sentences:?}");
        // The page of the run shows the same chip for the finding.
        assert_eq!(sentences[0].0, chip(Grade::Bad));
    }

    #[test]
    fn edges_of_one_run_are_one_caveat() {
        let mut two = comparison((0..2).map(|at| configuration(at, Local, 1.0, 1e3)).collect());
        for (one, number) in two.configurations.iter_mut().zip([11, 13]) {
            let run =
                RunSummary { number, experiment: Some(ExperimentPosition::default()), ..one.runs[0].clone() };
            let host_name = crate::tests::samples::slug("cam-2");
            one.runs = vec![run.clone(), RunSummary { number: number + 1, host_name, ..run }];
        }
        let input = TrustInput { failure: Some("the cloud is gone".to_owned()), ..TrustInput::default() };
        two.trust_by_run = [11, 12, 13, 14].map(|number| (number, Report::new(&input))).into();
        two.experiment = Some(("users".to_owned(), "x".to_owned()));
        let text = |two: &Comparison| caveats(two)[0].1.clone();
        assert!(text(&two).starts_with("2 of 2 runs cannot be published: #11 + #12 ("), "{}", text(&two));
        assert_eq!((two.run_count(), two.runs().count()), (2, 4));
        two.experiment = None;
        assert!(text(&two).starts_with("4 of 4 runs cannot be published: #11 ("), "{}", text(&two));
        assert_eq!(two.run_count(), 4);
    }

    #[test]
    fn replayed_configurations_are_named() {
        let mut two = comparison((0..2).map(|at| configuration(at, Local, 1.0, 1e3)).collect());
        let facts = [("Replayed".to_owned(), "inference is drawn from x".to_owned())];
        let replayed = ReplayedLatencies::from_facts(&facts).expect("is replayed");
        two.replayed_by_run.insert(2, replayed);
        let text = "Replayed latencies, not measured: B: inference is drawn from x.";
        assert_eq!(caveats(&two), [(REPLAYED, text.to_owned())]);
    }

    /// Returns the sentences of the caveats.
    fn texts(comparison: &Comparison) -> Vec<String> {
        caveats(comparison).into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn selected_run_without_end_is_a_caveat() {
        let mut one = configuration(0, Local, 1.0, 1e3);
        one.runs[0].reason = None;
        let sentences = texts(&comparison(vec![one, configuration(1, Local, 2.0, 1e3)]));
        let text =
            "Without a recorded end (in progress or killed), but compared because you selected them: #1.";
        assert_eq!(sentences, [text]);
    }

    #[test]
    fn labels_unknown_to_the_model_are_counted() {
        let mut two = comparison((0..2).map(|at| configuration(at, Local, 1.0, 1e3)).collect());
        let facts = [("Classes".to_owned(), "4: good, dented".to_owned())];
        let unknown = UnknownLabels::new(12, &facts).expect("12 are not 0");
        two.unknown_labels_by_run.insert(2, unknown);
        let sentences = unknown_labels(&two);
        let text = "B. Not scored: 12 of 300 iterations, because the label is not a class of the model (classes: good, dented).";
        assert_eq!(sentences, [text]);
    }
}
