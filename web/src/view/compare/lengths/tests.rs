use std::sync::Arc;

use peernet_analysis::answer_length::NoLine;
use peernet_logger::{Name, stage};
use peernet_statistics::SplitMix64;
use peernet_store::{MergeableStatistics, QuantityStatistics};
use peernet_stream::PlacementKind::Remote;

use super::super::tests::{comparison, configuration};
use super::*;

/// Returns a configuration whose answers have the lengths and the latencies in seconds of `points`. `name` is the node
/// with the lengths.
pub(crate) fn answers_of_lengths(at: usize, name: &str, points: &[(f64, f64)]) -> Configuration {
    let mut one = configuration(at, Remote, 1.0, 1e3);
    let (mut x, mut y) = (Summary::default(), Summary::default());
    points.iter().for_each(|(length, seconds)| {
        x.record(*length);
        y.record(*seconds);
    });
    let mut length = one.stages[0].clone();
    (length.stage, length.unit) = (Name::from(name), String::new());
    length.statistics = QuantityStatistics::from_summary(&x).expect("lengths");
    one.stages.push(length);
    let mut mergeable = MergeableStatistics::default();
    mergeable.add(Name::from(name), "", &x);
    mergeable.add(stage::INFERENCE, "s", &y);
    one.mergeable = Arc::new(mergeable);
    one.runs[0].counts.ok = points.len() as u64;
    one
}

/// Returns answers of 20 to 320 tokens. An answer takes 30 ms plus 10 ms per token. One in fifty takes 1.5 s longer.
pub(crate) fn sample_answers(count: usize) -> Vec<(f64, f64)> {
    let point = |n: usize| {
        let tokens = 20.0 + (n * 11 % 301) as f64;
        let delay_or_noise = if n % 50 == 3 { 1.5 } else { 0.002 * (n as f64 * 1.7).sin() };
        (tokens, 0.030 + 0.010 * tokens + delay_or_noise)
    };
    (0..count).map(point).collect()
}

/// Returns at most 500 answers of each configuration, from the quantiles of its lengths and latencies, as if the
/// iterations were stored.
pub(crate) fn answers_from_quantiles(comparison: &Comparison) -> Vec<Answers> {
    let varying = VaryingLengths::all(comparison).into_iter().take(MAX_CONFIGURATIONS);
    let answers_of = |varying_lengths: VaryingLengths<'_>| {
        let count = varying_lengths.lengths.count().min(500);
        let at = |n: u64| (n as f64 + 0.5) / count as f64;
        let point = |n: u64| {
            Some((varying_lengths.lengths.quantile(at(n))?, varying_lengths.latencies.quantile(at(n))?))
        };
        Answers {
            name: varying_lengths.configuration.name.clone(),
            points: (0..count).filter_map(point).collect(),
            is_whole: count == varying_lengths.lengths.count(),
        }
    };
    varying.map(answers_of).collect()
}

/// Returns the answers of the first configuration, which is named `A`. `is_whole` says whether they are all that are
/// stored.
fn answers_of_first(points: Vec<(f64, f64)>, is_whole: bool) -> Vec<Answers> {
    vec![Answers { name: "A".to_owned(), points, is_whole }]
}

#[test]
fn cost_of_a_token_has_an_interval() {
    let points = sample_answers(800);
    let one = comparison(vec![answers_of_lengths(0, "completion-tokens", &points)]);
    let found = lengths(&one, &answers_of_first(points, true)).expect("answers of all lengths");
    let sentences = &found.rows[0].sentences;
    assert_eq!(sentences[0], "Median 1.73\u{202f}s; answers of 20 to 320 tokens, median 169 tokens.");
    assert!(
        sentences[1].starts_with("Each further token takes ")
            && sentences[1].contains("\u{202f}ms more (95\u{202f}%: "),
        "{sentences:?}"
    );
    assert!(sentences[1].ends_with(", by Theil–Sen through 800 iterations."), "{sentences:?}");
    assert_eq!(sentences[2], "All 800 iterations.");
    assert_eq!(sentences.len(), 3, "no value lies beyond the axes: {sentences:?}");
    let html = found.rows[0].plot.to_string();
    assert!(
        html.contains("aria-label=\"A: inference against the length of the answer. Median 1.73"),
        "{html}"
    );
    assert!(html.contains("Each further token takes") && html.contains(">completion tokens<"), "{html}");
}

