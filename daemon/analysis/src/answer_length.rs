//! Length of answers: the quantity that measures the length, whether the length varies, and how latency grows with the length.

use peernet_logger::stage;
use peernet_statistics::number::{Estimate, SPACE, count, duration};

use crate::fit::{Fit, MAX_RELATIVE_WIDTH, Point, theil_sen};

/// Column of the time that the model takes for an answer, seconds.
pub const LATENCY: &str = "inference";
/// Column of the size of an answer in bytes: its length if no tokens are counted.
const ANSWER_BYTES: &str = "download-bytes";
/// Advice if a language model's server does not report the numbers of tokens, which are its `usage`.
pub const NO_USAGE: &str = "the server sent no `usage`; use --x output-chunks";
/// Suffix of the names of quantities that count tokens.
const TOKENS_SUFFIX: &str = "tokens";
/// Suffix of the names of quantities that count bytes.
const BYTES_SUFFIX: &str = "bytes";
/// Words in the names of quantities that count the tokens of the question.
const QUESTION_WORDS: [&str; 2] = ["prompt", "input"];
/// Minimum ratio of the longest to the shortest answer. Below this ratio the lengths differ too little to explain the
/// latency.
const MIN_LENGTH_RATIO: f64 = 1.5;

/// Returns the name of the quantity that is the length of an answer: a quantity that counts tokens of the answer, or else
/// one that counts tokens of the question. If there are several, the first in alphabetical order is returned. If no
/// quantity counts tokens, `download-bytes` is returned. `names` are the names of columns or of nodes.
pub fn answer_length<'a>(names: impl Iterator<Item = &'a str>) -> &'a str {
    // The order is that of the nodes, not that of the columns: a column's name begins with the
    // names of the node's parents, which the store does not have. Files and store thus give the
    // same length for a run.
    let tokens = names.filter_map(|name| Some((tokens_of_column(name)?, name)));
    let first = tokens.min_by_key(|(node, name)| (counts_question_tokens(node), *node, *name));
    first.map_or(ANSWER_BYTES, |(_, name)| name)
}

/// Returns whether a node that counts tokens counts those of the question.
fn counts_question_tokens(node: &str) -> bool {
    QUESTION_WORDS.iter().any(|word| node.contains(word))
}

/// Returns the name of the quantity that counts the tokens of an answer; `None` if no tokens of answers are counted.
pub fn answer_tokens<'a>(names: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let counts_answer_tokens =
        |name: &&str| tokens_of_column(name).is_some_and(|node| !counts_question_tokens(node));
    Some(answer_length(names)).filter(counts_answer_tokens)
}

/// Returns whether these quantities are those of a language model whose server reports no numbers of tokens: chunks of
/// answers are counted, and tokens of answers are not. In this case, [`NO_USAGE`] is shown.
pub fn lacks_usage<'a>(names: impl Iterator<Item = &'a str> + Clone) -> bool {
    let counts_chunks = |name: &str| stage::OUTPUT_CHUNKS == *node_of_column(name);
    names.clone().any(counts_chunks) && answer_tokens(names).is_none()
}

/// Returns whether a length is counted in tokens; otherwise it is in bytes.
pub fn is_tokens(name: &str) -> bool {
    name.ends_with(TOKENS_SUFFIX)
}

/// Returns the name of the node of a column that counts tokens: `output-tokens` for `inference_output-tokens`. `None`
/// for columns that do not count tokens.
pub fn tokens_of_column(column: &str) -> Option<&str> {
    is_tokens(column).then(|| node_of_column(column))
}

/// Returns the name of a column without the names of its node's parents.
fn node_of_column(column: &str) -> &str {
    column.rsplit_once('_').map_or(column, |(_, node)| node)
}

/// Returns whether the lengths of the answers differ enough for a figure of latency against length.
pub fn varies(shortest: f64, longest: f64) -> bool {
    longest > shortest && longest >= MIN_LENGTH_RATIO * shortest
}

/// Returns the unit in which a slope is given, and the measured length that corresponds to one unit, such as 1,000
/// (bytes) for "kB".
fn slope_unit(length_name: &str) -> (String, f64) {
    if is_tokens(length_name) {
        ("token".to_owned(), 1.0)
    } else if length_name.ends_with(BYTES_SUFFIX) {
        ("kB".to_owned(), 1e3)
    } else {
        (format!("unit of {}", length_name.replace(['-', '_'], " ")), 1.0)
    }
}

