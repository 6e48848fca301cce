//! Judgement of missing measurements.

use peernet_statistics::number::{counted, fixed, significant};
use peernet_stream::Grade;

use super::{END, advise, iterations, percent, say};
use crate::trust::{Counts, EndedEarly, Finding, Missing, Starts, TrustInput};

/// Samples below which no 95th percentile is given anywhere in PEERNet.
const FEW: u64 = 60;
/// Shares of iterations without an answer, and of skipped starts: from the first on they are mentioned, from the second on the
/// latency of the others is misleading.
const NOTED: f64 = 0.001;
const MANY: f64 = 0.1;
/// Share of missing events from which on the received ones do not represent the missing ones.
const HOLES: f64 = 0.05;
/// Share of the ordered iterations below which a run is too short to represent the ordered one.
const HALF: f64 = 0.5;

pub(super) fn sentences(input: &TrustInput) -> Vec<Finding> {
    let TrustInput { counts, missing, .. } = input;
    let mut all = vec![enough(counts)];
    if counts.measured() > 0 {
        all.push(answered(counts));
        all.extend(kept(&input.starts));
    }
    all.push(whole(counts, missing));
    all.extend(end(input));
    if input.has_clock_fault {
        let text = "The clock of a host was made wrong on purpose (clock fault injection).";
        all.push(advise(
            say("clock fault", Grade::Bad, text),
            "take `[clock_fault]` out of the configuration",
        ));
    }
    all
}

/// Returns the finding about a run that is shorter than ordered, or not finished; `None` if it is complete.
fn end(input: &TrustInput) -> Option<Finding> {
    if input.open {
        return Some(say(
            END,
            Grade::Unknown,
            "The run has no end yet: all this is of what is there so far.",
        ));
    }
    let how_far = input.ended_early.as_ref().map(EndedEarly::how_far);
    let text = match (&input.broken, how_far) {
        (Some(reason), Some(how_far)) => format!("The run broke off {how_far}: {reason}."),
        (Some(reason), None) => format!("The run broke off: {reason}."),
        (None, Some(how_far)) if input.ended_early.as_ref().is_some_and(|early| early.interrupted) => {
            format!("The run was interrupted {how_far}.")
        }
        (None, Some(how_far)) => {
            format!("The run came to its end {how_far}: there was nothing more to measure.")
        }
        (None, None) => return None,
    };
    Some(match &input.ended_early {
        Some(early) if early.share() < HALF => advise(say(END, Grade::Bad, text), "repeat it"),
        _ => advise(say(END, Grade::Doubtful, text), "repeat it, or say so beside the figures"),
    })
}

fn enough(counts: &Counts) -> Finding {
    let about = "amount";
    let warm_up = match counts.warm_up {
        0 => "no warm-up was left out".to_owned(),
        1 => "1 iteration of warm-up is left out".to_owned(),
        n => format!("{} of warm-up are left out", iterations(n)),
    };
    match counts.ok {
        0 => {
            let sentence = say(about, Grade::Bad, format!("No iteration was answered; {warm_up}."));
            advise(sentence, "look at why: the run's page lists the reasons, `data.csv` has them as `reason`")
        }
        few @ ..FEW => {
            let was = if few == 1 { "was" } else { "were" };
            let text =
                format!("Only {} {was} answered: too few for a 95th percentile; {warm_up}.", iterations(few));
            advise(
                say(about, Grade::Doubtful, text),
                format!("measure at least {FEW} iterations, better 1,000"),
            )
        }
        ok => say(about, Grade::Good, format!("{} were answered; {warm_up}.", iterations(ok))),
    }
}

fn answered(counts: &Counts) -> Finding {
    let about = "losses";
    let parts = [(counts.failed, "failed"), (counts.lost, "lost"), (counts.timeout, "not in time")];
    let named = parts.iter().filter(|(count, _)| *count > 0);
    let named: Vec<String> =
        named.map(|(count, word)| format!("{} {word}", fixed(*count as f64, 0))).collect();
    let share = counts.unanswered() as f64 / counts.measured() as f64;
    if named.is_empty() {
        return say(about, Grade::Good, "Every iteration had an answer.");
    }
    let text = format!(
        "{} of {} had no answer ({}): {}.",
        fixed(counts.unanswered() as f64, 0),
        iterations(counts.measured()),
        percent(share),
        named.join(", ")
    );
    let advice = "the statistics are of the answered ones alone, and those without an answer are seldom the fast ones: \
                  give their share beside the latency";
    match share {
        share if share > MANY => {
            advise(say(about, Grade::Bad, text), format!("{advice}; see why there are so many"))
        }
        share if share > NOTED => advise(say(about, Grade::Doubtful, text), advice),
        _ => say(about, Grade::Good, text),
    }
}

/// Returns the finding about the starts of an open loop; `None` for a closed loop.
fn kept(starts: &Starts) -> Option<Finding> {
    let about = "skipped starts";
    let ordered = starts.hz.map(significant);
    if starts.skipped == 0 {
        let text = ordered.map(|hz| format!("No start was skipped: {hz}\u{202f}Hz were ordered and kept."));
        return text.map(|text| say(about, Grade::Good, text));
    }
    let share = starts.skipped_share();
    let made = starts.made_hz.map(|made| format!(", {} starts a second were made", significant(made)));
    let rates = ordered
        .map_or_else(String::new, |hz| format!(": {hz}\u{202f}Hz were ordered{}", made.unwrap_or_default()));
    let text = format!(
        "{} of {} ({}) {} skipped, because the pipeline was too far behind{rates}.",
        fixed(starts.skipped as f64, 0),
        counted(starts.all(), "start"),
        percent(share),
        if starts.skipped == 1 { "was" } else { "were" }
    );
    let advice = "give the rate of the starts that were made beside the latency, or order less";
    Some(match share {
        share if share > MANY => {
            let text = format!("{text} The latency is that of a system at its limit.");
            advise(say(about, Grade::Bad, text), advice)
        }
        share if share > NOTED => advise(say(about, Grade::Doubtful, text), advice),
        _ => say(about, Grade::Good, text),
    })
}

fn whole(counts: &Counts, missing: &[Missing]) -> Finding {
    let about = "missing events";
    if missing.is_empty() {
        return say(about, Grade::Good, "No event was dropped.");
    }
    let count: u64 = missing.iter().map(|hole| hole.count).sum();
    let unknown = missing.iter().any(|hole| hole.count == 0);
    let mut reasons: Vec<&str> = Vec::new();
    for hole in missing {
        if !reasons.contains(&hole.reason.as_str()) {
            reasons.push(&hole.reason);
        }
    }
    let number = match (count, unknown) {
        (0, _) => "An unknown number of events".to_owned(),
        (1, false) => "1 event".to_owned(),
        (n, false) => format!("{} events", fixed(n as f64, 0)),
        (n, true) => format!("At least {} events", fixed(n as f64, 0)),
    };
    let all = counts.measured() + counts.warm_up + count;
    let share = count as f64 / all.max(1) as f64;
    let shown = if unknown { String::new() } else { format!(" ({})", percent(share)) };
    let text = format!("{number}{shown} never reached the store: {}.", reasons.join("; "));
    let advice = "what is dropped is dropped under load: see that the disk, the spool or the program keeps up, and repeat";
    let grade = if unknown || share >= HOLES { Grade::Bad } else { Grade::Doubtful };
    advise(say(about, grade, text), advice)
}