#[test]
fn sentence_has_numbers_of_drawn_and_all_iterations() {
    let points = sample_answers(800);
    let mut one = answers_of_lengths(0, "tokens", &points);
    // `is_whole` is `true` if `points` are all iterations that are still stored.
    let iterations_sentence = |configuration: &Configuration, points: &[(f64, f64)], is_whole| {
        let found =
            lengths(&comparison(vec![configuration.clone()]), &answers_of_first(points.to_vec(), is_whole));
        found.expect("lengths").rows[0]
            .sentences
            .iter()
            .find(|text| text.contains(" iteration") && !text.contains("Theil"))
            .cloned()
    };
    let some_text = |text: &str| Some(text.to_owned());
    assert_eq!(
        iterations_sentence(&one, &points[..200], false),
        some_text("200 of 800 iterations, evenly spread; histograms of all.")
    );
    one.runs[0].last_deleted_iteration = 300;
    assert_eq!(
        iterations_sentence(&one, &points[..200], false),
        some_text("200 of 800 iterations, evenly spread over what is still stored; histograms of all.")
    );
    assert_eq!(
        iterations_sentence(&one, &points[300..], true),
        some_text("500 iterations, all that are still stored; histograms of all 800.")
    );
    assert_eq!(
        iterations_sentence(&one, &[], true),
        some_text("No iteration is stored any more; histograms of all 800.")
    );
}

/// Returns the sentence about the slope for answers with these lengths in bytes and latencies in
/// seconds.
fn slope_sentence(points: &[(f64, f64)]) -> Result<String, NoLine> {
    Growth::from_iterations(points).map(|growth| growth.describe_slope("download-bytes"))
}

#[test]
fn too_few_or_flat_points_give_no_line() {
    assert_eq!(slope_sentence(&sample_answers(59)), Err(NoLine::TooFewAnswers(59)));
    // One answer has the length 1, all others have the length 0.
    let nearly_equal_lengths: Vec<(f64, f64)> =
        sample_answers(60).iter().map(|(x, y)| (f64::from(*x > 30.0 && *x < 32.0), *y)).collect();
    assert_eq!(
        slope_sentence(&nearly_equal_lengths),
        Err(NoLine::EqualLengths(60)),
        "one answer of another length gives no line"
    );
    let flat: Vec<(f64, f64)> =
        (0..400).map(|n| (f64::from(n % 97), 0.1 + 0.01 * (f64::from(n) * 1.7).sin())).collect();
    let text = slope_sentence(&flat).expect("enough");
    assert!(text.starts_with("Whether longer answers take longer cannot be told: \u{2212}"), "{text}");
    assert_eq!(
        Growth::from_iterations(&flat).and_then(|growth| growth.line()),
        Err(NoLine::InsignificantSlope(400))
    );
}

#[test]
fn latency_that_falls_with_length_is_described_as_less() {
    let falling: Vec<(f64, f64)> = sample_answers(400).iter().map(|(x, y)| (320.0 - x, *y)).collect();
    let text = slope_sentence(&falling).expect("enough");
    assert!(text.starts_with("Each further kB takes ") && text.contains("\u{202f}ms less (95"), "{text}");
}

#[test]
fn missing_line_is_explained_with_numbers() {
    let points = sample_answers(37);
    let one = comparison(vec![answers_of_lengths(0, "tokens", &points)]);
    let found = lengths(&one, &answers_of_first(points, true)).expect("lengths");
    let sentences = &found.rows[0].sentences;
    assert_eq!(sentences[1], "No line: a line needs 60 answers, and there are 37.");
    assert_eq!(sentences[2], "All 37 iterations.");
}

