//! `echo`: answers with what it was given, at once.

use bytes::Bytes;
use peernet_logger::{Recorder, stage};
use peernet_sample::{Description, Sample};

use crate::{EchoConfig, InferenceError, LoadError, Model, Worker};

/// Answers without computing: what remains to be measured is everything around a model.
pub(crate) struct Echo {
    config: EchoConfig,
    answer: Option<Sample>,
}

impl Echo {
    pub(crate) fn new(config: EchoConfig) -> Self {
        let fixed = |length| Sample::of(Description::bytes(), Bytes::from(vec![0; length]));
        let answer = config.answer_bytes.map(fixed);
        Self { config, answer }
    }
}

impl Model for Echo {
    fn worker(&self) -> Result<Box<dyn Worker>, LoadError> {
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
    fn infer(&mut self, sample: &Sample, log: &mut Recorder) -> Result<Sample, InferenceError> {
        let _inference = log.time(stage::INFERENCE);
        Ok(self.answer.as_ref().unwrap_or(sample).clone())
    }
}
