//! "Can I publish this run?", from what the store knows of it.

use peernet_aggregator::{Bound, RunDetail, StageCourse, StageStatistics, Store, StoreError};
use peernet_logger::stream::Grade;
use peernet_logger::{Name, stage};
use peernet_report::accuracy::ACCURACIES;
use peernet_report::trust::{
    Came, Clocks, Counts, Course, Early, Evidence, Limits, Missing, Publish, Report,
};
use serde::Deserialize;

use super::accuracy;
use super::chip::{Chip, Tone};

/// Most buckets that a run's course is read in.
const BUCKETS: usize = 120;

/// The answer as a page shows it.
pub(crate) struct Trust {
    pub chip: Chip,
    pub answer: String,
    /// What speaks against it or is to be said, the most harmful first.
    pub remarks: Vec<Line>,
    /// What is as it should be, or could not be found out.
    pub rest: Vec<Line>,
}

/// One sentence; names and commands stand between backticks.
pub(crate) struct Line {
    pub chip: Chip,
    pub text: String,
    pub advice: String,
}

/// Reads what a report rests on beside what the run's page has read anyway: the total, a sensor's alone where nothing
/// else is there. The stages are asked only where the total moved: over a day they are tens of thousands of rows.
pub(crate) async fn courses(store: &Store, run: i64) -> Result<Vec<StageCourse>, StoreError> {
    let mut found = store.course(run, &[stage::TOTAL], BUCKETS).await?;
    let moved =
        |course: &StageCourse| Course::of_summaries(&course.buckets).is_some_and(|course| course.has_moved());
    if found.is_empty() {
        found = store.course(run, &[stage::SENSING], BUCKETS).await?;
    } else if found.iter().any(moved) {
        found.extend(store.course(run, &stage::ORDER, BUCKETS).await?);
    }
    Ok(found)
}

/// Judges a stored run.
pub(crate) fn report(
    run: &RunDetail,
    stages: &[StageStatistics],
    bounds: &[Bound],
    courses: &[StageCourse],
) -> Report {
    let counts = Counts {
        ok: run.summary.counts.ok,
        failed: run.summary.counts.failed,
        lost: run.summary.counts.lost,
        timeout: run.summary.counts.timeout,
        warm_up: run.summary.warm_up,
    };
    let known = |name: &Name| stages.iter().find(|stage| stage.stage == *name).map(|stage| stage.figures);
    let mut of: Vec<(String, Course)> = courses
        .iter()
        .filter_map(|known| Some((known.stage.to_string(), Course::of_summaries(&known.buckets)?)))
        .collect();
    let at = of.iter().position(|(name, _)| name == stage::TOTAL.as_str());
    let total = at.map(|at| of.remove(at).1);
    let sensing =
        || of.iter().find(|(name, _)| name == stage::SENSING.as_str()).map(|(_, course)| course.clone());
    let evidence = Evidence {
        conditions: run.conditions.clone(),
        counts,
        open: run.summary.ended.is_none(),
        early: early(run, &counts),
        missing: run
            .gaps
            .iter()
            .map(|gap| Missing { count: gap.count, reason: gap.reason.clone() })
            .collect(),
        total: total.or_else(sensing),
        unattributed: known(&stage::UNATTRIBUTED).map(|figures| figures.mean),
        clocks: bounds
            .iter()
            .map(|bound| Clocks {
                stage: bound.stage.to_string(),
                verdicts: bound.verdicts.clone(),
                delay: known(&bound.stage).map(|figures| figures.p50),
                half_width: bound.half_width.map(|width| width.p50),
            })
            .collect(),
        stages: of,
        accuracy: ACCURACIES
            .into_iter()
            .filter_map(|name| {
                let scores = stages.iter().find(|stage| stage.stage == *name)?.figures;
                Some((name.to_owned(), accuracy::of(&scores, counts.ok)?))
            })
            .collect(),
        ..Evidence::default()
    };
    Report::of(&evidence.ended(run.summary.reason.as_deref()).with_facts(&run.facts))
}

/// How far a run that has ended came of what its configuration asks for.
fn early(run: &RunDetail, counts: &Counts) -> Option<Early> {
    #[derive(Deserialize)]
    struct Configured {
        #[serde(default)]
        limit: Limits,
    }
    // Written by the agent itself; one of another version may order in other ways, of which nothing can be said.
    let Configured { limit } = toml::from_str(&run.configuration).ok()?;
    let summary = &run.summary;
    summary.ended?;
    // Where nobody knows how many are missing, nobody knows how far it came.
    let unseen = run.gaps.iter().map(|gap| (gap.count > 0).then_some(gap.count)).sum::<Option<u64>>()?;
    let came = Came {
        measured: counts.measured() + unseen,
        warm_up: counts.warm_up,
        // Of its whole length: the store does not keep when the warm-up ended.
        seconds: summary.last_iteration.map_or(0.0, |last| (last - summary.started).seconds()),
    };
    Early::of(&limit, &came, summary.reason.as_deref().unwrap_or_default())
}