/// Minimum number of iterations for a line of latency over length.
const MIN_ITERATIONS: usize = 60;
/// Maximum number of iterations that a line is computed from. It limits the time: [`theil_sen`]
/// sorts the points again for each step of several bisections.
const MAX_ITERATIONS: usize = 1_000;

/// Reason why no line of latency over length is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoLine {
    /// There are fewer answers than a line needs.
    #[error("a line needs {} answers, and there are {}", count(MIN_ITERATIONS as u64), count(*.0 as u64))]
    TooFewAnswers(usize),
    /// Almost all answers have the same length.
    #[error("almost all of the {} answers have the same length", count(*.0 as u64))]
    EqualLengths(usize),
    /// The interval of the slope contains zero.
    #[error("the 95\u{202f}% interval of the slope over {} answers contains zero", count(*.0 as u64))]
    InsignificantSlope(usize),
}

/// Growth of latency with the length of answers: a line through single iterations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Growth {
    /// Line of the latency in seconds over the length.
    pub fit: Fit,
    /// 95 % confidence interval of the slope.
    pub interval: (f64, f64),
}

impl Growth {
    /// Returns the line whose slope is the median of the slopes of all pairs of iterations, given as length and latency. This slope is
    /// robust against long tails of the latencies and any distribution of the lengths. Of more than 1,000 iterations, only every
    /// n-th is used, so that at most 1,000 remain.
    ///
    /// # Errors
    /// If there are too few iterations, or too few different lengths.
    pub fn from_iterations(iterations: &[(f64, f64)]) -> Result<Self, NoLine> {
        if iterations.len() < MIN_ITERATIONS {
            return Err(NoLine::TooFewAnswers(iterations.len()));
        }
        let step = iterations.len().div_ceil(MAX_ITERATIONS);
        let points: Vec<Point> =
            iterations.iter().step_by(step).map(|(x, y)| Point { x: *x, y: *y }).collect();
        theil_sen(&points)
            .and_then(|fit| Some(Self { interval: fit.slope.interval?, fit }))
            .ok_or(NoLine::EqualLengths(iterations.len()))
    }

    /// Returns whether the interval of the slope excludes zero.
    pub fn is_significant(&self) -> bool {
        self.interval.0 > 0.0 || self.interval.1 < 0.0
    }

    /// Returns whether the interval is too wide for the slope to be reported as one number.
    pub fn is_imprecise(&self) -> bool {
        self.interval.1 - self.interval.0 > MAX_RELATIVE_WIDTH * self.fit.slope.value.abs()
    }

    /// Describes the slope and its interval in a sentence. `length_name` is the name of the quantity that is the
    /// length.
    pub fn describe_slope(&self, length_name: &str) -> String {
        let Self { fit, interval } = self;
        let (unit, unit_length) = slope_unit(length_name);
        let (value, lo, hi) =
            (fit.slope.value * unit_length, interval.0 * unit_length, interval.1 * unit_length);
        // `near` and `far` are the distances of the interval's ends from zero.
        let (magnitude, near, far) = (value.abs(), lo.abs().min(hi.abs()), lo.abs().max(hi.abs()));
        let more = if value > 0.0 { "more" } else { "less" };
        let statement = if self.is_significant() {
            let slope = Estimate::new(magnitude, (near, far));
            let interval = slope.interval();
            if self.is_imprecise() {
                format!("Each further {unit} takes {interval}{SPACE}ms {more} (95{SPACE}%)")
            } else {
                let value = slope.value();
                format!("Each further {unit} takes {value}{SPACE}ms {more} (95{SPACE}%: {interval})")
            }
        } else {
            let interval = Estimate::new(value, (lo, hi)).interval();
            format!(
                "Whether longer answers take longer cannot be told: {interval}{SPACE}ms more per {unit} (95{SPACE}%)"
            )
        };
        format!("{statement}, by Theil–Sen through {} iterations.", count(fit.points as u64))
    }

    /// Describes the latency of the line at length 0 in a sentence. `None` if this latency is below 0, or if the line is not
    /// [drawn](Self::line).
    pub fn describe_intercept(&self) -> Option<String> {
        let (intercept, _) = self.line().ok().filter(|(intercept, _)| *intercept >= 0.0)?;
        let intercept = duration(intercept);
        Some(format!(
            "The line begins at {intercept}: the part of the latency that does not grow with the length, such as the time until the first token."
        ))
    }

