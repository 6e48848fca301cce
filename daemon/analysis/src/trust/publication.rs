//! Sentences that say which of several runs can be published, for comparisons of runs.

use std::collections::BTreeSet;

use peernet_stream::Grade;

use super::{Publish, Report};

/// Maximum number of runs that a sentence names.
const MAX_NAMED_RUNS: usize = 8;

/// Returns a sentence about the runs that cannot be published, and a sentence about the runs that can be published only
/// with caveats. Each sentence has the grade of its findings. `runs` has the name and the report of each run. A run of
/// several edges is given once for each edge, always with the name of the run. Such a run has the findings of all its
/// edges and the worst of their verdicts. Empty if all runs can be published as they are.
pub fn publication_caveats<'a>(runs: impl IntoIterator<Item = (String, &'a Report)>) -> Vec<(Grade, String)> {
    let mut reports_by_run: Vec<(String, Vec<&Report>)> = Vec::new();
    for (name, report) in runs {
        match reports_by_run.iter_mut().find(|(other, _)| *other == name) {
            Some((_, reports)) => reports.push(report),
            None => reports_by_run.push((name, vec![report])),
        }
    }
    let runs = reports_by_run;
    let sentence = |verdict: Publish, grade: Grade, meaning: &str| {
        let worst = |reports: &[&Report]| reports.iter().map(|report| report.verdict).max();
        let affected_runs: Vec<&(String, Vec<&Report>)> =
            runs.iter().filter(|(_, reports)| worst(reports) == Some(verdict)).collect();
        (!affected_runs.is_empty()).then_some(())?;
        let named = affected_runs.iter().take(MAX_NAMED_RUNS);
        let mut names: Vec<String> =
            named.map(|(name, reports)| format!("{name} ({})", subjects(reports, grade))).collect();
        if affected_runs.len() > MAX_NAMED_RUNS {
            names.push(format!("and {} more", affected_runs.len() - MAX_NAMED_RUNS));
        }
        let count = match (affected_runs.len(), runs.len()) {
            (1, 1) => "The run".to_owned(),
            (count, all) => format!("{count} of {all} runs"),
        };
        let text = format!(
            "{count} {meaning}: {}; the trust report of each run has the reasons and the advice.",
            names.join(", ")
        );
        Some((grade, text))
    };
    let sentences = [
        sentence(Publish::No, Grade::Bad, "cannot be published"),
        sentence(Publish::WithRemarks, Grade::Doubtful, "can be published only with caveats"),
    ];
    sentences.into_iter().flatten().collect()
}

/// Returns the subjects of the findings of a grade, each once, in the order of the reports.
fn subjects(reports: &[&Report], grade: Grade) -> String {
    let mut seen_subjects = BTreeSet::new();
    let of_grade =
        reports.iter().flat_map(|report| &report.findings).filter(|finding| finding.grade == grade);
    let subjects =
        of_grade.map(|finding| finding.about.as_str()).filter(|about| seen_subjects.insert(*about));
    subjects.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::super::Finding;
    use super::*;

    fn report(verdict: Publish, findings: &[(&str, Grade)]) -> Report {
        let finding = |(about, grade): &(&str, Grade)| Finding {
            about: (*about).to_owned(),
            grade: *grade,
            text: String::new(),
            advice: String::new(),
        };
        Report { verdict, findings: findings.iter().map(finding).collect() }
    }

    #[test]
    fn unpublishable_runs_are_named_with_subjects_of_findings() {
        let good = report(Publish::Yes, &[("warm-up", Grade::Good)]);
        let bad = report(
            Publish::No,
            &[
                ("end", Grade::Bad),
                ("clocks", Grade::Bad),
                ("clocks", Grade::Bad),
                ("trend", Grade::Doubtful),
            ],
        );
        let doubtful = report(Publish::WithRemarks, &[("trend", Grade::Doubtful)]);
        let runs = [("#1", &good), ("#2", &bad), ("#3", &doubtful)];
        let sentences = publication_caveats(runs.map(|(name, report)| (name.to_owned(), report)));
        let ending = "; the trust report of each run has the reasons and the advice.";
        assert_eq!(
            sentences,
            [
                (Grade::Bad, format!("1 of 3 runs cannot be published: #2 (end, clocks){ending}")),
                (
                    Grade::Doubtful,
                    format!("1 of 3 runs can be published only with caveats: #3 (trend){ending}")
                ),
            ]
        );
        assert!(publication_caveats([("#1".to_owned(), &good)]).is_empty());
        // Three edges of one run.
        let fault = report(Publish::No, &[("clock fault", Grade::Bad), ("end", Grade::Bad)]);
        let edges = publication_caveats([&good, &bad, &fault].map(|report| ("001".to_owned(), report)));
        let text = format!("The run cannot be published: 001 (end, clocks, clock fault){ending}");
        assert_eq!(edges, [(Grade::Bad, text)]);
    }

    #[test]
    fn many_unpublishable_runs_are_counted() {
        let bad = report(Publish::No, &[("end", Grade::Bad)]);
        let sentences = publication_caveats((0..20).map(|run| (format!("#{run}"), &bad)));
        assert!(sentences[0].1.contains("#7 (end), and 12 more;"), "{sentences:?}");
    }
}
