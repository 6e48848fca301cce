//! How long answers are: which quantity is their length, and whether it varies.

/// How long answers take.
pub const LATENCY: &str = "inference";
/// How long answers are, where no tokens are counted.
const ANSWER: &str = "download-bytes";
/// With this end the names of those that a run counts itself.
const TOKENS: &str = "tokens";
/// Names with one of these words count what was asked.
const ASKED: [&str; 2] = ["prompt", "input"];
/// The longest answer is at least so much longer than the shortest, or its length is not what matters.
const VARIED: f64 = 1.5;

/// Which of these names is the length of an answer: of those that count tokens the first by name, those of the answer
/// before those of the question; `download-bytes` where nobody counted.
pub fn answer_length<'a>(names: impl Iterator<Item = &'a str>) -> &'a str {
    let is_asked = |name: &str| ASKED.iter().any(|word| name.contains(word));
    names.filter(|name| is_tokens(name)).min_by_key(|name| (is_asked(name), *name)).unwrap_or(ANSWER)
}

/// Whether a length is counted in tokens, else in bytes.
pub fn is_tokens(name: &str) -> bool {
    name.ends_with(TOKENS)
}

/// Whether answers differ enough in length to be drawn against it.
pub fn varies(shortest: f64, longest: f64) -> bool {
    longest > shortest && longest >= VARIED * shortest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn length_is_counted_in_tokens_of_answer_where_there_are_some() {
        let names = ["a-prompt-tokens", "zeta-tokens", "total", "completion-tokens", "input-tokens"];
        assert_eq!(answer_length(names.into_iter()), "completion-tokens");
        assert_eq!(answer_length(["total", "tokens-per-second"].into_iter()), "download-bytes");
    }
}