#[test]
fn server_without_usage_is_named_with_remedy() {
    let points = sample_answers(80);
    let chunks = answers_of_lengths(0, "output-chunks", &points);
    let found = lengths(&comparison(vec![chunks]), &[]).expect("a sentence");
    assert!(found.rows.is_empty());
    assert_eq!(
        found.without_usage.as_deref(),
        Some(
            "A: the server sent no `usage`; use --x output-chunks with peernet plot --kind length on the files of the runs."
        )
    );
    let counted = comparison(vec![answers_of_lengths(0, "output-tokens", &points)]);
    assert_eq!(lengths(&counted, &[]).expect("lengths").without_usage, None);
}

/// Draws uniformly from 0 to 1 without both ends.
fn uniform(random: &mut SplitMix64) -> f64 {
    // Adds half of the distance between two numbers of the generator, which can return 0.
    random.unit() + f64::EPSILON / 4.0
}

/// Draws from the standard normal distribution (Box and Muller 1958).
fn normal(random: &mut SplitMix64) -> f64 {
    (-2.0 * uniform(random).ln()).sqrt() * (std::f64::consts::TAU * uniform(random)).cos()
}

const SLOPE: f64 = 0.4e-3;

/// Estimates the slope from 200 sets of `iterations` iterations. Returns the number of sets whose interval contains the
/// true slope. `iteration` draws the length of an answer, and the part of its latency that does not depend on the
/// length.
fn count_intervals_with_slope(iterations: usize, iteration: impl Fn(&mut SplitMix64) -> (f64, f64)) -> usize {
    let mut random = SplitMix64::new(13);
    let mut holds = || {
        let answer = |_| {
            let (tokens, other) = iteration(&mut random);
            (tokens, 0.030 + SLOPE * tokens + other)
        };
        let points: Vec<(f64, f64)> = (0..iterations).map(answer).collect();
        let (lo, hi) = Growth::from_iterations(&points).expect("enough").interval;
        assert!(hi - lo < SLOPE, "the interval is narrow enough to be useful: {lo} {hi}");
        (lo..=hi).contains(&SLOPE)
    };
    (0..200).filter(|_| holds()).count()
}

#[test]
fn interval_contains_slope_for_skewed_and_uniform_lengths() {
    // An interval at 95 % contains the slope in 190 of 200 sets on average. Chance permits a few sets less.
    let skewed = count_intervals_with_slope(120, |random| {
        let tokens = (4.5 + 0.6 * normal(random)).exp().round();
        let late = if uniform(random) < 0.05 { -0.08 * uniform(random).ln() } else { 0.0 };
        (tokens, (0.2e-3 + 0.005e-3 * tokens) * normal(random) + late)
    });
    assert!(skewed >= 180, "{skewed} of 200");
    let even = count_intervals_with_slope(300, |random| {
        ((3.0 + 38.0 * uniform(random)).floor(), 2e-5 * normal(random).abs())
    });
    assert!(even >= 180, "{even} of 200");
}

#[test]
fn slope_of_nanoseconds_has_significant_digits() {
    let points: Vec<(f64, f64)> = sample_answers(200).iter().map(|(x, _)| (*x, 1e-3 + x * 2.0e-9)).collect();
    let noisy: Vec<(f64, f64)> =
        points.iter().enumerate().map(|(n, (x, y))| (*x, y + 2e-9 * (n as f64 * 1.7).sin())).collect();
    let text = Growth::from_iterations(&noisy).expect("enough").describe_slope("tokens");
    let start = "Each further token takes 0.0000020";
    assert!(
        text.starts_with(start) && !text.contains("0.000 ") && text.contains("(95\u{202f}%: 0.00000"),
        "{text}"
    );
}

