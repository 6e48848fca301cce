//! Nodes below `inference` that describe an answer. docs/language-models.md defines these nodes.

use peernet_clock::Span;
use peernet_logger::{Name, Recorder, Unit, stage};
use peernet_statistics::histogram::OrderedValues;

use super::answer::StreamedAnswer;

/// Time of opening the connection.
const CONNECT: Name = Name::from_static("connect");
/// Time from the start of the request to the first chunk with text of the reasoning.
const TIME_TO_FIRST_REASONING_TOKEN: Name = Name::from_static("time-to-first-reasoning-token");
/// Mean time between successive chunks.
const INTER_TOKEN_LATENCY: Name = Name::from_static("inter-token-latency");
/// Median time between successive chunks.
const INTER_TOKEN_LATENCY_P50: Name = Name::from_static("inter-token-latency-p50");
/// Longest time between successive chunks.
const INTER_TOKEN_LATENCY_MAX: Name = Name::from_static("inter-token-latency-max");
/// Time from the first to the last chunk, divided by the number of tokens minus one.
const TIME_PER_OUTPUT_TOKEN: Name = Name::from_static("time-per-output-token");
/// Tokens of reasoning and answer, divided by the time from the start of the request to the last chunk.
const OUTPUT_TOKEN_RATE: Name = Name::from_static("output-token-rate");
/// Tokens of reasoning and answer, as the server counted them.
const OUTPUT_TOKENS: Name = Name::from_static("output-tokens");
/// Tokens of the reasoning, as the server counted them.
const REASONING_TOKENS: Name = Name::from_static("reasoning-tokens");
/// Tokens of the request, pictures included, as the server counted them.
const INPUT_TOKENS: Name = Name::from_static("input-tokens");
/// Tokens of the request that the server had in its cache.
const CACHED_INPUT_TOKENS: Name = Name::from_static("cached-input-tokens");
/// 1 if the model ended the answer, otherwise 0.
const FINISH_REASON_STOP: Name = Name::from_static("finish-reason-stop");
/// 1 if the limit on tokens ended the answer, otherwise 0.
const FINISH_REASON_LENGTH: Name = Name::from_static("finish-reason-length");

/// Records the nodes of an answer, which may be incomplete. Nodes with unknown values are left out.
pub(super) fn record(answer: &StreamedAnswer, inference: &mut Recorder) {
    let started_at = answer.started_at;
    for (name, at) in [
        (CONNECT, answer.connected_at),
        (TIME_TO_FIRST_REASONING_TOKEN, answer.first_reasoning_at),
        (stage::TIME_TO_FIRST_TOKEN, answer.first_content_at),
    ] {
        if let Some(at) = at {
            inference.record_timer(name, started_at, at);
        }
    }
    let mut intervals: Vec<f64> = answer.chunk_intervals().into_iter().map(Span::seconds).collect();
    intervals.sort_unstable_by(f64::total_cmp);
    if let (Some(median), Some(longest)) = (intervals.interpolated_quantile(0.5), intervals.last()) {
        let mean = intervals.iter().sum::<f64>() / intervals.len() as f64;
        inference.record_value(INTER_TOKEN_LATENCY, mean, Unit::SECONDS);
        inference.record_value(INTER_TOKEN_LATENCY_P50, median, Unit::SECONDS);
        inference.record_value(INTER_TOKEN_LATENCY_MAX, *longest, Unit::SECONDS);
    }
    inference.record_value(stage::OUTPUT_CHUNKS, answer.chunk_count() as f64, Unit::NONE);
    let usage = answer.usage.unwrap_or_default();
    if let (Some(tokens), Some(last_chunk_at)) = (usage.completion_tokens, answer.last_chunk_at()) {
        if let Some(time) = answer.decode_time().filter(|_| tokens > 1) {
            inference.record_value(
                TIME_PER_OUTPUT_TOKEN,
                time.seconds() / (tokens - 1) as f64,
                Unit::SECONDS,
            );
        }
        let time = last_chunk_at - started_at;
        if time > Span::ZERO {
            inference.record_value(
                OUTPUT_TOKEN_RATE,
                tokens as f64 / time.seconds(),
                Unit::TOKENS_PER_SECOND,
            );
        }
    }
    for (name, tokens) in [
        (OUTPUT_TOKENS, usage.completion_tokens),
        (REASONING_TOKENS, usage.reasoning_tokens),
        (INPUT_TOKENS, usage.prompt_tokens),
        (CACHED_INPUT_TOKENS, usage.cached_tokens),
    ] {
        if let Some(tokens) = tokens {
            inference.record_value(name, tokens as f64, Unit::TOKENS);
        }
    }
    if let Some(reason) = &answer.finish_reason {
        for (name, expected) in [(FINISH_REASON_STOP, "stop"), (FINISH_REASON_LENGTH, "length")] {
            inference.record_value(name, if reason == expected { 1.0 } else { 0.0 }, Unit::NONE);
        }
    }
}
