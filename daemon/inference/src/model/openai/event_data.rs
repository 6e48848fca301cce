//! Data of the events of a streamed answer, as JSON: the object `chat.completion.chunk` of the OpenAI API.
//!
//! Servers differ, so every field may be missing or null, and unknown fields are ignored.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::Value;
use serde_json::value::RawValue;

/// Data of one event.
#[derive(Debug, Default, Deserialize)]
pub(super) struct EventData<'a> {
    pub(super) choices: Option<Vec<Choice>>,
    /// Numbers of tokens. Most servers send those of the whole answer in the last event; some send the numbers so far
    /// in each event.
    // An invalid number of tokens must not make the text of the answer unreadable. `RawValue` accepts any number;
    // `Value` refuses 1e999.
    #[serde(borrow)]
    pub(super) usage: Option<&'a RawValue>,
    /// Error that ended the answer; some servers send `false` in each event.
    #[serde(borrow)]
    error: Option<&'a RawValue>,
    /// Kind of the object: `chat.completion.chunk`, or `error`.
    object: Option<Value>,
    /// Text of an error, in an event that has no member `error`.
    message: Option<Value>,
    /// Text of an error, under the name that FastAPI uses.
    detail: Option<IgnoredAny>,
}

/// New text of one choice, which is one of several alternative answers. A request asks for only one choice.
#[derive(Debug, Default, Deserialize)]
pub(super) struct Choice {
    /// Index of the choice; a missing index stands for 0.
    index: Option<Value>,
    pub(super) delta: Option<Delta>,
    pub(super) finish_reason: Option<String>,
    /// Error that ended the answer.
    error: Option<Value>,
    /// Whole answer of a server that does not stream.
    message: Option<Value>,
    /// Text of the answer in the API for completions without chat.
    text: Option<Value>,
}

/// Text of one or more tokens.
#[derive(Debug, Default, Deserialize)]
pub(super) struct Delta {
    /// Text of the answer.
    pub(super) content: Option<String>,
    /// Text of the reasoning before the answer. llama.cpp and DeepSeek use this name.
    reasoning_content: Option<String>,
    /// Text of the reasoning, under the name that Ollama and newer versions of vLLM use.
    reasoning: Option<String>,
}

/// Finish reason of an answer that an error ended.
const ERROR_FINISH_REASON: &str = "error";
/// JSON text of a missing value.
const NULL: &str = "null";
/// Maximum number of tokens: a 64-bit float represents all integers up to this one exactly.
const MAX_TOKENS: u64 = 1 << 53;

/// Numbers of tokens, as the server counted them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Usage {
    /// Tokens of the request, pictures included.
    pub(super) prompt_tokens: Option<u64>,
    /// Tokens of the request that the server had in its cache.
    pub(super) cached_tokens: Option<u64>,
    /// Tokens of reasoning and answer.
    pub(super) completion_tokens: Option<u64>,
    /// Tokens of the reasoning.
    pub(super) reasoning_tokens: Option<u64>,
}

impl EventData<'_> {
    /// Returns whether the event reports an error. vLLM and FastAPI report errors without the member `error`.
    pub(super) fn is_error(&self) -> bool {
        let is_error_object = self.object.as_ref().is_some_and(|object| object == "error");
        let has_error_text = self.message.as_ref().is_some_and(Value::is_string) || self.detail.is_some();
        let has_error = self.error.is_some_and(|error| error.get() != "false");
        has_error || is_error_object || (self.choices.is_none() && has_error_text)
    }
}

impl Choice {
    /// Returns whether this is the choice with the index 0, which is the only one that a request asks for.
    pub(super) fn is_first(&self) -> bool {
        self.index.as_ref().is_none_or(|index| {
            let number = index.as_f64().or_else(|| index.as_str()?.trim().parse().ok());
            number == Some(0.0)
        })
    }

    /// Returns the index of the choice as the server wrote it.
    pub(super) fn index_text(&self) -> String {
        self.index.as_ref().map_or_else(|| "0".to_owned(), Value::to_string)
    }