#[test]
fn iterations_without_valid_length_are_counted() {
    let mut points = sample_answers(295);
    for (n, (length, _)) in points.iter_mut().enumerate() {
        *length = [1e308, -5.0, 0.0, 1e-320, 1e300, 3.0, -1e308][n % 7];
    }
    let one = comparison(vec![answers_of_lengths(0, "tokens", &points)]);
    let counted: Vec<(f64, f64)> =
        points.iter().copied().filter(|(length, _)| is_included(*length)).collect();
    // Statistics accept four of the seven lengths: -5, 0, 1e-320 and 3.
    assert_eq!(counted.len(), 168);
    let found = lengths(&one, &answers_of_first(counted.clone(), true)).expect("lengths");
    let sentences = &found.rows[0].sentences;
    assert_eq!(
        sentences.last().map(String::as_str),
        Some("168 of 295 iterations; the others lack a valid length or latency.")
    );
    let part = lengths(&one, &answers_of_first(counted[..100].to_vec(), false)).expect("lengths");
    assert!(
        part.rows[0].sentences.iter().any(|text| text
            == "100 of 168 iterations, evenly spread; histograms of all. 127 of 295 iterations lack a valid length or latency."),
        "{:?}",
        part.rows[0].sentences
    );
}

#[test]
fn second_length_of_an_iteration_is_not_counted() {
    let points = sample_answers(80);
    let mut one = answers_of_lengths(0, "tokens", &points);
    let mut mergeable = MergeableStatistics::clone(&one.mergeable);
    let lengths_again = mergeable.summary("tokens").expect("lengths").clone();
    mergeable.add(Name::from("tokens"), "", &lengths_again);
    one.mergeable = Arc::new(mergeable);
    let found = lengths(&comparison(vec![one]), &answers_of_first(points, true)).expect("lengths");
    let sentences = &found.rows[0].sentences;
    assert_eq!(sentences.last().map(String::as_str), Some("All 80 iterations."), "{sentences:?}");
}

#[test]
fn at_most_six_configurations_with_varying_lengths_are_drawn() {
    let points = sample_answers(100);
    let equal_lengths: Vec<(f64, f64)> = points.iter().map(|(x, y)| (96.0 + x % 4.0, *y)).collect();
    let mut all: Vec<Configuration> =
        (0..8).map(|at| answers_of_lengths(at, "download-bytes", &points)).collect();
    assert!(
        lengths(&comparison(vec![answers_of_lengths(0, "download-bytes", &equal_lengths)]), &[]).is_none()
    );
    assert!(lengths(&comparison(Vec::new()), &[]).is_none());
    all[1] = answers_of_lengths(1, "download-bytes", &equal_lengths);
    let found =
        lengths(&comparison(all.clone()), &answers_from_quantiles(&comparison(all))).expect("lengths");
    let names: Vec<&str> = found.rows.iter().map(|row| row.name.as_str()).collect();
    assert_eq!((names.join(""), found.others.as_deref()), ("ACDEFG".to_owned(), Some("H")));
}

#[test]
fn tokens_and_bytes_have_separate_axes() {
    let points = sample_answers(450);
    let many: Vec<(f64, f64)> = points.iter().map(|(x, y)| (x * 1e3, y * 2.0)).collect();
    let both = comparison(vec![
        answers_of_lengths(0, "tokens", &points),
        answers_of_lengths(1, "download-bytes", &many),
    ]);
    let found = lengths(&both, &answers_from_quantiles(&both)).expect("lengths");
    assert!(found.has_cells, "450 points are drawn as cells");
    let [tokens, bytes] = [0, 1].map(|at| found.rows[at].plot.to_string());
    assert!(tokens.contains(">tokens<") && bytes.contains(">kB of answer<"), "{bytes}");
    let vertical_axis = |html: &str| {
        html.split("class=\"yaxis\"").nth(1).map(|rest| rest.split("</svg>").next().map(str::to_owned))
    };
    assert_eq!(vertical_axis(&tokens), vertical_axis(&bytes));
    assert!(found.rows[1].sentences[1].contains("Each further kB takes"), "{:?}", found.rows[1].sentences);
}
