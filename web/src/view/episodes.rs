//! Texts about the episodes and the failed iterations of a run, shown next to its time series.

use peernet_statistics::number::{self, count};
use peernet_store::{Episodes, RunSummary};

/// Returns `4 episodes of 100 steps began`; `None` for a run with at most one episode. Episodes of the warm-up and the
/// episode in progress, which have no result, are counted, too.
pub(crate) fn episode_count_text(episodes: &Episodes) -> Option<String> {
    let all = format!("{} episodes", count(episodes.count));
    let text = match episodes.steps.filter(|_| episodes.count > 1) {
        Some(steps) => format!("{all} of {}", number::counted(steps, "step")),
        None if episodes.count > 1 => all,
        None => return None,
    };
    // There is one border fewer than episodes, because the first episode begins with the run.
    let too_many = episodes.count > u64::from(Episodes::MAX_BORDERS) + 1;
    Some(format!("{text} began{}", if too_many { ", too many to mark" } else { "" }))
}

/// Returns `3 iterations failed`, `3 iterations failed, 2 iterations of the warm-up failed`, or
/// `995 iterations failed, 300 marked` if not all have a mark. `None` if no iteration failed.
pub(crate) fn failed_count_text(episodes: &Episodes, run: &RunSummary) -> Option<String> {
    let failed = run.counts.all_failed();
    // The counts of a run, which retention does not change, exclude the failed iterations of the warm-up. The failed
    // iterations of the warm-up are counted among the stored iterations, so their number is not known after retention
    // has deleted iterations.
    let has_all_iterations = run.last_deleted_iteration == 0;
    let in_warm_up = episodes.failed_in_warm_up.filter(|_| has_all_iterations).unwrap_or_default();
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
        assert_eq!(text_of(4, Some(100)).as_deref(), Some("4 episodes of 100 steps began"));
        assert_eq!(text_of(31, Some(1)).as_deref(), Some("31 episodes of 1 step began"));
        assert_eq!(
            text_of(1_200, Some(10)).as_deref(),
            Some("1,200 episodes of 10 steps began, too many to mark")
        );
        assert_eq!(text_of(3, None).as_deref(), Some("3 episodes began"));
    }

    #[test]
    fn unmarked_failed_iterations_are_counted() {
        let text_of = |marks, in_warm_up, lost| failed_text(marks, in_warm_up, lost, 0);
        assert_eq!(text_of(0, Some(0), 0), None);
        assert_eq!(text_of(3, Some(0), 3).as_deref(), Some("3 iterations failed"));
        assert_eq!(text_of(2, Some(2), 0).as_deref(), Some("2 iterations of the warm-up failed"));
        let both = "889 iterations failed, 106 iterations of the warm-up failed, 300 marked";
        assert_eq!(text_of(300, Some(106), 889).as_deref(), Some(both));
        assert_eq!(text_of(300, None, 12_345).as_deref(), Some("12,345 iterations failed, 300 marked"));
    }

    #[test]
    fn warm_up_failures_are_unknown_after_retention() {
        // 40 measured iterations and 100 iterations of the warm-up failed. Retention has deleted half of them.
        assert_eq!(failed_text(70, Some(50), 40, 900).as_deref(), Some("40 iterations failed"));
        let few_stored = "5,000 iterations failed, 290 marked";
        assert_eq!(failed_text(290, Some(0), 5_000, 900).as_deref(), Some(few_stored));
    }

    /// Returns the text for a run with `lost` failed iterations after the warm-up. Retention has
    /// deleted all iterations of the run up to `last_deleted_iteration`.
    fn failed_text(
        marks: usize,
        failed_in_warm_up: Option<u64>,
        lost: u64,
        last_deleted_iteration: u64,
    ) -> Option<String> {
        let failed_starts = vec![samples::NOW; marks];
        let episodes = Episodes { failed_starts, failed_in_warm_up, ..Episodes::default() };
        let counts = OutcomeCounts { ok: 9, lost, ..OutcomeCounts::default() };
        let run = RunSummary { counts, last_deleted_iteration, ..run(1, PlacementKind::Remote) };
        failed_count_text(&episodes, &run)
    }
}
