//! Judgement of missing measurements: failed iterations, skipped starts, superseded answers, missing events and an
//! early end.

use peernet_statistics::MIN_VALUES_FOR_P95;
use peernet_statistics::number::{count, counted, rate};
use peernet_stream::Grade;

use super::{END, finding, iterations, percent, with_advice};
use crate::outcomes::{Counts, failed_share, failed_texts};
use crate::trust::{EndedEarly, Finding, MissingCount, MissingEvents, Starts, TrustInput};

/// A finding about failed iterations, skipped starts or superseded answers is doubtful if their share is above this
/// value. Comparisons note failed iterations and skipped starts by the same limit.
pub const NOTABLE_SHARE: f64 = 0.001;
/// A finding about failed iterations, skipped starts or superseded answers is bad if their share is above this value,
/// because the latency of the successful iterations is then misleading.
const MISLEADING_SHARE: f64 = 0.1;
/// If at least this share of the events is missing, the received events do not represent the whole run.
const MAX_MISSING_SHARE: f64 = 0.05;
/// A run that reached less than this share of its configured limit is too short for its purpose.
const MIN_REACHED_SHARE: f64 = 0.5;

pub(super) fn findings(input: &TrustInput) -> Vec<Finding> {
    let TrustInput { counts, missing, .. } = input;
    let mut findings = vec![judge_amount(counts)];
    if counts.measured() > 0 {
        findings.push(judge_failed(counts));
        findings.extend(judge_skipped_starts(&input.starts));
        findings.extend(judge_superseded(input));
    }
    findings.push(judge_missing_events(counts, missing));
    findings.extend(judge_end(input));
    if input.has_clock_fault {
        let text = "Clock fault injection made the clock of a host wrong on purpose.";
        findings.push(with_advice(
            finding("clock fault", Grade::Bad, text),
            "remove `[clock_fault]` from the configuration",
        ));
    }
    findings
}

/// Returns the finding about a run that is shorter than configured or not finished; `None` if the run is complete.
fn judge_end(input: &TrustInput) -> Option<Finding> {
    if input.in_progress {
        return Some(finding(
            END,
            Grade::Unknown,
            "The run has no recorded end (in progress or killed): the findings cover the iterations so far.",
        ));
    }
    let early = input.ended_early.as_ref();
    let finished = || Some(format!("finished {}: there was nothing more to measure", early?.progress_text()));
    let text = EndedEarly::end_text(input.failure.as_deref(), early).or_else(finished)?;
    let text = format!("The run {text}.");
    Some(match early {
        Some(early) if early.reached_share() < MIN_REACHED_SHARE => {
            with_advice(finding(END, Grade::Bad, text), "repeat the run")
        }
        // Nobody knows what the missing part of the run would have shown, so that the run is doubtful at best.
        _ => with_advice(
            finding(END, Grade::Doubtful, text),
            "repeat the run, or report this beside the results",
        ),
    })
}

fn judge_amount(counts: &Counts) -> Finding {
    let about = "amount";
    let warm_up = match counts.warm_up {
        0 => "no warm-up was left out".to_owned(),
        1 => "1 iteration of warm-up is left out".to_owned(),
        n => format!("{} of warm-up are left out", iterations(n)),
    };
    match counts.ok {
        0 => {
            let finding = finding(about, Grade::Bad, format!("No iteration succeeded; {warm_up}."));
            with_advice(finding, "find the reasons on the run's page or in the column `reason` of `data.csv`")
        }
        few @ ..MIN_VALUES_FOR_P95 => {
            let text =
                format!("Only {} succeeded: too few for a 95th percentile; {warm_up}.", iterations(few));
            with_advice(
                finding(about, Grade::Doubtful, text),
                format!("measure at least {MIN_VALUES_FOR_P95} iterations, better 1,000"),
            )
        }
        ok => finding(about, Grade::Good, format!("{} succeeded; {warm_up}.", iterations(ok))),
    }
}

