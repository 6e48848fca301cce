//! Judgement of the scores. The findings report iterations whose answers were not scored as right or wrong.

use peernet_statistics::number;
use peernet_stream::Grade;

use super::{finding, iterations, percent, with_advice};
use crate::accuracy::{Accuracy, UnknownLabels};
use crate::trust::{Finding, TrustInput};

/// Returns a finding for each accuracy that does not cover all iterations. Accuracies in which the same number of
/// iterations is missing share one finding. A separate finding reports unknown labels.
pub(super) fn findings(input: &TrustInput) -> Vec<Finding> {
    // Iterations with an unknown label have their own finding.
    let unscored =
        |accuracy: &Accuracy| UnknownLabels::other_unscored(input.unknown_labels.as_ref(), accuracy.unscored);
    // Names of accuracies, number of iterations without a score, number of all iterations.
    let mut incomplete: Vec<(Vec<&str>, u64, u64)> = Vec::new();
    for (name, accuracy) in input.accuracy.iter().filter(|(_, accuracy)| unscored(accuracy) > 0) {
        match incomplete.iter_mut().find(|(_, other, _)| *other == unscored(accuracy)) {
            Some((names, ..)) => names.push(name),
            None => incomplete.push((vec![name], unscored(accuracy), accuracy.count + accuracy.unscored)),
        }
    }
    let incomplete_finding = |(names, unscored, total): (Vec<&str>, u64, u64)| {
        let text = format!(
            "{} of {} ({}) have no valid score for {}: the accuracy covers only the other iterations.",
            number::count(unscored),
            iterations(total),
            percent(unscored as f64 / total as f64),
            names.join(" and ")
        );
        let advice = "check that each sample has a label and each answer names a class, or report this with the accuracy";
        with_advice(finding("accuracy", Grade::Doubtful, text), advice)
    };
    judge_unknown_labels(input).into_iter().chain(incomplete.into_iter().map(incomplete_finding)).collect()
}

/// Returns the finding about iterations that cannot be scored because of their label. If no iteration was scored, the
/// grade is `Unknown` and not `Doubtful`: there is no accuracy to publish, and the other results are not affected.
fn judge_unknown_labels(input: &TrustInput) -> Option<Finding> {
    let unknown = input.unknown_labels.as_ref()?;
    let grade = if input.accuracy.is_empty() { Grade::Unknown } else { Grade::Doubtful };
    let advice = "give the folders, or the labels in the file of labels, the names that the classes have in the model's card; \
                  numbers of classes are not translated to names";
    Some(with_advice(finding("accuracy", grade, unknown.sentence(input.counts.ok)), advice))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outcomes::Counts;

    fn grades_and_texts(unscored: [u64; 2], with_unknown_label: u64) -> Vec<(Grade, String)> {
        let accuracy =
            |unscored: u64| Accuracy::from_counts(80, 100 - unscored, unscored).expect("there are answers");
        let both = [("top-1", accuracy(unscored[0])), ("top-5", accuracy(unscored[1]))];
        let input = TrustInput {
            counts: Counts { ok: 100, ..Counts::default() },
            accuracy: both.map(|(name, accuracy)| (name.to_owned(), accuracy)).into(),
            unknown_labels: UnknownLabels::new(with_unknown_label, &[]),
            ..TrustInput::default()
        };
        findings(&input).into_iter().map(|finding| (finding.grade, finding.text)).collect()
    }

    fn texts(unscored: [u64; 2]) -> Vec<String> {
        grades_and_texts(unscored, 0).into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn unknown_labels_have_separate_finding() {
        let text =
            "Not scored: 3 of 100 iterations, because the label is not a class of the model.".to_owned();
        assert_eq!(grades_and_texts([3, 3], 3), [(Grade::Doubtful, text.clone())]);
        let both = grades_and_texts([5, 5], 3);
        assert!(both.len() == 2 && both[0].1 == text && both[1].1.starts_with("2 of 100"), "{both:?}");
        let none = TrustInput { unknown_labels: UnknownLabels::new(7, &[]), ..TrustInput::default() };
        let findings = findings(&none);
        assert_eq!((findings.len(), findings[0].grade), (1, Grade::Unknown), "no accuracy can be published");
    }

    #[test]
    fn unscored_iterations_are_reported_once() {
        assert_eq!(texts([0, 0]), Vec::<String>::new());
        let both = "3 of 100 iterations (3.0\u{202f}%) have no valid score for top-1 and top-5: the accuracy covers only the other iterations.";
        assert_eq!(texts([3, 3]), [both]);
        let apart = texts([0, 12]);
        assert!(
            apart.len() == 1 && apart[0].contains("12 of 100") && apart[0].contains("for top-5:"),
            "{apart:?}"
        );
    }
}
