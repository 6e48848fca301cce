//! Notes on things that need attention, in sentences.

use peernet_analysis::delays::ClockInterval;
use peernet_analysis::trust::ReplayedLatencies;
use peernet_clock::Verdict;
use peernet_logger::Name;
use peernet_statistics::number::{self, duration, interval_ms};
use peernet_store::{DelayAccuracy, QuantityStatistics};

use super::chip::{Chip, Tone};
use super::clocks;

/// Chip of latencies that are drawn from a distribution.
pub(crate) const REPLAYED: Chip = Chip::new(Tone::Warn, "remark", "replayed");

/// A note.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Note {
    pub chip: Chip,
    /// Subject of the sentence, shown before the text as a hyperlink to `href`. Before a whole sentence it ends with a
    /// colon.
    pub subject: String,
    /// Address of the page of the subject; empty on that page itself.
    pub href: String,
    /// Rest of the sentence, or a whole sentence.
    pub text: String,
    /// Address of the page of the link (an edge and a cloud) whose clocks the sentence is about.
    pub link: Option<String>,
}

/// Returns notes on one-way delays whose verdicts are not `ok`: for each a chip and a sentence without its subject.
pub(crate) fn delay_notes(
    bounds: &[DelayAccuracy],
    delay_of: impl Fn(&Name) -> Option<QuantityStatistics>,
) -> Vec<(Chip, String)> {
    let not_ok: Vec<(&DelayAccuracy, Verdict)> = bounds
        .iter()
        .filter_map(|bound| Some((bound, clocks::verdict(bound)?)))
        .filter(|(_, verdict)| *verdict != Verdict::Ok)
        .collect();
    // If both directions have the same verdict, one sentence is enough, unless the verdict is `limited`: the sentences
    // about `limited` delays have different numbers.
    if let [(_, verdict), (_, other)] = not_ok.as_slice()
        && verdict == other
        && *verdict != Verdict::Limited
    {
        return vec![(
            Chip::verdict(*verdict),
            format!("has no one-way delays to trust: {}.", clocks::meaning(*verdict)),
        )];
    }
    let sentences = not_ok.into_iter().map(|(bound, verdict)| {
        let name = &bound.stage;
        let interval = |delay: QuantityStatistics| Some((delay, bound.interval_of_median(&delay)?));
        let text = match (verdict, delay_of(name).and_then(interval), bound.half_width) {
            (Verdict::Limited, Some((delay, ClockInterval { lo, hi, method })), Some(width)) => {
                let remark = method.remark().map(|remark| format!(" ({remark})"));
                format!(
                    "has a {name} of {} with a clock bound of {}: read it as {}\u{202f}ms{}.",
                    duration(delay.p50),
                    number::bound(width.p50),
                    interval_ms(lo, hi),
                    remark.unwrap_or_default()
                )
            }
            _ => format!("has a {name} that cannot be trusted: {}.", clocks::meaning(verdict)),
        };
        (Chip::verdict(verdict), text)
    });
    sentences.collect()
}

impl Note {
    /// Returns the note on a run whose latencies are drawn from a distribution.
    pub(crate) fn replayed(latencies: &ReplayedLatencies) -> Self {
        Self {
            chip: REPLAYED,
            subject: "The latencies of the model".to_owned(),
            href: String::new(),
            text: format!("are replayed, not measured: {}.", latencies.describe()),
            link: None,
        }
    }

    /// Returns notes on one-way delays whose verdicts are not `ok`, with the subject of their sentences.
    pub(crate) fn delay_notes(
        subject: &str,
        href: &str,
        link: Option<&str>,
        bounds: &[DelayAccuracy],
        delay_of: impl Fn(&Name) -> Option<QuantityStatistics>,
    ) -> Vec<Self> {
        let notes = delay_notes(bounds, delay_of).into_iter().map(|(chip, text)| Self {
            chip,
            subject: subject.to_owned(),
            href: href.to_owned(),
            text,
            link: link.map(str::to_owned),
        });
        notes.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn replayed_run_has_a_note() {
        let facts = [("Replayed".to_owned(), "inference is drawn from x".to_owned())];
        let note = Note::replayed(&ReplayedLatencies::from_facts(&facts).expect("is replayed"));
        assert_eq!((note.chip, note.subject.as_str()), (REPLAYED, "The latencies of the model"));
        assert_eq!(note.text, "are replayed, not measured: inference is drawn from x.");
    }
}