    /// Returns whether this choice has text of the answer or of the reasoning.
    pub(super) fn has_text(&self) -> bool {
        self.delta.as_ref().is_some_and(|delta| {
            delta.has_reasoning() || delta.content.as_ref().is_some_and(|content| !content.is_empty())
        })
    }

    /// Returns the text of the error that ended this answer; `None` without an error.
    pub(super) fn error_text(&self) -> Option<String> {
        let has_failed = self.finish_reason.as_deref() == Some(ERROR_FINISH_REASON);
        self.error
            .as_ref()
            .filter(|error| **error != Value::Bool(false))
            .map(error_text)
            .or_else(|| has_failed.then(|| format!("finish_reason is {ERROR_FINISH_REASON}")))
    }

    /// Returns the name of the field that has the text of a whole answer; `None` if there is a `delta` or no such text.
    pub(super) fn field_of_whole_text(&self) -> Option<&'static str> {
        let has_text =
            |value: Option<&Value>| value.and_then(Value::as_str).is_some_and(|text| !text.is_empty());
        if self.delta.is_some() {
            None
        } else if has_text(self.message.as_ref().and_then(|message| message.get("content"))) {
            Some("message")
        } else {
            has_text(self.text.as_ref()).then_some("text")
        }
    }
}

impl Delta {
    /// Returns whether there is text of the reasoning.
    pub(super) fn has_reasoning(&self) -> bool {
        [&self.reasoning_content, &self.reasoning].into_iter().flatten().any(|text| !text.is_empty())
    }
}

impl Usage {
    /// Reads the object `usage`. Invalid numbers of tokens are left out. Also returns the first invalid number as text,
    /// such as `completion_tokens = -5`.
    pub(super) fn read(usage: &RawValue) -> (Self, Option<String>) {
        let Some(table) = members(usage) else {
            return (Self::default(), Some(format!("usage = {usage}")));
        };
        let mut defect = None;
        // A number without a group is a member of `usage` itself.
        let mut count = |group: Option<&str>, name: &str| {
            let details = group.map(|group| table.get(group).and_then(|details| members(details)));
            let value = details.as_ref().map_or(Some(&table), Option::as_ref)?.get(name)?.get();
            let tokens = value.parse().ok().filter(|tokens| *tokens <= MAX_TOKENS);
            if tokens.is_none() && value != NULL {
                defect.get_or_insert_with(|| format!("{name} = {value}"));
            }
            tokens
        };
        let mut read = Self {
            prompt_tokens: count(None, "prompt_tokens"),
            cached_tokens: count(Some("prompt_tokens_details"), "cached_tokens"),
            completion_tokens: count(None, "completion_tokens"),
            reasoning_tokens: count(Some("completion_tokens_details"), "reasoning_tokens"),
        };
        // Cached tokens are part of the tokens of the request, and tokens of the reasoning are part of the
        // completion's.
        for (part, part_name, total, total_name) in [
            (&mut read.cached_tokens, "cached_tokens", read.prompt_tokens, "prompt_tokens"),
            (&mut read.reasoning_tokens, "reasoning_tokens", read.completion_tokens, "completion_tokens"),
        ] {
            if let (Some(tokens), Some(total)) = (*part, total)
                && tokens > total
            {
                defect.get_or_insert_with(|| format!("{part_name} = {tokens} of {total_name} = {total}"));
                *part = None;
            }
        }
        (read, defect)
    }
}

/// Returns the members of an object without parsing their values; `None` if the value is not an object.
fn members(value: &RawValue) -> Option<BTreeMap<String, &RawValue>> {
    serde_json::from_str(value.get()).ok()
}

/// Returns the text of a server's error: the text itself, or the member `message` or `detail` of an object; otherwise
/// the value as JSON.
fn error_text(error: &Value) -> String {
    let text = |name| error.get(name).and_then(Value::as_str);
    match error {
        Value::String(text) => text.clone(),
        error => text("message").or_else(|| text("detail")).map_or_else(|| error.to_string(), str::to_owned),
    }
}

