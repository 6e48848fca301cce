//! Runs in a list.

use peernet_aggregator::LiveState;
use peernet_analysis::compare::describe_labels;
use peernet_analysis::outcomes::failed_share;
use peernet_analysis::trust::MissingCount;
use peernet_statistics::number::{NONE, count, counted, long_duration, milliseconds, percent};
use peernet_store::{GapRow, RetentionConfig, RunSummary};
use peernet_stream::ExperimentPosition;

use super::chip::{Chip, Tone};
use super::notes::Note;
use super::{clock_fault, place};
use crate::error::WebError;
use crate::zone::{Zone, ZonedTime};

/// Chip of a pinned run. Retention deletes nothing of such a run.
pub(crate) const PINNED: Chip = Chip::new(Tone::Quiet, "pin", "pinned");

/// End of a run.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum End {
    /// The run has not ended: its host is connected and reports the run.
    InProgress,
    /// The run ended, and its agent reported this reason.
    Reported(String),
    /// No end was reported, because the agent was killed or is not connected. Contains the start of the last stored
    /// iteration.
    Unreported(Option<ZonedTime>),
}

impl End {
    pub(crate) fn of(run: &RunSummary, snapshot: &LiveState, zone: Zone) -> Self {
        if run.ended.is_some() {
            return Self::Reported(
                run.reason.as_ref().map_or_else(|| "ended".to_owned(), ToString::to_string),
            );
        }
        let connected = || snapshot.hosts.iter().any(|host| host.id == run.host && host.connected);
        let is_current = snapshot
            .pipelines
            .iter()
            .any(|pipeline| pipeline.host == run.host && pipeline.run == Some(run.id));
        if is_current && connected() {
            return Self::InProgress;
        }
        Self::Unreported(run.last_iteration.map(|at| zone.moment(at)))
    }
}

/// Experiment of a run, with the run's configuration and repeat.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ExperimentLabels {
    pub name: String,
    pub id: String,
    /// `Where = cloud, Resize = yes, repeat 2`.
    pub text: String,
}

impl ExperimentLabels {
    fn of(position: &ExperimentPosition) -> Self {
        let text = describe_labels(&position.configuration, Some(position.repeat));
        Self { name: position.name.clone(), id: position.id.clone(), text }
    }
}

/// One run.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RunLine {
    pub number: i64,
    pub pipeline: String,
    pub route: String,
    pub model: String,
    pub started: ZonedTime,
    /// Time from the start of the run to its end, or to its last stored iteration if no end was reported.
    pub lasted: String,
    pub end: End,
    pub iterations: String,
    /// Share of iterations without success, percent.
    pub failed: String,
    pub p50: String,
    pub p95: String,
    pub p99: String,
    pub clock_fault: Option<Chip>,
    pub pinned: Option<Chip>,
    pub experiment: Option<ExperimentLabels>,
}

/// Returns when or why iterations are deleted, as the end of a sentence: `after 7 days`.
fn deletion_reason(retention: &RetentionConfig) -> String {
    // The value 0 of either setting is no limit.
    match (retention.nodes_days, retention.size_limit_bytes) {
        (1, 0) => "after 1 day".to_owned(),
        (days, 0) if days > 0 => format!("after {} days", count(days.into())),
        // With a size limit, both reasons are possible. Without any limit, an earlier configuration deleted the
        // iterations.
        _ => "because of their age or to free disk space".to_owned(),
    }
}

/// Rejects a request for an iteration that is not stored, if retention deleted it.
pub(crate) fn reject_deleted(
    run: &RunSummary,
    iteration: u64,
    retention: &RetentionConfig,
) -> Result<(), WebError> {
    // The first iteration has the number 1, so no iteration 0 was deleted.
    if iteration == 0 || iteration > run.last_deleted_iteration {
        return Ok(());
    }
    let (number, last, why) = (run.number, run.last_deleted_iteration, deletion_reason(retention));
    Err(WebError::Gone(format!(
        "iterations 1 to {last} of run {number} were deleted {why}, iteration {iteration} among them; the statistics \
         of the run remain"
    )))
}

/// Returns a note about the iterations that retention deleted.
pub(crate) fn deleted_iterations_note(run: &RunSummary, retention: &RetentionConfig) -> Option<Note> {
    let which = match run.last_deleted_iteration {
        0 => return None,
        1 => "Iteration 1".to_owned(),
        last => format!("Iterations 1 to {}", count(last)),
    };
    Some(Note {
        chip: Chip::new(Tone::Quiet, "gap", "deleted"),
        subject: which,
        href: String::new(),
        text: format!(
            "can no longer be opened: deleted {}. The statistics remain.",
            deletion_reason(retention)
        ),
        link: None,
    })
}

