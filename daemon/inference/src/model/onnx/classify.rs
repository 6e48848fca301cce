//! Conversion of a classifier's output to its answer.

use serde::Serialize;

use super::card::{Activation, Classification};
use super::outputs::OutputError;

/// Answer, as JSON: `{"label": "dented", "score": 0.98, "top": [{"label": "dented", "score": 0.98}, …]}`.
#[derive(Debug, PartialEq, Serialize)]
struct Answer<'a> {
    label: &'a str,
    score: f32,
    /// The classes with the highest scores, best first.
    top: Vec<RankedLabel<'a>>,
}

#[derive(Debug, PartialEq, Serialize)]
struct RankedLabel<'a> {
    label: &'a str,
    score: f32,
}

/// Computes the score of each label from the model's numbers, and returns the answer. Replaces the numbers by the
/// scores.
///
/// # Errors
/// If a number is infinite or NaN.
pub(super) fn classify(output: &Classification, numbers: &mut [f32]) -> Result<Vec<u8>, OutputError> {
    if let Some(number) = numbers.iter().find(|number| !number.is_finite()) {
        return Err(OutputError::NotFinite { name: output.name.clone(), number: *number });
    }
    activate(output.activation, numbers);
    let ranked = output.labels.iter().zip(numbers.iter());
    let mut top: Vec<_> = ranked.map(|(label, score)| RankedLabel { label, score: *score }).collect();
    // The sort is stable: classes with equal scores stay in the order of the labels.
    top.sort_by(|a, b| b.score.total_cmp(&a.score));
    top.truncate(output.listed_class_count());
    let best = top.first().ok_or(OutputError::NoClasses)?;
    let answer = Answer { label: best.label, score: best.score, top };
    Ok(serde_json::to_vec(&answer)?)
}

/// Replaces the numbers of the model by scores.
fn activate(activation: Activation, numbers: &mut [f32]) {
    match activation {
        Activation::None => {}
        Activation::Sigmoid => {
            for number in numbers {
                *number = 1.0 / (1.0 + (-*number).exp());
            }
        }
        Activation::Softmax => {
            // The largest number is subtracted first, so that no exponential overflows.
            let greatest = numbers.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            for number in numbers.iter_mut() {
                *number = (*number - greatest).exp();
            }
            let sum: f32 = numbers.iter().sum();
            for number in numbers {
                *number /= sum;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn output(activation: Activation, top_k: usize) -> Classification {
        let labels = ["a", "b", "c"].map(str::to_owned).into();
        Classification { name: "logits".to_owned(), activation, top_k: Some(top_k), labels }
    }

    #[test]
    fn best_classes_come_first() {
        let json = classify(&output(Activation::None, 2), &mut [0.25, 0.125, 0.5]).expect("is finite");
        let expected =
            r#"{"label":"c","score":0.5,"top":[{"label":"c","score":0.5},{"label":"a","score":0.25}]}"#;
        assert_eq!(String::from_utf8(json).expect("is text"), expected);
    }

    #[test]
    fn output_with_infinity_or_nan_is_refused() {
        for non_finite in [f32::NAN, f32::INFINITY] {
            assert!(classify(&output(Activation::Softmax, 3), &mut [0.0, non_finite, 1.0]).is_err());
        }
    }

    proptest! {
        #[test]
        fn scores_are_probabilities_and_rise_with_outputs(numbers: [i16; 3]) {
            let numbers = numbers.map(f32::from);
            for activation in [Activation::Softmax, Activation::Sigmoid] {
                let mut scores = numbers;
                activate(activation, &mut scores);
                prop_assert!(scores.iter().all(|score| (0.0..=1.0).contains(score)), "{:?}", scores);
                for (a, b) in [(0, 1), (1, 2), (0, 2)] {
                    prop_assert!(numbers[a] <= numbers[b] || scores[a] >= scores[b]);
                }
            }
            let mut scores = numbers;
            activate(Activation::Softmax, &mut scores);
            prop_assert!((scores.iter().sum::<f32>() - 1.0).abs() < 1e-5);
        }
    }
}
