//! The keys of `kind = "openai"`.

use std::num::NonZeroU64;
use std::sync::{Arc, Once};
use std::time::Duration;

use peernet_clock::SharedClock;
use peernet_external::process::MAX_TIMEOUT_MS;
use serde::{Deserialize, Serialize};

use super::Openai;
use super::server::{ApiKey, Server};
use super::time_limits::TimeLimits;
use crate::model::{CommonSettings, Keys, LoadContext, ModelKind};
use crate::{LoadError, Model};

/// Fields of a request that must not be in `parameters`. This program sets these fields, except `n`: without `n`, the
/// server sends one choice, as this program expects.
const RESERVED_PARAMETERS: [&str; 5] = ["model", "messages", "stream", "stream_options", "n"];

/// Keys of a model of `kind = "openai"`. Each worker waits for one answer at a time.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OpenaiConfig {
    /// URL of the API, such as `http://127.0.0.1:8080/v1` or `https://gpu.example/v1`; requests go to
    /// `/chat/completions` below it.
    pub url: String,
    /// Name of the model on the server.
    pub model: String,
    /// Name of the environment variable with the key of the API. Without this setting, no key is sent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub api_key_env: Option<String>,
    /// Text of the system message.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub system_prompt: Option<String>,
    /// Text before the parts of each sample.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prompt: Option<String>,
    /// Longest time from the request to the first token, milliseconds.
    #[serde(default = "one_minute")]
    pub first_token_timeout_ms: NonZeroU64,
    /// Longest time from one chunk of text to the next, milliseconds.
    #[serde(default = "ten_seconds")]
    pub token_timeout_ms: NonZeroU64,
    /// Longest time for a whole answer, milliseconds.
    #[serde(default = "ten_minutes")]
    pub timeout_ms: NonZeroU64,
    /// Further fields of each request, such as `max_tokens` and `temperature`.
    // TOML requires that tables follow the other keys.
    #[serde(default, skip_serializing_if = "Keys::is_empty")]
    pub parameters: Keys,
}

fn one_minute() -> NonZeroU64 {
    const { NonZeroU64::new(60_000).expect("is not zero") }
}

fn ten_seconds() -> NonZeroU64 {
    const { NonZeroU64::new(10_000).expect("is not zero") }
}

fn ten_minutes() -> NonZeroU64 {
    const { NonZeroU64::new(600_000).expect("is not zero") }
}

impl ModelKind for OpenaiConfig {
    /// Returns `server`: the model computes on a device of the server, which this host does not know.
    fn default_device() -> &'static str {
        "server"
    }

    fn limits(&self) -> Vec<(&'static str, usize, usize)> {
        let limit = |key, value: NonZeroU64| {
            (key, usize::try_from(value.get()).unwrap_or(usize::MAX), MAX_TIMEOUT_MS as usize)
        };
        vec![
            limit("first_token_timeout_ms", self.first_token_timeout_ms),
            limit("token_timeout_ms", self.token_timeout_ms),
            limit("timeout_ms", self.timeout_ms),
        ]
    }

    fn check(&self, common: &CommonSettings, _context: &LoadContext<'_>) -> Result<(), LoadError> {
        self.server(common).map(|_| ())
    }

    /// Asks the server for the list of its models, which shows whether the server can be reached.
    fn load(&self, common: &CommonSettings, context: &LoadContext<'_>) -> Result<Arc<dyn Model>, LoadError> {
        let model = Openai {
            name: common.name.to_string(),
            device: common.device.clone(),
            config: self.clone(),
            server: self.server(common)?,
            clock: SharedClock::clone(context.clock),
            usage_warning: Once::new(),
        };
        model.check_server()?;
        // `Model` is implemented for `Arc<Openai>`, because each worker holds a reference to the model.
        Ok(Arc::new(Arc::new(model)))
    }
}

impl OpenaiConfig {
    /// Returns the time limits of a request.
    pub(super) fn time_limits(&self) -> TimeLimits {
        let duration = |limit: NonZeroU64| Duration::from_millis(limit.get());
        TimeLimits {
            first_token: duration(self.first_token_timeout_ms),
            token: duration(self.token_timeout_ms),
            total: duration(self.timeout_ms),
        }
    }

    /// Returns the server, with the key from the environment.
    fn server(&self, common: &CommonSettings) -> Result<Server, LoadError> {
        let invalid_key = |key, reason| LoadError::InvalidKey { model: common.name.to_string(), key, reason };
        if let Some(reserved) = RESERVED_PARAMETERS.iter().find(|name| self.parameters.contains_key(**name)) {
            return Err(invalid_key(
                "parameters",
                format!("{reserved} is reserved for this program; remove it"),
            ));
        }
        // NaN and infinity in TOML have become null, because JSON has no such numbers.
        if let Some((name, _)) = self.parameters.iter().find(|(_, value)| value.is_null()) {
            return Err(invalid_key("parameters", format!("{name} is no finite number; write a finite one")));
        }
        let key = self.api_key_env.as_ref().map(|variable| {
            let text = std::env::var(variable)
                .map_err(|_| format!("the environment variable {variable} is not set; set it to the key"))?;
            // This error replaces that of the library, because it names the variable. Neither error shows the key.
            ApiKey::new(text).map_err(|_| format!("the environment variable {variable} holds no valid key"))
        });
        let key = key.transpose().map_err(|reason| invalid_key("api_key_env", reason))?;
        Server::new(&self.url, key).map_err(|reason| invalid_key("url", reason))
    }
}
