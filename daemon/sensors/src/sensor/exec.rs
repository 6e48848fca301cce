//! Sensor kind `exec`: a custom program.

use std::collections::BTreeMap;

use peernet_clock::{MonoTime, SharedClock};
pub use peernet_external::exec::ExecConfig;
use peernet_external::exec::{
    CommandLine, FingerprintKey, Program, ProgramCallError, ReplyNotes, ReplyOutcome, Request, Role,
};
use peernet_logger::{Name, Recorder, Unit, stage};
use peernet_sample::Sample;

use super::{SensorConfig, SensorKind};
use crate::{Sensor, SensorError};

/// Sensor that requests each sample from a program.
struct ExecSensor {
    /// Name of the program, for messages. Its arguments are left out, because they may be secret.
    program_name: String,
    facts: Vec<(String, String)>,
    program: Program,
    resets: bool,
    /// Sequence number of the last sample, if the program numbers its samples.
    last_sequence: Option<u64>,
}

impl SensorKind for ExecConfig {
    fn open(&self, clock: &SharedClock) -> Result<Box<dyn Sensor>, SensorError> {
        let program_name = self.command.to_string();
        let facts = self.facts_for(Role::Sensor);
        let program = Program::start(self, Role::Sensor, &format!("sensor {program_name}"), clock)
            .map_err(|error| SensorError::Program { command: program_name.clone(), error })?;
        Ok(Box::new(ExecSensor { program_name, facts, program, resets: self.resets, last_sequence: None }))
    }

    fn check(&self, _clock: &SharedClock) -> Result<(), SensorError> {
        // This check does not run the program.
        self.check_for(Role::Sensor).map_err(|reason| {
            SensorError::Config(format!("cannot run the program of an exec sensor: {reason}"))
        })
    }

    fn is_program(&self) -> bool {
        true
    }

    fn arguments_fact(&self, key: &FingerprintKey) -> Option<(String, String)> {
        self.arguments_fact_for(Role::Sensor, key)
    }

    fn env_mut(&mut self) -> Option<&mut BTreeMap<String, String>> {
        Some(&mut self.env)
    }
}

impl SensorConfig {
    /// Returns the configuration of a program, given as a line for the shell.
    pub fn program(command: &str) -> Self {
        ExecConfig::new(CommandLine::Shell(command.to_owned())).into()
    }
}

impl ExecSensor {
    fn program_error(&self, error: ProgramCallError) -> SensorError {
        SensorError::Program { command: self.program_name.clone(), error }
    }

    /// Records the stages, values and dropped samples that the program reported with its sample.
    fn record_notes(&mut self, notes: &ReplyNotes, recorder: &mut Recorder, started_at: MonoTime) {
        // A program reports durations without starts, so each stage is recorded from the request on.
        for (name, span) in &notes.stages {
            recorder.record_timer(Name::from(name.as_str()), started_at, started_at + *span);
        }
        for (name, value, unit) in &notes.values {
            recorder.record_value(Name::from(name.as_str()), *value, Unit::new(unit));
        }
        if let Some(sequence) = notes.sequence {
            // Samples that the program captured and did not pass on leave gaps in its numbers. A number below the
            // expected number means that the program was restarted. How many samples it dropped is then unknown, and
            // zero is recorded.
            let next = self.last_sequence.and_then(|last| last.checked_add(1));
            let dropped = next.and_then(|next| sequence.checked_sub(next)).unwrap_or(0);
            recorder.record_value(stage::DROPPED_SAMPLES, dropped as f64, Unit::NONE);
            self.last_sequence = Some(sequence);
        }
    }
}

impl Sensor for ExecSensor {
    fn sample(&mut self, recorder: &mut Recorder) -> Result<Option<Sample>, SensorError> {
        let program_call = self.program.call(Request::Next).map_err(|error| self.program_error(error))?;
        let restart = program_call.restart_interval();
        let ReplyOutcome::Parts(parts) = program_call.outcome else { return Ok(None) };
        if let Some((from, to)) = restart {
            recorder.record_timer(stage::CAPTURE_RESTART, from, to);
        }
        self.record_notes(&program_call.notes, recorder, program_call.started_at);
        let ReplyNotes { source, label, .. } = program_call.notes;
        Ok(Some(Sample { parts, source: source.unwrap_or_default(), label }))
    }

    fn resets(&self) -> bool {
        self.resets
    }

    fn reset(&mut self) -> Result<(), SensorError> {
        self.program.reset().map_err(|error| self.program_error(error))
    }

    fn facts(&self) -> Vec<(String, String)> {
        self.facts.clone()
    }
}
