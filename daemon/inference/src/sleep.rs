//! `sleep`: takes the time it is told to.

use std::time::Duration;

use bytes::Bytes;
use peernet_logger::{Recorder, stage};
use peernet_sample::{Description, Sample};

use crate::{InferenceError, LoadError, Model, SleepConfig, Worker};

/// A model of known latency: three stages that each take a configured time.
pub(crate) struct Sleep {
    config: SleepConfig,
}

impl Sleep {
    pub(crate) fn new(config: SleepConfig) -> Self {
        Self { config }
    }
}

impl Model for Sleep {
    fn worker(&self) -> Result<Box<dyn Worker>, LoadError> {
        let SleepConfig { preprocessing_ms, inference_ms, postprocessing_ms, .. } = self.config;
        let stages = [
            (stage::PREPROCESSING, preprocessing_ms),
            (stage::INFERENCE, inference_ms),
            (stage::POSTPROCESSING, postprocessing_ms),
        ];
        Ok(Box::new(SleepWorker {
            stages: stages.map(|(name, ms)| (name, Duration::from_millis(u64::from(ms)))),
        }))
    }

    fn device(&self) -> String {
        "cpu".to_owned()
    }

    fn facts(&self) -> Vec<(String, String)> {
        let SleepConfig { preprocessing_ms: before, inference_ms: during, postprocessing_ms: after, .. } =
            self.config;
        vec![("Model".to_owned(), format!("sleep, {before} + {during} + {after} ms"))]
    }
}

struct SleepWorker {
    stages: [(peernet_logger::Name, Duration); 3],
}

impl Worker for SleepWorker {
    fn infer(&mut self, _sample: &Sample, log: &mut Recorder) -> Result<Sample, InferenceError> {
        for (name, duration) in &self.stages {
            let _stage = log.time(name.clone());
            std::thread::sleep(*duration);
        }
        Ok(Sample::of(Description::bytes(), Bytes::new()))
    }
}
