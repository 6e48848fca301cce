//! Model kind `openai`: a language model behind a server with the chat API of OpenAI, such as llama.cpp, vLLM, Ollama,
//! TensorRT-LLM or LM Studio. Answers are streamed.
//!
//! ```text
//! sample ── request ── server (HTTP over TCP or TLS) ── event_stream ── event_data ── answer ── nodes, sample
//! ```
//!
//! `event_stream`, `event_data` and `answer` have no I/O. `server` reads the clock as soon as bytes arrive, and
//! then parses the bytes.

mod answer;
mod config;
mod connection;
mod error;
mod event_data;
mod event_stream;
pub mod fuzzing;
mod nodes;
mod request;
mod server;
mod status_error;
mod stream_error;
mod time_limits;
mod worker;

pub use config::OpenaiConfig;

use std::sync::{Arc, Once};

use peernet_clock::SharedClock;
use tokio::runtime::{Builder, Runtime};

use crate::{LoadError, Model, Worker};
use server::Server;
use worker::OpenaiWorker;

/// Language model behind a server, shared by all workers.
struct Openai {
    name: String,
    device: String,
    config: OpenaiConfig,
    server: Server,
    clock: SharedClock,
    /// Makes sure that invalid numbers of tokens are logged only once.
    usage_warning: Once,
}

impl Openai {
    /// Checks that the server can be reached. Blocks.
    fn check_server(&self) -> Result<(), LoadError> {
        self.runtime()?.block_on(self.server.check(self.config.time_limits().total)).map_err(|error| {
            LoadError::Server {
                model: self.name.clone(),
                url: self.config.url.clone(),
                is_transient: error.is_transient(),
                reason: error.message(self.server.secret()),
            }
        })
    }

    /// Creates a runtime for one thread.
    fn runtime(&self) -> Result<Runtime, LoadError> {
        let failed =
            |error: std::io::Error| LoadError::Thread { model: self.name.clone(), reason: error.to_string() };
        Builder::new_current_thread().enable_io().enable_time().build().map_err(failed)
    }
}

impl Model for Arc<Openai> {
    fn create_worker(&self) -> Result<Box<dyn Worker>, LoadError> {
        Ok(Box::new(OpenaiWorker::new(Self::clone(self), self.runtime()?)))
    }

    fn device(&self) -> String {
        self.device.clone()
    }

    fn facts(&self) -> Vec<(String, String)> {
        vec![("Model".to_owned(), format!("{}, over the chat API of OpenAI", self.config.model))]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the configuration of a model `llava` of this server.
    pub(super) fn config(url: &str) -> OpenaiConfig {
        toml::from_str(&format!("url = {url:?}\nmodel = 'llava'")).expect("has all keys")
    }
}