/// Returns a note for each reason why events were not recorded: the number of missing events, and the time from the
/// beginning of the first gap to the end of the last.
pub(crate) fn gap_notes(gaps: &[GapRow], zone: Zone) -> Vec<Note> {
    let mut reasons: Vec<&str> = gaps.iter().map(|gap| gap.reason.as_str()).collect();
    reasons.sort_unstable();
    reasons.dedup();
    let notes = reasons.into_iter().filter_map(|reason| {
        let gaps_of_reason = || gaps.iter().filter(|gap| gap.reason == reason);
        let (from, to) =
            (gaps_of_reason().map(|gap| gap.from).min()?, gaps_of_reason().map(|gap| gap.to).max()?);
        let missing = MissingCount::from_gaps(gaps_of_reason().map(|gap| gap.count));
        let was = if missing.known == 1 && !missing.is_incomplete { "was" } else { "were" };
        let subject = format!("{} of this run", missing.sentence_start());
        let [from, to] = [from, to].map(|at| zone.moment(at).time_of_day());
        // One row may combine several gaps.
        let gap_count: u64 = gaps_of_reason().map(|gap| gap.gaps).sum();
        let gap_count = counted(gap_count, "gap");
        Some(Note {
            chip: Chip::new(Tone::Warn, "gap", "gap"),
            subject,
            href: String::new(),
            text: format!("{was} not recorded: {reason} (from {from} to {to}, in {gap_count})."),
            link: None,
        })
    });
    notes.collect()
}

impl RunLine {
    pub(crate) fn new(run: &RunSummary, snapshot: &LiveState, zone: Zone) -> Self {
        let quantile = |value: Option<f64>| value.map_or_else(|| NONE.to_owned(), milliseconds);
        let total = run.total.as_ref();
        Self {
            number: run.number,
            pipeline: run.pipeline.to_string(),
            route: place::route(run.host_name.as_str(), &run.placement),
            model: place::model(&run.placement),
            started: zone.moment(run.started),
            lasted: run
                .end_time()
                .map_or_else(|| NONE.to_owned(), |end| long_duration((end - run.started).seconds())),
            end: End::of(run, snapshot, zone),
            iterations: count(run.counts.total()),
            failed: failed_share(&run.counts).map_or_else(|| NONE.to_owned(), percent),
            p50: quantile(total.map(|total| total.p50)),
            p95: quantile(total.and_then(|total| total.p95)),
            p99: quantile(total.and_then(|total| total.p99)),
            clock_fault: run.has_clock_fault.then_some(clock_fault::CHIP),
            pinned: run.pinned.then_some(PINNED),
            experiment: run.experiment.as_ref().map(ExperimentLabels::of),
        }
    }
}

#[cfg(test)]
mod tests {
    use peernet_analysis::trust::{MissingEvents, Report, TrustInput};
    use peernet_clock::Span;

    use super::*;
    use crate::tests::samples;

    #[test]
    fn gaps_are_listed_with_reason_and_time() {
        let gap = |after, count, reason: &str| GapRow {
            from: samples::NOW + Span::from_seconds(after),
            to: samples::NOW + Span::from_seconds(after + 5),
            count,
            reason: reason.to_owned(),
            gaps: 1,
        };
        let gaps =
            [gap(60, 849, "no room"), gap(0, 40_000, "no room"), gap(30, 0, "batches 3 to 9 are missing")];
        let partly_known = [gap(0, 849, "no room"), gap(60, 0, "no room")];
        let subject = "At least 849 events";
        assert_eq!(gap_notes(&partly_known, Zone::Utc)[0].subject, format!("{subject} of this run"));
        // The trust report of the run has the same subject.
        let missing = partly_known
            .iter()
            .map(|gap| MissingEvents { count: gap.count, reason: gap.reason.clone() })
            .collect();
        let report = Report::new(&TrustInput { missing, ..TrustInput::default() });
        assert!(report.findings.iter().any(|finding| finding.text.starts_with(subject)), "{report:?}");
        let notes = gap_notes(&gaps, Zone::Utc);
        let texts: Vec<String> = notes.iter().map(|note| format!("{} {}", note.subject, note.text)).collect();
        assert_eq!(
            texts,
            [
                "An unknown number of events of this run were not recorded: batches 3 to 9 are missing (from 12:01:37 \
                 to 12:01:42, in 1 gap).",
                "40,849 events of this run were not recorded: no room (from 12:01:07 to 12:02:12, in 2 gaps).",
            ]
        );
        assert!(gap_notes(&[], Zone::Utc).is_empty());
        let combined = GapRow { gaps: 500, ..gap(60, 5_000, "no room") };
        let notes = gap_notes(&[gap(0, 10, "no room"), combined], Zone::Utc);
        assert!(notes[0].text.ends_with("in 501 gaps)."), "{}", notes[0].text);
    }

    #[test]
    fn run_of_experiment_shows_its_labels() {
        let position = |configuration: &[(&str, &str)], repeat| ExperimentPosition {
            name: "resize".to_owned(),
            id: "a".to_owned(),
            configuration: configuration.iter().map(|(a, b)| ((*a).to_owned(), (*b).to_owned())).collect(),
            repeat,
            ..ExperimentPosition::default()
        };
        let labels = ExperimentLabels::of(&position(&[("Where", "cloud"), ("Resize", "yes")], 1));
        assert_eq!(labels.text, "Where = cloud, Resize = yes, repeat 2");
        assert_eq!(ExperimentLabels::of(&position(&[], 0)).text, "repeat 1");
    }

    #[test]
    fn reason_of_deletion_is_shown_if_known() {
        let why = |nodes_days, size_limit_bytes| {
            deletion_reason(&RetentionConfig { nodes_days, size_limit_bytes, ..RetentionConfig::default() })
        };
        assert_eq!((why(7, 0).as_str(), why(1, 0).as_str()), ("after 7 days", "after 1 day"));
        assert_eq!(why(7, 1 << 30), "because of their age or to free disk space");
        assert_eq!(
            why(0, 0),
            "because of their age or to free disk space",
            "an earlier configuration deleted them"
        );
    }
}
