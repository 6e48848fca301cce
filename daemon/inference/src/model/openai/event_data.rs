//! Data of the events of a streamed answer, as JSON: the object `chat.completion.chunk` of the OpenAI API.
//!
//! Servers differ, so every field may be missing or null, and unknown fields are ignored.

use serde::Deserialize;
use serde_json::Value;

/// Data of one event.
#[derive(Debug, Default, Deserialize)]
pub(super) struct EventData {
    pub(super) choices: Option<Vec<Choice>>,
    /// Number of tokens of the whole answer in the last event; some servers send the number so far in each event.
    pub(super) usage: Option<Usage>,
    /// Error that ended the answer.
    pub(super) error: Option<Value>,
}

/// Part of one answer; a request asks for one answer only.
#[derive(Debug, Default, Deserialize)]
pub(super) struct Choice {
    pub(super) delta: Option<Delta>,
    pub(super) finish_reason: Option<String>,
}

/// Text of one or more tokens.
#[derive(Debug, Default, Deserialize)]
pub(super) struct Delta {
    /// Text of the answer.
    pub(super) content: Option<String>,
    /// Text of the reasoning before the answer. llama.cpp and DeepSeek use this name.
    reasoning_content: Option<String>,
    /// The same under the name that Ollama and newer versions of vLLM use.
    reasoning: Option<String>,
}

/// Number of tokens, as the server counted them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
pub(super) struct Usage {
    /// Tokens of the request, pictures included.
    pub(super) prompt_tokens: Option<u64>,
    /// Tokens of reasoning and answer.
    pub(super) completion_tokens: Option<u64>,
    prompt_tokens_details: Option<PromptDetails>,
    completion_tokens_details: Option<CompletionDetails>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
struct PromptDetails {
    cached_tokens: Option<u64>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
struct CompletionDetails {
    reasoning_tokens: Option<u64>,
}

impl Delta {
    /// Returns whether the event has text of the reasoning.
    pub(super) fn has_reasoning(&self) -> bool {
        [&self.reasoning_content, &self.reasoning].into_iter().flatten().any(|text| !text.is_empty())
    }
}

impl Usage {
    /// Returns the number of tokens of the request that the server had in its cache.
    pub(super) fn cached_tokens(&self) -> Option<u64> {
        self.prompt_tokens_details?.cached_tokens
    }

    /// Returns the number of tokens of the reasoning.
    pub(super) fn reasoning_tokens(&self) -> Option<u64> {
        self.completion_tokens_details?.reasoning_tokens
    }
}

/// Returns the text of a server's error: `message` of the object `error`, `error` itself, or the whole text.
pub(super) fn error_text(error: &Value) -> String {
    let message = |error: &Value| error.get("message").and_then(Value::as_str).map(str::to_owned);
    match error {
        Value::String(text) => text.clone(),
        error => message(error).unwrap_or_else(|| error.to_string()),
    }
}

/// Returns the text of a server's error from the body of its answer.
pub(super) fn error_text_of_body(body: &[u8]) -> String {
    match serde_json::from_slice::<Value>(body) {
        Ok(json) => error_text(json.get("error").unwrap_or(&json)),
        Err(_) => String::from_utf8_lossy(body).trim().to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_servers_are_read() {
        for (body, text) in [
            (
                r#"{"error":{"message":"The model `x` does not exist.","code":404}}"#,
                "The model `x` does not exist.",
            ),
            (r#"{"error":"model 'x' not found"}"#, "model 'x' not found"),
            (r#"{"object":"error","message":"too long"}"#, "too long"),
            (r#"{"detail":"no"}"#, r#"{"detail":"no"}"#),
            ("Internal Server Error\n", "Internal Server Error"),
            ("", ""),
        ] {
            assert_eq!(error_text_of_body(body.as_bytes()), text);
        }
    }

    #[test]
    fn fields_may_be_missing_or_null() {
        for data in [
            "{}",
            r#"{"choices":null,"usage":null}"#,
            r#"{"choices":[{"delta":{"content":null},"finish_reason":null}]}"#,
            r#"{"choices":[{}],"usage":{"prompt_tokens_details":null}}"#,
        ] {
            serde_json::from_str::<EventData>(data).unwrap_or_else(|error| panic!("{data}: {error}"));
        }
    }
}
