//! "Can I publish this run?", from what the store knows of it.

use peernet_analysis::accuracy::{ACCURACIES, UNKNOWN_LABEL, UnknownLabels};
use peernet_analysis::rows::LATENESS;
use peernet_analysis::trust::{
    Clocks, Counts, EndedEarly, Finding, Limits, Load, Missing, Progress, Publish, Report, Restarts, Starts,
    TimeSeries, TrustInput,
};
use peernet_logger::{Name, stage};
use peernet_store::{RunDetail, RunStatistics, RunSummary, StageCourse, Store, StoreError};
use peernet_stream::{EndReason, Grade};
use serde::Deserialize;

use super::accuracy;
use super::chip::{Chip, Tone};

/// Largest number of buckets in which a run's time series is read.
const BUCKETS: usize = 120;

/// The answer as a page shows it.
pub(crate) struct Trust {
    pub chip: Chip,
    pub answer: String,
    /// Findings that speak against publishing or must be mentioned, the most harmful first.
    pub remarks: Vec<Line>,
    /// Findings that are good or unknown.
    pub rest: Vec<Line>,
}

/// One sentence; names and commands stand between backticks.
pub(crate) struct Line {
    pub chip: Chip,
    pub text: String,
    pub advice: String,
}

/// Reads the time series for a report: that of the total, or that of sensing for a run of a sensor alone.
///
/// The stages are read only if the total has moved: over a day they are tens of thousands of rows.
pub(crate) async fn courses(store: &Store, run: i64) -> Result<Vec<StageCourse>, StoreError> {
    let mut found = store.course(run, &[stage::TOTAL], BUCKETS).await?;
    let moved = |course: &StageCourse| {
        TimeSeries::of_summaries(&course.buckets).is_some_and(|course| course.has_moved())
    };
    if found.is_empty() {
        found = store.course(run, &[stage::SENSING], BUCKETS).await?;
    } else if found.iter().any(moved) {
        found.extend(store.course(run, &stage::ORDER, BUCKETS).await?);
    }
    Ok(found)
}

/// Judges a stored run.
pub(crate) fn report(run: &RunDetail, known: &RunStatistics, courses: &[StageCourse]) -> Report {
    let RunStatistics { stages: statistics, bounds, .. } = known;
    let counts = Counts {
        ok: run.summary.counts.ok,
        failed: run.summary.counts.failed,
        lost: run.summary.counts.lost,
        timeout: run.summary.counts.timeout,
        warm_up: run.summary.warm_up,
    };
    let figures =
        |name: &Name| statistics.iter().find(|stage| stage.stage == *name).map(|stage| stage.figures);
    let mut stages: Vec<(String, TimeSeries)> = courses
        .iter()
        .filter_map(|course| Some((course.stage.to_string(), TimeSeries::of_summaries(&course.buckets)?)))
        .collect();
    let total =
        stages.iter().position(|(name, _)| name == stage::TOTAL.as_str()).map(|at| stages.remove(at).1);
    let sensing =
        || stages.iter().find(|(name, _)| name == stage::SENSING.as_str()).map(|(_, series)| series.clone());
    // An agent of another version may write the configuration in another form: the report then knows no limit and no rate.
    let configured: Option<Configured> = toml::from_str(&run.configuration).ok();
    let input = TrustInput {
        conditions: run.conditions.clone(),
        counts,
        open: run.summary.ended.is_none(),
        ended_early: configured.and_then(|configured| ended_early(run, &counts, configured.limit)),
        starts: Starts {
            hz: configured.and_then(|configured| configured.load.hz),
            made_hz: made_hz(run, &counts),
            ..starts(&run.summary)
        },
        missing: run
            .gaps
            .iter()
            .map(|gap| Missing { count: gap.count, reason: gap.reason.clone() })
            .collect(),
        total: total.or_else(sensing),
        unattributed: figures(&stage::UNATTRIBUTED).map(|figures| figures.mean),
        lateness: figures(&Name::from_static(LATENESS)).map(|figures| figures.mean),
        restarts: Restarts::NODES
            .into_iter()
            .filter_map(|(whose, name, _)| {
                let figures = figures(&name)?;
                let seconds = figures.mean * figures.count as f64;
                Some(Restarts { whose, count: figures.count, seconds, iterations: Vec::new() })
            })
            .collect(),
        clocks: bounds
            .iter()
            .map(|bound| Clocks {
                stage: bound.stage.to_string(),
                verdicts: bound.verdicts.clone(),
                delay: figures(&bound.stage).map(|figures| figures.p50),
                half_width: bound.half_width.map(|width| width.p50),
            })
            .collect(),
        stages,
        accuracy: ACCURACIES
            .into_iter()
            .filter_map(|name| {
                let scores = statistics.iter().find(|stage| stage.stage == *name)?.figures;
                Some((name.to_owned(), accuracy::of(&scores, counts.ok)?))
            })
            .collect(),
        unknown_labels: statistics
            .iter()
            .find(|stage| stage.stage == *UNKNOWN_LABEL)
            .and_then(|stage| UnknownLabels::new(stage.figures.count, &run.facts)),
        ..TrustInput::default()
    };
    Report::of(&input.ended(run.summary.reason.as_ref()).with_facts(&run.facts))
}

/// Part of a run's configuration that a report needs.
#[derive(Clone, Copy, Deserialize)]
struct Configured {
    #[serde(default)]
    limit: Limits,
    #[serde(default)]
    load: Load,
}

/// What became of the starts that were ordered; rates are not asked for.
pub(crate) fn starts(run: &RunSummary) -> Starts {
    Starts { kept: run.counts.total(), skipped: run.skipped_starts, ..Starts::default() }
}

