//! Texts beside the time series of a run.

use peernet_statistics::number::count;
use peernet_store::{Episodes, RunSummary};

use super::counted;

/// Returns `4 episodes of 100 steps`; `None` for a run without episodes.
pub(crate) fn said(known: &Episodes) -> Option<String> {
    let all = format!("{} episodes", count(known.count));
    let whole = match known.steps.filter(|_| known.count > 1) {
        Some(steps) => format!("{all} of {}", counted(steps as usize, "step", "steps")),
        None if known.count > 1 => all,
        None => return None,
    };
    let too_many = known.count > u64::from(Episodes::MAX_BORDERS) + 1;
    Some(if too_many { format!("{whole}, too many to mark") } else { whole })
}

/// Returns `3 without an answer`, and how many have a mark if not all have; `None` if all iterations were answered.
pub(crate) fn unanswered(known: &Episodes, run: &RunSummary) -> Option<String> {
    let marked = known.unanswered.len() as u64;
    let counts = &run.counts;
    // The counts of a run do not include the warm-up, and the stored rows lack the iterations that retention deleted.
    let all = (counts.failed + counts.lost + counts.timeout).max(known.without_answer);
    let shown = if known.without_answer > Episodes::MAX_COUNTED {
        format!("more than {}", count(Episodes::MAX_COUNTED))
    } else {
        count(all)
    };
    let rest = if all > marked { format!(", {} marked", count(marked)) } else { String::new() };
    (all > 0).then(|| format!("{shown} without an answer{rest}"))
}

#[cfg(test)]
mod tests {
    use peernet_stream::{OutcomeCounts, PlacementKind};

    use super::*;
    use crate::tests::samples;
    use crate::view::compare::tests::run;

    #[test]
    fn episodes_are_counted_and_too_many_have_no_marks() {
        let of = |count, steps| said(&Episodes { count, steps, ..Episodes::default() });
        assert_eq!((of(0, None), of(1, None)), (None, None));
        assert_eq!(of(4, Some(100)).as_deref(), Some("4 episodes of 100 steps"));
        assert_eq!(of(31, Some(1)).as_deref(), Some("31 episodes of 1 step"));
        assert_eq!(of(1_200, Some(10)).as_deref(), Some("1,200 episodes of 10 steps, too many to mark"));
        assert_eq!(of(3, None).as_deref(), Some("3 episodes"));
    }

    #[test]
    fn what_had_no_answer_is_counted_with_what_has_no_mark() {
        let of = |marked: usize, without_answer, lost| {
            let marks = vec![samples::NOW; marked];
            let known = Episodes { unanswered: marks, without_answer, ..Episodes::default() };
            let counts = OutcomeCounts { ok: 9, lost, ..OutcomeCounts::default() };
            unanswered(&known, &RunSummary { counts, ..run(1, PlacementKind::Remote) })
        };
        assert_eq!(of(0, 0, 0), None);
        assert_eq!(of(3, 3, 3).as_deref(), Some("3 without an answer"));
        assert_eq!(of(2, 2, 0).as_deref(), Some("2 without an answer"), "in the warm-up");
        assert_eq!(
            of(300, 995, 889).as_deref(),
            Some("995 without an answer, 300 marked"),
            "in the warm-up too"
        );
        assert_eq!(of(290, 290, 5_000).as_deref(), Some("5,000 without an answer, 290 marked"), "deleted");
        let many = "more than 10,000 without an answer, 300 marked";
        assert_eq!(of(300, 10_001, 9_000).as_deref(), Some(many));
    }
}
