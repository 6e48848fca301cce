//! Texts about the episodes and the failed iterations of a run, shown next to its time series.

use peernet_statistics::number::{self, count};
use peernet_store::{Episodes, RunSummary};

/// Returns `4 episodes of 100 steps`; `None` for a run with at most one episode.
pub(crate) fn episode_count_text(episodes: &Episodes) -> Option<String> {
    let all = format!("{} episodes", count(episodes.count));
    let text = match episodes.steps.filter(|_| episodes.count > 1) {
        Some(steps) => format!("{all} of {}", number::counted(steps, "step")),
        None if episodes.count > 1 => all,
        None => return None,
    };
    // One border less than episodes: the first episode begins with the run.
    let too_many = episodes.count > u64::from(Episodes::MAX_BORDERS) + 1;
    Some(if too_many { format!("{text}, too many to mark") } else { text })
}

/// Returns `3 iterations failed`, `3 iterations failed, 2 iterations of the warm-up failed`, or
/// `995 iterations failed, 300 marked` if not all have a mark. `None` if no iteration failed.
pub(crate) fn failed_count_text(episodes: &Episodes, run: &RunSummary) -> Option<String> {
    // The counts of a run exclude the warm-up. The stored rows include the warm-up, but not the iterations that
    // retention deleted. Above the limit of counted rows, the number of failed iterations of the warm-up is not known.
    let failed = run.counts.all_failed();
    let in_warm_up = match episodes.failed_count {
        stored if stored > Episodes::MAX_COUNTED => 0,
        stored => stored.saturating_sub(failed),
    };
    let marked = episodes.failed_starts.len() as u64;
    let texts = [
        (failed > 0).then(|| format!("{} failed", number::counted(failed, "iteration"))),
        (in_warm_up > 0)
            .then(|| format!("{} of the warm-up failed", number::counted(in_warm_up, "iteration"))),
        (failed + in_warm_up > marked).then(|| format!("{} marked", count(marked))),
    ];
    let texts: Vec<String> = texts.into_iter().flatten().collect();
    (!texts.is_empty()).then(|| texts.join(", "))
}

#[cfg(test)]
mod tests {
    use peernet_stream::{OutcomeCounts, PlacementKind};

    use super::*;
    use crate::tests::samples;
    use crate::view::compare::tests::run;

    #[test]
    fn episodes_are_counted_and_too_many_have_no_marks() {
        let text_of = |count, steps| episode_count_text(&Episodes { count, steps, ..Episodes::default() });
        assert_eq!((text_of(0, None), text_of(1, None)), (None, None));
        assert_eq!(text_of(4, Some(100)).as_deref(), Some("4 episodes of 100 steps"));
        assert_eq!(text_of(31, Some(1)).as_deref(), Some("31 episodes of 1 step"));
        assert_eq!(text_of(1_200, Some(10)).as_deref(), Some("1,200 episodes of 10 steps, too many to mark"));
        assert_eq!(text_of(3, None).as_deref(), Some("3 episodes"));
    }

    #[test]
    fn unmarked_failed_iterations_are_counted() {
        let text_of = |marked: usize, failed_count, lost| {
            let marks = vec![samples::NOW; marked];
            let episodes = Episodes { failed_starts: marks, failed_count, ..Episodes::default() };
            let counts = OutcomeCounts { ok: 9, lost, ..OutcomeCounts::default() };
            failed_count_text(&episodes, &RunSummary { counts, ..run(1, PlacementKind::Remote) })
        };
        assert_eq!(text_of(0, 0, 0), None);
        assert_eq!(text_of(3, 3, 3).as_deref(), Some("3 iterations failed"));
        assert_eq!(text_of(2, 2, 0).as_deref(), Some("2 iterations of the warm-up failed"));
        let both = "889 iterations failed, 106 iterations of the warm-up failed, 300 marked";
        assert_eq!(text_of(300, 995, 889).as_deref(), Some(both));
        assert_eq!(
            text_of(290, 290, 5_000).as_deref(),
            Some("5,000 iterations failed, 290 marked"),
            "retention deleted the rows of the other failed iterations"
        );
        assert_eq!(text_of(300, 10_001, 12_345).as_deref(), Some("12,345 iterations failed, 300 marked"));
    }
}