/// Starts per second over the whole run: the store does not keep when the warm-up ended.
fn made_hz(run: &RunDetail, counts: &Counts) -> Option<f64> {
    let seconds = (run.summary.last_iteration? - run.summary.started).seconds();
    // Missing iterations were started, too.
    let known = run.gaps.is_empty() && seconds > 0.0;
    known.then(|| (counts.measured() + counts.warm_up) as f64 / seconds)
}

/// Compares a run that has ended with the limits in its configuration.
fn ended_early(run: &RunDetail, counts: &Counts, limit: Limits) -> Option<EndedEarly> {
    let summary = &run.summary;
    summary.ended?;
    // If the number of missing events is unknown, so is how far the run came.
    let unseen = run.gaps.iter().map(|gap| (gap.count > 0).then_some(gap.count)).sum::<Option<u64>>()?;
    let progress = Progress {
        measured: counts.measured() + unseen,
        warm_up: counts.warm_up,
        // Of its whole length: the store does not keep when the warm-up ended.
        seconds: summary.last_iteration.map_or(0.0, |last| (last - summary.started).seconds()),
    };
    EndedEarly::of(&limit, &progress, summary.reason.as_ref().unwrap_or(&EndReason::Unknown))
}

impl From<&Report> for Trust {
    fn from(report: &Report) -> Self {
        let (worse, rest) =
            report.sentences.iter().partition::<Vec<_>, _>(|sentence| sentence.grade > Grade::Unknown);
        let lines = |sentences: Vec<&Finding>| {
            let line = |sentence: &Finding| Line {
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
    use peernet_clock::Span;
    use peernet_store::GapRow;
    use peernet_stream::PlacementKind;

    use super::*;
    use crate::tests::samples::NOW;
    use crate::view::compare::tests::{run, stages};

    /// A run of 300 iterations in 59 s.
    fn detail(configuration: &str, reason: &str) -> RunDetail {
        let mut summary = run(1, PlacementKind::Remote);
        summary.reason = Some(reason.into());
        RunDetail { configuration: configuration.to_owned(), ..summary.into() }
    }

    fn end(run: &RunDetail) -> Option<(Grade, String)> {
        let report = report(run, &RunStatistics::default(), &[]);
        let found = report.sentences.into_iter().find(|sentence| sentence.about == "end");
        found.map(|sentence| (sentence.grade, sentence.text))
    }

    #[test]
    fn run_that_ended_before_its_limit_is_reported() {
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
    fn answers_without_score_are_reported() {
        let run = detail("", "finished");
        let ok = run.summary.counts.ok;
        let (mut stages, _) = stages(1.0, 1e3);
        let mut top = stages[0].clone();
        (top.stage, top.figures.count, top.figures.mean) = (Name::from("top-1"), ok - 12, 0.75);
        stages.push(top);
        let mut known = RunStatistics { stages, ..RunStatistics::default() };
        let said = |known: &RunStatistics| {
            let report = report(&run, known, &[]);
            report.sentences.into_iter().find(|sentence| sentence.text.contains("top-1"))
        };
        let text = said(&known).expect("a sentence").text;
        assert!(text.contains("12"), "{text}");
        known.stages.last_mut().expect("top-1").figures.count = ok;
        assert!(said(&known).is_none(), "all were scored");
    }

    #[test]
    fn restarted_process_is_reported() {
        let (mut stages, _) = stages(1.0, 1e3);
        let mut restart = stages[0].clone();
        (restart.stage, restart.figures.count, restart.figures.mean) = (stage::RESTART, 2, 0.5);
        stages.push(restart);
        let report =
            report(&detail("", "finished"), &RunStatistics { stages, ..RunStatistics::default() }, &[]);
        let said = report.sentences.iter().find(|sentence| sentence.about == "restarts").expect("said");
        assert!(
            said.text.contains("The model's process was started anew in 2 iterations, which waited 1,000"),
            "{said:?}"
        );
    }

    #[test]
    fn labels_outside_models_classes_are_reported() {
        let mut run = detail("", "finished");
        run.facts.push(("Classes".to_owned(), "4: good, dented".to_owned()));
        let (mut stages, _) = stages(1.0, 1e3);
        let mut unknown = stages[0].clone();
        (unknown.stage, unknown.figures.count) = (Name::from(UNKNOWN_LABEL), 12);
        stages.push(unknown);
        let report = report(&run, &RunStatistics { stages, ..RunStatistics::default() }, &[]);
        let said = report.sentences.iter().find(|sentence| sentence.about == "accuracy").expect("said");
        assert!(said.text.starts_with("Not scored: 12 of") && said.text.contains("good, dented"), "{said:?}");
    }

    #[test]
    fn skipped_starts_are_reported_with_ordered_rate() {
        let mut run = detail("name = \"line\"\n\n[load]\nmode = \"rate\"\nhz = 40\n", "finished");
        let mut said = |skipped_starts| {
            run.summary.skipped_starts = skipped_starts;
            let report = report(&run, &RunStatistics::default(), &[]);
            let found = report.sentences.into_iter().find(|sentence| sentence.about == "skipped starts");
            found.map(|sentence| (sentence.grade, sentence.text)).expect("said")
        };
        let (grade, text) = said(300);
        let rates = "40.0\u{202f}Hz were ordered, 5.17 starts a second were made";
        assert!(
            grade == Grade::Bad && text.starts_with("300 of 600 starts") && text.contains(rates),
            "{text}"
        );
        assert_eq!(said(0).0, Grade::Good);
    }

    #[test]
    fn unknown_number_of_missing_events_is_not_reported() {
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