impl From<&Report> for Trust {
    fn from(report: &Report) -> Self {
        let (worse, rest) =
            report.sentences.iter().partition::<Vec<_>, _>(|sentence| sentence.grade > Grade::Unknown);
        let lines = |sentences: Vec<&peernet_report::trust::Sentence>| {
            let line = |sentence: &peernet_report::trust::Sentence| Line {
                chip: chip(sentence.grade),
                text: sentence.text.clone(),
                advice: sentence.advice.clone(),
            };
            sentences.into_iter().map(line).collect()
        };
        Self {
            chip: match report.verdict {
                Publish::Yes => Chip::new(Tone::Ok, "ok", "yes"),
                Publish::WithRemarks => Chip::new(Tone::Warn, "remark", "with remarks"),
                Publish::No => Chip::new(Tone::Bad, "failed", "no"),
            },
            answer: report.answer(),
            remarks: lines(worse),
            rest: lines(rest),
        }
    }
}

/// A grade by word and sign.
const fn chip(grade: Grade) -> Chip {
    match grade {
        Grade::Good => Chip::new(Tone::Ok, "ok", "good"),
        Grade::Unknown => Chip::new(Tone::Quiet, "unknown", "not known"),
        Grade::Doubtful => Chip::new(Tone::Warn, "remark", "to be said"),
        Grade::Bad => Chip::new(Tone::Bad, "failed", "bad"),
    }
}

#[cfg(test)]
mod tests {
    use peernet_aggregator::GapRow;
    use peernet_clock::Span;
    use peernet_logger::stream::PlacementKind;

    use super::*;
    use crate::view::compare::tests::{run, stages};
    use crate::view::samples::NOW;

    /// 300 of so many iterations; 59 s of a minute.
    fn detail(configuration: &str, reason: &str) -> RunDetail {
        let mut summary = run(1, PlacementKind::Remote);
        summary.reason = Some(reason.to_owned());
        RunDetail {
            summary,
            facts: Vec::new(),
            configuration: configuration.to_owned(),
            version: String::new(),
            conditions: Vec::new(),
            gaps: Vec::new(),
        }
    }

    fn end(run: &RunDetail) -> Option<(Grade, String)> {
        let report = report(run, &[], &[], &[]);
        let found = report.sentences.into_iter().find(|sentence| sentence.about == "end");
        found.map(|sentence| (sentence.grade, sentence.text))
    }

    #[test]
    fn a_run_that_came_less_far_than_its_configuration_asks_for_says_so() {
        let of = |count: u32| format!("name = \"line\"\nmodel = \"m\"\n\n[limit]\niterations = {count}\n");
        let said = |grade, text: &str| Some((grade, text.to_owned()));
        assert_eq!(
            end(&detail(&of(400), "stopped")),
            said(Grade::Doubtful, "The run was interrupted after 300 of 400 iterations.")
        );
        assert_eq!(
            end(&detail(&of(1_000), "the server went")),
            said(Grade::Bad, "The run broke off after 300 of 1,000 iterations: the server went.")
        );
        let seconds = "name = \"line\"\n\n[limit]\nduration_s = 80.0\n";
        assert_eq!(
            end(&detail(seconds, "stopped")),
            said(Grade::Doubtful, "The run was interrupted after 59.0 of 80.0\u{202f}s.")
        );
        for whole in [&of(300), "name = \"line\"\n", "# cannot be written down: why\n", "= not TOML"] {
            assert_eq!(end(&detail(whole, "stopped")), None, "{whole}");
        }
    }

    #[test]
    fn answers_without_a_score_are_told() {
        let run = detail("", "finished");
        let ok = run.summary.counts.ok;
        let (mut stages, _) = stages(1.0, 1e3);
        let mut top = stages[0].clone();
        (top.stage, top.figures.count, top.figures.mean) = (Name::from("top-1"), ok - 12, 0.75);
        stages.push(top);
        let said = |stages: &[StageStatistics]| {
            let report = report(&run, stages, &[], &[]);
            report.sentences.into_iter().find(|sentence| sentence.text.contains("top-1"))
        };
        let text = said(&stages).expect("a sentence").text;
        assert!(text.contains("12"), "{text}");
        stages.last_mut().expect("top-1").figures.count = ok;
        assert!(said(&stages).is_none(), "all were scored");
    }

    #[test]
    fn what_is_not_known_to_be_missing_is_not_said() {
        let mut run = detail("[limit]\niterations = 400\n", "stopped");
        let gap =
            |count| GapRow { from: NOW, to: NOW + Span::from_seconds(1), count, reason: "full".to_owned() };
        run.gaps = vec![gap(100)];
        assert_eq!(end(&run), None, "measured, though not stored");
        run.gaps = vec![gap(0)];
        assert_eq!(end(&run), None, "an unknown number");
        run.gaps.clear();
        run.summary.ended = None;
        let open = "The run has no end yet: all this is of what is there so far.";
        assert_eq!(end(&run), Some((Grade::Unknown, open.to_owned())));
    }
}
