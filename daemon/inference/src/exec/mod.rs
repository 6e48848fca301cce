//! `exec`: a program of the user's own.

mod config;

pub use config::ExecModelConfig;

use std::sync::{Mutex, PoisonError};

use peernet_clock::SharedClock;
use peernet_external::exec::{ExchangeError, Program, Request, Role, Said};
use peernet_logger::{Name, Recorder, Unit};
use peernet_sample::Sample;

use crate::{InferenceError, LoadError, Model, Worker};

/// A program, once for each worker.
pub(crate) struct Exec {
    config: ExecModelConfig,
    clock: SharedClock,
    facts: Vec<(String, String)>,
    /// The first one, which was started to see whether it can be.
    first: Mutex<Option<Program>>,
}

impl Exec {
    /// Everything that can be found wrong without running the program.
    pub(crate) fn check(config: &ExecModelConfig) -> Result<(), LoadError> {
        config.process().check().map_err(|reason| failed(config, ExchangeError::Command(reason)))
    }

    /// Starts one process.
    pub(crate) fn load(config: &ExecModelConfig, clock: &SharedClock) -> Result<Self, LoadError> {
        let facts = config.process().facts(Role::Model);
        let first = Mutex::new(Some(start(config, clock)?));
        Ok(Self { config: config.clone(), clock: SharedClock::clone(clock), facts, first })
    }
}

impl Model for Exec {
    fn worker(&self) -> Result<Box<dyn Worker>, LoadError> {
        let first = self.first.lock().unwrap_or_else(PoisonError::into_inner).take();
        let program = first.map_or_else(|| start(&self.config, &self.clock), Ok)?;
        Ok(Box::new(ExecWorker { model: self.config.name.to_string(), program }))
    }

    fn device(&self) -> String {
        self.config.device.clone()
    }

    fn facts(&self) -> Vec<(String, String)> {
        self.facts.clone()
    }
}

fn start(config: &ExecModelConfig, clock: &SharedClock) -> Result<Program, LoadError> {
    Program::start(&config.process(), Role::Model, &format!("model {}", config.name), clock)
        .map_err(|error| failed(config, error))
}

fn failed(config: &ExecModelConfig, error: ExchangeError) -> LoadError {
    LoadError::Program { model: config.name.to_string(), command: config.command.to_string(), error }
}

struct ExecWorker {
    model: String,
    program: Program,
}

impl Worker for ExecWorker {
    fn infer(&mut self, sample: &Sample, log: &mut Recorder) -> Result<Sample, InferenceError> {
        let failed = |reason| InferenceError::Failed { model: self.model.clone(), reason };
        let exchange =
            self.program.ask(Request::Sample(sample)).map_err(|error| failed(error.to_string()))?;
        for stage in exchange.stages().map_err(|error| failed(error.to_string()))? {
            log.timed(Name::from(stage.name), stage.from, stage.to);
        }
        for (name, value, unit) in &exchange.notes.values {
            log.value(Name::from(name.as_str()), *value, Unit::new(unit));
        }
        match exchange.said {
            Said::Parts(parts) => Ok(Sample { parts, source: String::new(), label: None }),
            other => Err(failed(format!("it answered as a model does not: {other:?}"))),
        }
    }
}
