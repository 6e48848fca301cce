//! Whether every answer was judged right or wrong, where some were.

use std::collections::BTreeMap;

use peernet_logger::stream::Grade;

use super::{advise, iterations, percent, say};
use crate::accuracy::Accuracy;
use crate::number::fixed;
use crate::trust::Sentence;

/// A sentence where an accuracy is not that of all iterations; accuracies that lack as many share one.
pub(super) fn sentences(accuracy: &BTreeMap<String, Accuracy>) -> Vec<Sentence> {
    let mut partial: Vec<(Vec<&str>, &Accuracy)> = Vec::new();
    for (name, accuracy) in accuracy.iter().filter(|(_, accuracy)| accuracy.unscored > 0) {
        match partial.iter_mut().find(|(_, other)| other.unscored == accuracy.unscored) {
            Some((names, _)) => names.push(name),
            None => partial.push((vec![name], accuracy)),
        }
    }
    let sentence = |(names, Accuracy { count, unscored, .. }): (Vec<&str>, &Accuracy)| {
        let all = count + unscored;
        let text = format!(
            "{} of {} ({}) have no valid score for {}: the accuracy is that of the others.",
            fixed(*unscored as f64, 0),
            iterations(all),
            percent(*unscored as f64 / all as f64),
            names.join(" and ")
        );
        let advice =
            "see that each sample has a label and each answer names a class, or say so beside the accuracy";
        advise(say("accuracy", Grade::Doubtful, text), advice)
    };
    partial.into_iter().map(sentence).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(unscored: [u64; 2]) -> Vec<String> {
        let of =
            |unscored: u64| Accuracy::of_counts(80, 100 - unscored, unscored).expect("there are answers");
        let both = [("top-1", of(unscored[0])), ("top-5", of(unscored[1]))];
        let sentences = sentences(&both.map(|(name, of)| (name.to_owned(), of)).into());
        sentences.into_iter().map(|sentence| sentence.text).collect()
    }

    #[test]
    fn iterations_without_a_valid_score_are_told_once() {
        assert_eq!(told([0, 0]), Vec::<String>::new());
        let both = "3 of 100 iterations (3.0\u{202f}%) have no valid score for top-1 and top-5: the accuracy is that of the others.";
        assert_eq!(told([3, 3]), [both]);
        let apart = told([0, 12]);
        assert!(
            apart.len() == 1 && apart[0].contains("12 of 100") && apart[0].contains("for top-5:"),
            "{apart:?}"
        );
    }
}
