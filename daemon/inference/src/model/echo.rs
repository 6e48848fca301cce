//! Model kind `echo`, which answers with its input.

use std::sync::Arc;

use bytes::Bytes;
use peernet_logger::{Recorder, Slug, stage};
use peernet_sample::{Description, Sample};
use serde::{Deserialize, Serialize};

use super::{CommonSettings, LoadContext, ModelConfig, ModelKind, ModelTable};
use crate::{InferenceError, LoadError, Model, Requester, Worker};

/// Largest fixed answer, bytes (1 GiB).
const MAX_ANSWER_BYTES: usize = 1 << 30;

/// Keys of a model of `kind = "echo"`. The model runs on the thread of its caller.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EchoConfig {
    /// Length of the answer, bytes. With this key, the answer consists of zeros; without it, the answer is the sample.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub answer_bytes: Option<usize>,
}

impl ModelKind for EchoConfig {
    fn common_keys() -> &'static [&'static str] {
        &["name"]
    }

    fn limits(&self) -> Vec<(&'static str, usize, usize)> {
        vec![("answer_bytes", self.answer_bytes.unwrap_or(0), MAX_ANSWER_BYTES)]
    }

    fn load(
        &self,
        _common: &CommonSettings,
        _context: &LoadContext<'_>,
    ) -> Result<Arc<dyn Model>, LoadError> {
        Ok(Arc::new(Echo::new(self.clone())))
    }
}

impl ModelConfig {
    /// Returns the configuration of a model that answers with its input.
    pub fn echo(name: Slug) -> Self {
        ModelTable { common: CommonSettings::new(name), kind_settings: EchoConfig::default() }.into()
    }
}

/// Model that answers without computing: an iteration then takes only the time that is spent outside the model.
pub(crate) struct Echo {
    config: EchoConfig,
    answer: Option<Sample>,
}

impl Echo {
    pub(crate) fn new(config: EchoConfig) -> Self {
        let zeros = |length| Sample::from_part(Description::bytes(), Bytes::from(vec![0; length]));
        let answer = config.answer_bytes.map(zeros);
        Self { config, answer }
    }
}

impl Model for Echo {
    fn create_worker(&self) -> Result<Box<dyn Worker>, LoadError> {
        Ok(Box::new(EchoWorker { answer: self.answer.clone() }))
    }

    fn blocks(&self) -> bool {
        false
    }

    fn device(&self) -> String {
        "cpu".to_owned()
    }

    fn facts(&self) -> Vec<(String, String)> {
        let answer = match self.config.answer_bytes {
            Some(bytes) => format!("echo, answers with {bytes} bytes"),
            None => "echo".to_owned(),
        };
        vec![("Model".to_owned(), answer)]
    }
}

struct EchoWorker {
    answer: Option<Sample>,
}

impl Worker for EchoWorker {
    fn infer(
        &mut self,
        sample: &Sample,
        recorder: &mut Recorder,
        _requester: &dyn Requester,
    ) -> Result<Sample, InferenceError> {
        let _inference = recorder.time(stage::INFERENCE);
        Ok(self.answer.as_ref().unwrap_or(sample).clone())
    }
}