/// Returns the text of a server's error from the body of an answer or the data of an event.
pub(super) fn error_text_of_body(body: &[u8]) -> String {
    match serde_json::from_slice::<Value>(body) {
        Ok(json) => error_text(json.get("error").filter(|error| !error.is_null()).unwrap_or(&json)),
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
            (r#"{"detail":"no"}"#, "no"),
            (r#"{"detail":[{"msg":"no"}]}"#, r#"{"detail":[{"msg":"no"}]}"#),
            ("Internal Server Error\n", "Internal Server Error"),
            ("", ""),
        ] {
            assert_eq!(error_text_of_body(body.as_bytes()), text);
        }
    }

    #[test]
    fn invalid_numbers_of_tokens_are_left_out() {
        let both_counts = Usage { prompt_tokens: Some(12), completion_tokens: Some(5), ..Usage::default() };
        for (usage, expected, defect) in [
            (r#"{"prompt_tokens":12,"completion_tokens":5,"prompt_tokens_details":7}"#, both_counts, None),
            (
                r#"{"prompt_tokens":12,"completion_tokens":null}"#,
                Usage { completion_tokens: None, ..both_counts },
                None,
            ),
            (
                r#"{"prompt_tokens":12.0,"completion_tokens":5}"#,
                Usage { prompt_tokens: None, ..both_counts },
                Some("prompt_tokens = 12.0"),
            ),
            (
                r#"{"prompt_tokens":12,"completion_tokens":-5}"#,
                Usage { completion_tokens: None, ..both_counts },
                Some("completion_tokens = -5"),
            ),
            (
                r#"{"prompt_tokens":12,"completion_tokens":9007199254740993}"#,
                Usage { completion_tokens: None, ..both_counts },
                Some("completion_tokens = 9007199254740993"),
            ),
            (r#"{"prompt_tokens":"12"}"#, Usage::default(), Some("prompt_tokens = \"12\"")),
            (r#"{"completion_tokens":1e30}"#, Usage::default(), Some("completion_tokens = 1e30")),
            (
                r#"{"prompt_tokens":12,"completion_tokens":1e999}"#,
                Usage { completion_tokens: None, ..both_counts },
                Some("completion_tokens = 1e999"),
            ),
            (
                r#"{"prompt_tokens":1.5,"completion_tokens":5}"#,
                Usage { prompt_tokens: None, ..both_counts },
                Some("prompt_tokens = 1.5"),
            ),
            ("[12]", Usage::default(), Some("usage = [12]")),
            (
                r#"{"prompt_tokens":12,"completion_tokens":5,"completion_tokens_details":{"reasoning_tokens":99}}"#,
                both_counts,
                Some("reasoning_tokens = 99 of completion_tokens = 5"),
            ),
            (
                r#"{"prompt_tokens":12,"completion_tokens":5,"prompt_tokens_details":{"cached_tokens":13}}"#,
                both_counts,
                Some("cached_tokens = 13 of prompt_tokens = 12"),
            ),
        ] {
            let read = Usage::read(serde_json::from_str(usage).expect("is JSON"));
            assert_eq!(read, (expected, defect.map(str::to_owned)), "{usage}");
        }
    }

    #[test]
    fn error_false_or_null_is_no_error() {
        let read = |data| serde_json::from_str::<EventData<'_>>(data).expect("is JSON");
        for data in [r#"{"error":false,"choices":[{"error":false}]}"#, r#"{"error":null,"choices":[{}]}"#] {
            let event = read(data);
            assert!(!event.is_error(), "{data}");
            let choices = event.choices.expect("is there");
            assert!(choices.iter().all(|choice| choice.error_text().is_none()), "{data}");
        }
        for error in
            [r#"{"error":"oom"}"#, r#"{"error":{"message":"oom"},"choices":[]}"#, r#"{"error":true}"#]
        {
            assert!(read(error).is_error(), "{error}");
        }
    }

    #[test]
    fn fields_may_be_missing_or_null() {
        for data in [
            "{}",
            r#"{"choices":null,"usage":null}"#,
            r#"{"choices":[{"delta":{"content":null},"finish_reason":null}]}"#,
            r#"{"choices":[{}],"usage":{"prompt_tokens_details":null}}"#,
            r#"{"choices":[{}],"usage":{"completion_tokens":1e999}}"#,
        ] {
            serde_json::from_str::<EventData<'_>>(data).unwrap_or_else(|error| panic!("{data}: {error}"));
        }
    }
}
