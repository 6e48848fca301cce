//! "Can I publish this run?", from what the store knows of it.

use peernet_aggregator::{Bound, RunDetail, StageCourse, StageStatistics, Store, StoreError};
use peernet_logger::stream::Grade;
use peernet_logger::{Name, stage};
use peernet_report::trust::{Clocks, Counts, Course, Evidence, Missing, Publish, Report};

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

/// One sentence.
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
    let counts = &run.summary.counts;
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
        counts: Counts {
            ok: counts.ok,
            failed: counts.failed,
            lost: counts.lost,
            timeout: counts.timeout,
            warm_up: run.summary.warm_up,
        },
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
        ..Evidence::default()
    };
    Report::of(&evidence.ended(run.summary.reason.as_deref()).with_facts(&run.facts))
}

impl From<&Report> for Trust {
    fn from(report: &Report) -> Self {
        let (worse, rest) =
            report.sentences.iter().partition::<Vec<_>, _>(|sentence| sentence.grade > Grade::Unknown);
        let lines = |sentences: Vec<&peernet_report::trust::Sentence>| {
            let line = |sentence: &peernet_report::trust::Sentence| Line {
                chip: chip(sentence.grade),
                text: plain(&sentence.text),
                advice: plain(&sentence.advice),
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

/// Without the marks that set names and commands apart on a terminal.
fn plain(text: &str) -> String {
    text.replace('`', "")
}
