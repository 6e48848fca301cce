//! Whether everything is there.

use peernet_logger::stream::Grade;

use super::{advise, iterations, percent, say};
use crate::number::fixed;
use crate::trust::{Counts, Evidence, Missing, Sentence};

/// Samples below which no 95th percentile is given anywhere in PEERNet.
const FEW: u64 = 60;
/// Shares of iterations without an answer that are mentioned, and that make the latency of the others a half truth.
const NOTED: f64 = 0.001;
const MANY: f64 = 0.1;
/// Share of missing events from which on nobody can tell what the missing ones were like.
const HOLES: f64 = 0.05;

pub(super) fn sentences(evidence: &Evidence) -> Vec<Sentence> {
    let Evidence { counts, missing, .. } = evidence;
    let mut all = vec![enough(counts)];
    if counts.measured() > 0 {
        all.push(answered(counts));
    }
    all.push(whole(counts, missing));
    if let Some(reason) = &evidence.broken {
        let sentence = say("end", Grade::Doubtful, format!("The run broke off: {reason}."));
        all.push(advise(sentence, "repeat it, or say so beside the figures"));
    }
    if evidence.rehearsed {
        let text = "The clock of a host was made wrong on purpose (rehearsal).";
        all.push(advise(say("rehearsal", Grade::Bad, text), "take `[rehearsal]` out of the configuration"));
    }
    all
}

fn enough(counts: &Counts) -> Sentence {
    let about = "amount";
    let warm_up = match counts.warm_up {
        0 => "no warm-up was left out".to_owned(),
        n => format!("{} of warm-up are left out", iterations(n)),
    };
    match counts.ok {
        0 => {
            let sentence = say(about, Grade::Bad, format!("No iteration was answered; {warm_up}."));
            advise(sentence, "look at why: the run's page lists the reasons, `data.csv` has them as `reason`")
        }
        few @ ..FEW => {
            let text =
                format!("Only {} were answered: too few for a 95th percentile; {warm_up}.", iterations(few));
            advise(
                say(about, Grade::Doubtful, text),
                format!("measure at least {FEW} iterations, better 1,000"),
            )
        }
        ok => say(about, Grade::Good, format!("{} were answered; {warm_up}.", iterations(ok))),
    }
}

fn answered(counts: &Counts) -> Sentence {
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

fn whole(counts: &Counts, missing: &[Missing]) -> Sentence {
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
