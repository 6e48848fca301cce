//! Model kind `sleep`, which waits for the configured times.

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use peernet_logger::{Recorder, Slug, stage};
use peernet_sample::{Description, Sample};
use serde::{Deserialize, Serialize};

use super::{CommonSettings, LoadContext, ModelConfig, ModelKind, ModelTable};
use crate::{InferenceError, LoadError, Model, Requester, Worker};

/// Maximum duration of a stage, milliseconds: one day.
const MAX_STAGE_MS: usize = 24 * 3600 * 1000;

/// Keys of a model of `kind = "sleep"`. The model computes nothing. A worker processes one sample at a time, and sleeps
/// for the duration of each stage.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SleepConfig {
    /// Duration of `preprocessing`, milliseconds.
    #[serde(default = "ten_ms")]
    pub preprocessing_ms: u32,
    /// Duration of `inference`, milliseconds.
    #[serde(default = "eighty_ms")]
    pub inference_ms: u32,
    /// Duration of `postprocessing`, milliseconds.
    #[serde(default = "ten_ms")]
    pub postprocessing_ms: u32,
}

const fn ten_ms() -> u32 {
    10
}

const fn eighty_ms() -> u32 {
    80
}

impl ModelKind for SleepConfig {
    fn common_keys() -> &'static [&'static str] {
        &["name", "workers", "queue"]
    }

    fn limits(&self) -> Vec<(&'static str, usize, usize)> {
        vec![
            ("preprocessing_ms", self.preprocessing_ms as usize, MAX_STAGE_MS),
            ("inference_ms", self.inference_ms as usize, MAX_STAGE_MS),
            ("postprocessing_ms", self.postprocessing_ms as usize, MAX_STAGE_MS),
        ]
    }

    fn load(&self, common: &CommonSettings, _context: &LoadContext<'_>) -> Result<Arc<dyn Model>, LoadError> {
        Ok(Arc::new(Sleep { name: common.name.clone(), config: self.clone() }))
    }
}

impl ModelConfig {
    /// Returns the configuration of a model whose stages take 100 ms together.
    pub fn sleep(name: Slug) -> Self {
        let kind_settings = SleepConfig {
            preprocessing_ms: ten_ms(),
            inference_ms: eighty_ms(),
            postprocessing_ms: ten_ms(),
        };
        ModelTable { common: CommonSettings::new(name), kind_settings }.into()
    }
}

/// Model of known latency: three stages with configured durations.
struct Sleep {
    name: Slug,
    config: SleepConfig,
}

impl Model for Sleep {
    fn create_worker(&self) -> Result<Box<dyn Worker>, LoadError> {
        let SleepConfig { preprocessing_ms, inference_ms, postprocessing_ms } = self.config;
        let stages = [
            (stage::PREPROCESSING, preprocessing_ms),
            (stage::INFERENCE, inference_ms),
            (stage::POSTPROCESSING, postprocessing_ms),
        ];
        Ok(Box::new(SleepWorker {
            name: self.name.clone(),
            stages: stages.map(|(name, ms)| (name, Duration::from_millis(u64::from(ms)))),
        }))
    }

    fn device(&self) -> String {
        "cpu".to_owned()
    }

    fn facts(&self) -> Vec<(String, String)> {
        let SleepConfig { preprocessing_ms: before, inference_ms: during, postprocessing_ms: after } =
            self.config;
        vec![("Model".to_owned(), format!("sleep, {before} + {during} + {after} ms"))]
    }
}

struct SleepWorker {
    name: Slug,
    stages: [(peernet_logger::Name, Duration); 3],
}

impl Worker for SleepWorker {
    fn infer(
        &mut self,
        _sample: &Sample,
        recorder: &mut Recorder,
        requester: &dyn Requester,
    ) -> Result<Sample, InferenceError> {
        for (name, duration) in &self.stages {
            let _stage = recorder.time(name.clone());
            requester
                .wait(*duration)
                .map_err(|_| InferenceError::Cancelled { model: self.name.to_string() })?;
        }
        Ok(Sample::from_part(Description::bytes(), Bytes::new()))
    }
}