fn judge_failed(counts: &Counts) -> Finding {
    let about = "losses";
    let outcome_texts = failed_texts(&counts.outcomes());
    let share = failed_share(&counts.outcomes()).unwrap_or_default();
    if outcome_texts.is_empty() {
        return finding(about, Grade::Good, "No iteration failed.");
    }
    let text = format!(
        "{} of {} failed ({}): {}.",
        count(counts.all_failed()),
        iterations(counts.measured()),
        percent(share),
        outcome_texts.join(", ")
    );
    let advice = "the statistics leave out failed iterations, which are rarely fast: report the share of failed iterations beside the latency";
    match share {
        share if share > MISLEADING_SHARE => with_advice(
            finding(about, Grade::Bad, text),
            format!("{advice}; find out why so many iterations failed"),
        ),
        share if share > NOTABLE_SHARE => with_advice(finding(about, Grade::Doubtful, text), advice),
        _ => finding(about, Grade::Good, text),
    }
}

/// Returns the finding about the starts of an open loop; `None` for a closed loop.
fn judge_skipped_starts(starts: &Starts) -> Option<Finding> {
    let about = "skipped starts";
    let configured_hz = starts.hz.map(rate);
    let Some(skipped_text) = starts.skipped_text() else {
        let text = configured_hz
            .map(|hz| format!("No start was skipped: {hz}\u{202f}Hz were configured and achieved."));
        return text.map(|text| finding(about, Grade::Good, text));
    };
    let share = starts.skipped_share();
    let achieved = starts.actual_hz().map(|hz| format!(", {}\u{202f}Hz achieved", rate(hz)));
    let rates = configured_hz.map_or_else(String::new, |hz| {
        format!(": {hz}\u{202f}Hz were configured{}", achieved.unwrap_or_default())
    });
    let text = format!(
        "{skipped_text} {} skipped because the pipeline could not keep up{rates}.",
        if starts.skipped == 1 { "was" } else { "were" }
    );
    let advice = "report the achieved rate beside the latency, or configure a lower rate";
    Some(match share {
        share if share > MISLEADING_SHARE => {
            let text = format!("{text} The pipeline worked at its limit, which shows in the latency.");
            with_advice(finding(about, Grade::Bad, text), advice)
        }
        share if share > NOTABLE_SHARE => with_advice(finding(about, Grade::Doubtful, text), advice),
        _ => finding(about, Grade::Good, text),
    })
}

/// Returns the finding about answers that were not acted on; `None` without such answers.
fn judge_superseded(input: &TrustInput) -> Option<Finding> {
    (input.superseded > 0 && input.counts.ok > 0).then_some(())?;
    let share = input.superseded as f64 / input.counts.ok as f64;
    let text = format!(
        "{} of {} ({}) {} superseded: the actuator did not act on them, because it had acted on a newer answer or the \
         episode had ended. The latency includes superseded answers, although they moved nothing.",
        count(input.superseded),
        counted(input.counts.ok, "answer"),
        percent(share),
        if input.superseded == 1 { "was" } else { "were" }
    );
    let advice = "report the share of superseded answers beside the latency; with a lower rate, or fewer iterations in flight, answers arrive in order";
    Some(match share {
        share if share > MISLEADING_SHARE => {
            let text = format!("{text} The robot acted less often than it got answers.");
            with_advice(finding("superseded", Grade::Bad, text), advice)
        }
        share if share > NOTABLE_SHARE => with_advice(finding("superseded", Grade::Doubtful, text), advice),
        _ => finding("superseded", Grade::Good, text),
    })
}

fn judge_missing_events(counts: &Counts, missing: &[MissingEvents]) -> Finding {
    let about = "missing events";
    if missing.is_empty() {
        return finding(about, Grade::Good, "No event was dropped.");
    }
    let missing_count = MissingCount::from_gaps(missing.iter().map(|gap| gap.count));
    let mut reasons: Vec<&str> = Vec::new();
    for gap in missing {
        if !reasons.contains(&gap.reason.as_str()) {
            reasons.push(&gap.reason);
        }
    }
    let expected = counts.measured_with_warm_up().saturating_add(missing_count.known);
    let share = missing_count.known as f64 / expected.max(1) as f64;
    // The share would not include the events of gaps whose number of events is unknown, so it would understate the
    // loss.
    let share_text =
        if missing_count.is_incomplete { String::new() } else { format!(" ({})", percent(share)) };
    let text = format!(
        "{}{share_text} never reached the store: {}.",
        missing_count.sentence_start(),
        reasons.join("; ")
    );
    let advice = "events are dropped under load: check that the disk, the spool and the program keep up, and repeat the run";
    // A gap of unknown size may be most of the run.
    let grade =
        if missing_count.is_incomplete || share >= MAX_MISSING_SHARE { Grade::Bad } else { Grade::Doubtful };
    with_advice(finding(about, grade, text), advice)
}
