//! Texts that say which of several runs can be published, and how many.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use peernet_statistics::number::{counted, list_first};
use peernet_stream::Grade;

use super::{Publish, Report, sign};

/// A run with the report of each of its edges; `None` for an edge without a report.
struct JudgedRun<'a> {
    name: String,
    reports: Vec<Option<&'a Report>>,
}

impl<'a> JudgedRun<'a> {
    /// Groups the reports of edges by the names of their runs.
    fn from_edges(edges: impl IntoIterator<Item = (String, Option<&'a Report>)>) -> Vec<Self> {
        let mut runs: Vec<Self> = Vec::new();
        for (name, report) in edges {
            match runs.iter_mut().find(|run| run.name == name) {
                Some(run) => run.reports.push(report),
                None => runs.push(Self { name, reports: vec![report] }),
            }
        }
        runs
    }

    /// Returns the worst verdict on the edges. `None` if no edge has a report. Also `None` if an edge has no report and
    /// the other edges can be published as they are: the verdict on the run is then not known.
    fn verdict(&self) -> Option<Publish> {
        let worst = self.reports.iter().flatten().map(|report| report.verdict).max()?;
        (worst > Publish::Yes || self.reports.iter().all(Option::is_some)).then_some(worst)
    }

    /// Returns the subjects on which the worst finding has this grade, each once, in the order of the reports. A run
    /// may have several findings on a subject, one for each host.
    fn subjects(&self, grade: Grade) -> Vec<&'a str> {
        let findings = || self.reports.iter().copied().flatten().flat_map(|report| &report.findings);
        let has_worse =
            |about: &str| findings().any(|finding| finding.about == about && finding.grade > grade);
        let of_grade = findings().filter(|finding| finding.grade == grade);
        let subjects = of_grade.map(|finding| finding.about.as_str());
        let mut seen_subjects = BTreeSet::new();
        subjects.filter(|about| !has_worse(about) && seen_subjects.insert(*about)).collect()
    }
}

/// Returns a sentence about the runs that cannot be published, and a sentence about the runs that can be published only
/// with caveats. Each sentence has the grade of its findings. `edges` has the report of each edge, with the name of its
/// run; `None` for an edge without a report. A run has the findings of all its edges and the worst of their verdicts.
/// Empty if all runs can be published as they are.
pub fn publication_caveats<'a>(
    edges: impl IntoIterator<Item = (String, Option<&'a Report>)>,
) -> Vec<(Grade, String)> {
    let runs = JudgedRun::from_edges(edges);
    let sentence = |verdict: Publish, grade: Grade, meaning: &str| {
        let affected_runs = runs.iter().filter(|run| run.verdict() == Some(verdict));
        let names: Vec<String> =
            affected_runs.map(|run| format!("{} ({})", run.name, run.subjects(grade).join(", "))).collect();
        if names.is_empty() {
            return None;
        }
        let count = match (names.len(), runs.len()) {
            (1, 1) => "The run".to_owned(),
            (count, all) => format!("{count} of {all} runs"),
        };
        let text = format!(
            "{count} {meaning}: {}; the trust report of each run has the reasons and the advice.",
            list_first(&names)
        );
        Some((grade, text))
    };
    let sentences = [
        sentence(Publish::No, Grade::Bad, "cannot be published"),
        sentence(Publish::WithRemarks, Grade::Doubtful, "can be published only with caveats"),
    ];
    sentences.into_iter().flatten().collect()
}

/// Returns the number of runs for each verdict, and the number of runs for each subject of a bad or doubtful finding,
/// the most frequent subject first. For `edges`, see [`publication_caveats`].
pub fn publication_summary<'a>(edges: impl IntoIterator<Item = (String, Option<&'a Report>)>) -> String {
    let runs = JudgedRun::from_edges(edges);
    let count = |verdict| runs.iter().filter(|run| run.verdict() == Some(verdict)).count();
    let [yes, remarks, no] = [Publish::Yes, Publish::WithRemarks, Publish::No].map(count);
    let mut lines =
        vec![format!("Can they be published? {yes} as they are, {remarks} with caveats, {no} not.")];
    for grade in [Grade::Bad, Grade::Doubtful] {
        let mut counts: BTreeMap<&str, u64> = BTreeMap::new();
        for subject in runs.iter().flat_map(|run| run.subjects(grade)) {
            *counts.entry(subject).or_default() += 1;
        }
        let mut counts: Vec<(&str, u64)> = counts.into_iter().collect();
        counts.sort_by_key(|(_, count)| Reverse(*count));
        let line =
            |(subject, count): (&str, u64)| format!("  {} {subject}: {}", sign(grade), counted(count, "run"));
        lines.extend(counts.into_iter().map(line));
    }
    if lines.len() > 1 {
        lines.push("  run.json of each run has the findings and advice, under trust".to_owned());
    }
    lines.join("\n")
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
        let sentences = publication_caveats(runs.map(|(name, report)| (name.to_owned(), Some(report))));
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
        assert!(publication_caveats([("#1".to_owned(), Some(&good))]).is_empty());
        // Three edges of one run.
        let fault = report(Publish::No, &[("clock fault", Grade::Bad), ("end", Grade::Bad)]);
        let edges = publication_caveats([&good, &bad, &fault].map(|report| ("001".to_owned(), Some(report))));
        let text = format!("The run cannot be published: 001 (end, clocks, clock fault){ending}");
        assert_eq!(edges, [(Grade::Bad, text)]);
    }

    #[test]
    fn unpublishable_runs_beyond_eight_are_counted() {
        let bad = report(Publish::No, &[("end", Grade::Bad)]);
        let sentences = publication_caveats((0..20).map(|run| (format!("#{run}"), Some(&bad))));
        assert!(sentences[0].1.contains("#7 (end) and 12 more;"), "{sentences:?}");
    }

    #[test]
    fn run_counts_once_for_a_subject_of_two_hosts() {
        let load = |grade| ("competing load", grade);
        // The two findings of a run are those of edge and cloud.
        let both = report(Publish::No, &[load(Grade::Bad), load(Grade::Doubtful)]);
        let bad = report(Publish::No, &[load(Grade::Bad)]);
        let doubtful = report(Publish::WithRemarks, &[load(Grade::Doubtful), load(Grade::Good)]);
        let runs = [("001", &both), ("002", &bad), ("003", &doubtful)];
        let summary = publication_summary(runs.map(|(name, report)| (name.to_owned(), Some(report))));
        let lines = [
            "Can they be published? 0 as they are, 1 with caveats, 2 not.",
            "  ✗ competing load: 2 runs",
            "  ! competing load: 1 run",
            "  run.json of each run has the findings and advice, under trust",
        ];
        assert_eq!(summary.lines().collect::<Vec<_>>(), lines);
    }

    #[test]
    fn summary_and_caveats_agree_without_report_of_edge() {
        let good = report(Publish::Yes, &[]);
        let bad = report(Publish::No, &[("end", Grade::Bad)]);
        let edges = || {
            [("001", Some(&good)), ("001", None), ("002", Some(&bad)), ("002", None)]
                .map(|(name, report)| (name.to_owned(), report))
        };
        let summary = publication_summary(edges());
        assert!(
            summary.starts_with("Can they be published? 0 as they are, 0 with caveats, 1 not."),
            "{summary}"
        );
        assert!(summary.contains("✗ end: 1 run"), "{summary}");
        let caveats = publication_caveats(edges());
        assert_eq!(caveats.len(), 1, "{caveats:?}");
        assert!(caveats[0].1.starts_with("1 of 2 runs cannot be published: 002 (end);"), "{caveats:?}");
    }
}