    /// Returns the intercept in seconds and the slope in seconds per unit of length.
    ///
    /// # Errors
    /// If the slope is not significant.
    pub fn line(&self) -> Result<(f64, f64), NoLine> {
        let line = (self.fit.intercept.value, self.fit.slope.value);
        self.is_significant().then_some(line).ok_or(NoLine::InsignificantSlope(self.fit.points))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_is_significant_if_latency_follows_length() {
        let iterations = |slope: f64| -> Vec<(f64, f64)> {
            (0..200).map(|n| (f64::from(n), 5.0 + slope * f64::from(n) + f64::from(n * 37 % 11))).collect()
        };
        let growing = Growth::from_iterations(&iterations(0.5)).expect("200 lengths");
        assert!(
            growing.is_significant()
                && !growing.is_imprecise()
                && (growing.fit.slope.value - 0.5).abs() < 0.02
        );
        let slope = growing.describe_slope("output-tokens");
        assert!(
            slope.starts_with("Each further token takes ") && slope.ends_with("200 iterations."),
            "{slope}"
        );
        let intercept = growing.describe_intercept().expect("an intercept above 0");
        assert!(intercept.starts_with("The line begins at "), "{intercept}");
        let line = |iterations: &[(f64, f64)]| Growth::from_iterations(iterations)?.line();
        assert_eq!(line(&iterations(0.0)), Err(NoLine::InsignificantSlope(200)));
        assert_eq!(line(&iterations(0.5)[..59]), Err(NoLine::TooFewAnswers(59)));
        let one_length: Vec<(f64, f64)> = iterations(0.5).iter().map(|(_, y)| (7.0, *y)).collect();
        assert_eq!(line(&one_length), Err(NoLine::EqualLengths(200)));
        let text = NoLine::TooFewAnswers(59).to_string();
        assert_eq!(text, "a line needs 60 answers, and there are 59");
    }

    #[test]
    fn slope_is_insignificant_if_most_latencies_are_equal() {
        // One answer took longer or shorter than all others, so nearly all slopes are 0.
        let iterations = |last: f64| -> Vec<(f64, f64)> {
            (1..=60).map(|n| (f64::from(n), if n == 60 { last } else { 0.1 })).collect()
        };
        for last in [0.2, 0.05] {
            let growth = Growth::from_iterations(&iterations(last)).expect("60 lengths");
            assert_eq!((growth.fit.slope.value, growth.interval), (0.0, (0.0, 0.0)));
            assert_eq!(growth.line(), Err(NoLine::InsignificantSlope(60)));
        }
    }

    #[test]
    fn slope_unit_follows_from_name_of_length() {
        assert_eq!(slope_unit("inference_output-tokens"), ("token".to_owned(), 1.0));
        assert_eq!(slope_unit("download-bytes"), ("kB".to_owned(), 1e3));
        assert_eq!(slope_unit("inference_output-chunks").0, "unit of inference output chunks");
    }

    #[test]
    fn usage_is_lacking_if_only_chunks_are_counted() {
        let lacks = |names: &[&'static str]| lacks_usage(names.iter().copied());
        assert!(lacks(&["total", "output-chunks"]) && lacks(&["inference_output-chunks", "download-bytes"]));
        assert!(!lacks(&["inference_output-chunks", "inference_output-tokens"]));
        assert!(!lacks(&["total", "download-bytes"]), "the model is not a language model");
    }

    #[test]
    fn length_is_answer_tokens_if_counted() {
        let names = ["a-prompt-tokens", "zeta-tokens", "total", "completion-tokens", "input-tokens"];
        assert_eq!(answer_length(names.into_iter()), "completion-tokens");
        assert_eq!(answer_length(["total", "tokens-per-second"].into_iter()), "download-bytes");
        assert_eq!(answer_tokens(["total", "completion-tokens"].into_iter()), Some("completion-tokens"));
        assert_eq!(
            [answer_tokens(["prompt-tokens"].into_iter()), answer_tokens(["total"].into_iter())],
            [None; 2]
        );
    }

    #[test]
    fn length_is_chosen_by_name_of_node() {
        for (columns, nodes) in [
            (["a_prompt-tokens", "input-crop_output-tokens"], ["prompt-tokens", "output-tokens"]),
            (["a_zeta-tokens", "b_alpha-tokens"], ["zeta-tokens", "alpha-tokens"]),
        ] {
            let [of_columns, of_nodes] = [columns, nodes].map(|names| answer_tokens(names.into_iter()));
            assert_eq!([of_columns, of_nodes], [Some(columns[1]), Some(nodes[1])]);
        }
    }
}
