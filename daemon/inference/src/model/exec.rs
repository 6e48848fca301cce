//! Model kind `exec`: a custom program, with one process for each worker.

use std::collections::BTreeMap;
use std::num::NonZeroU64;
use std::sync::{Arc, Mutex, PoisonError};

use peernet_clock::SharedClock;
use peernet_external::DEVICE_VARIABLE;
pub use peernet_external::exec::ExecConfig;
use peernet_external::exec::{
    CommandLine, FingerprintKey, Program, ProgramCallError, ReplyOutcome, Request, Role,
};
use peernet_logger::{Name, Recorder, Unit};
use peernet_sample::Sample;

use super::{CommonSettings, Keys, LoadContext, ModelConfig, ModelKind, ModelTable};
use crate::{Cancelled, InferenceError, LoadError, Model, PartialAnswerError, Requester, Worker};

impl ModelConfig {
    /// Returns the configuration of a program, given as a line for the shell.
    pub fn program(common: CommonSettings, command: &str, timeout_ms: Option<NonZeroU64>) -> Self {
        let kind_settings = ExecConfig::new(CommandLine::Shell(command.to_owned()));
        let timeout_ms = timeout_ms.unwrap_or(kind_settings.timeout_ms);
        ModelTable { common, kind_settings: ExecConfig { timeout_ms, ..kind_settings } }.into()
    }
}

impl ModelKind for ExecConfig {
    fn keys_omitted_from_runs(&self) -> &'static [&'static str] {
        &["command", "folder"]
    }

    fn is_program(&self) -> bool {
        true
    }

    fn arguments_fact(&self, key: &FingerprintKey) -> Option<(String, String)> {
        self.arguments_fact_for(Role::Model, key)
    }

    fn env_mut(&mut self) -> Option<&mut BTreeMap<String, String>> {
        Some(&mut self.env)
    }

    fn remove_defaults(&self, keys: &mut Keys) {
        if self.timeout_ms == Self::new(self.command.clone()).timeout_ms {
            keys.remove("timeout_ms");
        }
    }

    fn check(&self, common: &CommonSettings, _context: &LoadContext<'_>) -> Result<(), LoadError> {
        // A check must not run custom code. This one checks the settings and that the program exists.
        with_device(self, common)
            .check_for(Role::Model)
            .map_err(|reason| load_error(self, common, ProgramCallError::Command(reason)))
    }

    /// Starts one process.
    fn load(&self, common: &CommonSettings, context: &LoadContext<'_>) -> Result<Arc<dyn Model>, LoadError> {
        let config = with_device(self, common);
        let (common, clock) = (common.clone(), SharedClock::clone(context.clock));
        let facts = config.facts_for(Role::Model);
        let first_program = Mutex::new(Some(start(&config, &common, &clock)?));
        Ok(Arc::new(Exec { config, common, clock, facts, first_program }))
    }
}

/// Returns the configuration with the device in the program's environment.
fn with_device(config: &ExecConfig, common: &CommonSettings) -> ExecConfig {
    let mut config = config.clone();
    config.env.insert(DEVICE_VARIABLE.to_owned(), common.device.clone());
    config
}

/// Program of which each worker runs its own process.
struct Exec {
    config: ExecConfig,
    common: CommonSettings,
    clock: SharedClock,
    facts: Vec<(String, String)>,
    /// Process that was started while the model was loaded, which shows that the program can be started. The first
    /// worker takes this process.
    first_program: Mutex<Option<Program>>,
}

impl Model for Exec {
    fn create_worker(&self) -> Result<Box<dyn Worker>, LoadError> {
        let first_program = self.first_program.lock().unwrap_or_else(PoisonError::into_inner).take();
        let program = first_program.map_or_else(|| start(&self.config, &self.common, &self.clock), Ok)?;
        Ok(Box::new(ExecWorker { model: self.common.name.to_string(), program }))
    }

    fn device(&self) -> String {
        self.common.device.clone()
    }

    fn facts(&self) -> Vec<(String, String)> {
        self.facts.clone()
    }
}

fn start(config: &ExecConfig, common: &CommonSettings, clock: &SharedClock) -> Result<Program, LoadError> {
    Program::start(config, Role::Model, &format!("model {}", common.name), clock)
        .map_err(|error| load_error(config, common, error))
}

fn load_error(config: &ExecConfig, common: &CommonSettings, error: ProgramCallError) -> LoadError {
    LoadError::Program { model: common.name.to_string(), command: config.command.to_string(), error }
}

struct ExecWorker {
    model: String,
    program: Program,
}

impl Worker for ExecWorker {
    fn infer(
        &mut self,
        sample: &Sample,
        recorder: &mut Recorder,
        requester: &dyn Requester,
    ) -> Result<Sample, InferenceError> {
        let failed = |reason| InferenceError::Failed { model: self.model.clone(), reason };
        let mut send_error = None;
        let result = self.program.call_with_partial_answers(Request::Sample(sample), &mut |part| {
            let partial_answer = Sample { parts: vec![part], source: String::new(), label: None };
            send_error = requester.send_partial_answer(partial_answer).err();
            // `false` ends the call with `ProgramCallError::Cancelled`; `send_error` then is the reason.
            send_error.is_none()
        });
        let program_call = result.map_err(|error| match error {
            ProgramCallError::Cancelled => send_error
                .unwrap_or(PartialAnswerError::Cancelled(Cancelled))
                .into_inference_error(&self.model),
            error => failed(error.to_string()),
        })?;
        for stage in program_call.stages().map_err(|error| failed(error.to_string()))? {
            recorder.record_timer(Name::from(stage.name), stage.from, stage.to);
        }
        for (name, value, unit) in &program_call.notes.values {
            recorder.record_value(Name::from(name.as_str()), *value, Unit::new(unit));
        }
        match program_call.outcome {
            ReplyOutcome::Parts(parts) => Ok(Sample { parts, source: String::new(), label: None }),
            outcome => Err(failed(format!("it replied with {outcome:?} instead of an answer"))),
        }
    }
}
