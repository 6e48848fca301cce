//! Actuator kind `exec`, which passes each answer to a custom program.

use std::collections::BTreeMap;

use peernet_clock::SharedClock;
pub use peernet_external::exec::ExecConfig;
use peernet_external::exec::{FingerprintKey, Program, ProgramCallError, ReplyNotes, Request, Role};
use peernet_logger::{Name, Recorder, Unit, stage};

use crate::{Action, Actuator, ActuatorError, ActuatorKind, Feedback};

/// Actuator that passes each answer to a program, which replies after it has acted.
struct ExecActuator {
    command: String,
    program: Program,
    resets: bool,
}

impl ActuatorKind for ExecConfig {
    fn build(&self, clock: &SharedClock) -> Result<Box<dyn Actuator>, ActuatorError> {
        let command = self.command.to_string();
        match Program::start(self, Role::Actuator, &format!("actuator {command}"), clock) {
            Ok(program) => Ok(Box::new(ExecActuator { command, program, resets: self.resets })),
            Err(error) => Err(ActuatorError::Program { command, error }),
        }
    }

    // Any reply may end the episode, and the configuration does not say whether the program ever sends such a reply.
    fn ends_episodes(&self) -> bool {
        true
    }

    fn facts(&self) -> Vec<(String, String)> {
        self.facts_for(Role::Actuator)
    }

    fn is_program(&self) -> bool {
        true
    }

    fn arguments_fact(&self, key: &FingerprintKey) -> Option<(String, String)> {
        self.arguments_fact_for(Role::Actuator, key)
    }

    fn env_mut(&mut self) -> Option<&mut BTreeMap<String, String>> {
        Some(&mut self.env)
    }

    fn check(&self, _clock: &SharedClock) -> Result<(), ActuatorError> {
        // This check does not run the program.
        self.check_for(Role::Actuator).map_err(ActuatorError::Command)
    }
}

impl ExecActuator {
    fn program_error(&self, error: ProgramCallError) -> ActuatorError {
        ActuatorError::Program { command: self.command.clone(), error }
    }
}

impl Actuator for ExecActuator {
    fn act(&mut self, action: Action<'_>, recorder: &mut Recorder) -> Result<Feedback, ActuatorError> {
        let request = Request::Answer { answer: action.answer, source: action.source };
        let program_call = self.program.call(request).map_err(|error| self.program_error(error))?;
        // Each stage is a part of the action and cannot be longer than the call.
        program_call.check_stages_of_action().map_err(|error| self.program_error(error))?;
        if let Some((from, to)) = program_call.restart_interval() {
            recorder.record_timer(stage::ACTUATION_RESTART, from, to);
        }
        // A program reports durations without starts, so each stage is recorded from the request on.
        for (name, span) in &program_call.notes.stages {
            recorder.record_timer(
                Name::from(name.as_str()),
                program_call.started_at,
                program_call.started_at + *span,
            );
        }
        for (name, value, unit) in &program_call.notes.values {
            recorder.record_value(Name::from(name.as_str()), *value, Unit::new(unit));
        }
        let ReplyNotes { reward, success, episode_ended, .. } = program_call.notes;
        Ok(Feedback { episode_ended, success, reward })
    }

    fn resets(&self) -> bool {
        self.resets
    }

    fn reset(&mut self) -> Result<(), ActuatorError> {
        self.program.reset().map_err(|error| self.program_error(error))
    }

    fn blocks(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, SystemClock};
    use peernet_external::exec::CommandLine;
    use peernet_logger::HostId;
    use peernet_sample::{Description, MediaType, Sample};

    use crate::ActuatorConfig;

    use super::*;

    #[test]
    fn program_gets_answer_and_its_failure_is_returned() {
        let folder = tempfile::tempdir().expect("can be made");
        let file = folder.path().join("answers");
        let script = format!(
            "while read -r word bytes media shape source; do \
             echo \"$word $media $source: $(head -c \"$bytes\")\" >> {}; \
             if [ \"$source\" = wall ]; then echo error too close; else echo value force 2.5 N; echo done; fi; done",
            file.display()
        );
        let config = ActuatorConfig::Exec(ExecConfig::new(CommandLine::Shell(script)));
        let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")));
        let mut actuator = config.build(&clock).expect("sh is there");
        assert!(actuator.blocks());
        let mut recorder = Recorder::new(SharedClock::clone(&clock), HostId::random());
        let answer = Sample::from_part(Description::unshaped(MediaType::Text), "left".into());
        actuator.act(Action::first(&answer, "door"), &mut recorder).expect("acts");
        assert_eq!(recorder.tree().find(&["force"]).and_then(|(_, node)| node.measure.value()), Some(2.5));
        let error = actuator
            .act(Action::first(&answer, "wall"), &mut recorder)
            .expect_err("the program reports an error")
            .to_string();
        assert!(error.contains("too close"), "{error}");
        let written = std::fs::read_to_string(&file).expect("was written");
        assert_eq!(written, "answer text/plain door: left\nanswer text/plain wall: left\n");
    }

    #[test]
    fn restart_of_program_is_recorded() {
        let script = "sleep 0.3; while read -r word bytes rest; do \
                      case $(head -c \"$bytes\") in die) exit 4;; esac; echo done; done";
        let config = ActuatorConfig::Exec(ExecConfig::new(CommandLine::Shell(script.to_owned())));
        let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")));
        let mut actuator = config.build(&clock).expect("sh is there");
        for (answer, acts, restarted) in
            [("go", true, false), ("die", false, false), ("go", true, true), ("go", true, false)]
        {
            let mut recorder = Recorder::new(SharedClock::clone(&clock), HostId::random());
            let answer = Sample::from_part(Description::unshaped(MediaType::Text), answer.into());
            assert_eq!(actuator.act(Action::first(&answer, "door"), &mut recorder).is_ok(), acts);
            let restart_seconds =
                recorder.tree().find(&["actuation-restart"]).and_then(|(_, node)| node.measure.value());
            assert_eq!(
                restart_seconds.is_some_and(|seconds| seconds >= 0.3),
                restarted,
                "{restart_seconds:?}"
            );
        }
    }

    #[test]
    fn program_reports_reward_success_and_end() {
        let script = "n=0; while read -r word bytes rest; do head -c \"$bytes\" > /dev/null; n=$((n + 1)); \
                      echo reward 0.$n; if [ $n = 2 ]; then echo success 1; echo episode-ended; fi; echo done; done";
        let config = ActuatorConfig::Exec(ExecConfig::new(CommandLine::Shell(script.to_owned())));
        let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")));
        let mut actuator = config.build(&clock).expect("sh is there");
        let answer = Sample::from_part(Description::unshaped(MediaType::Text), "left".into());
        let mut act = || {
            let mut recorder = Recorder::new(SharedClock::clone(&clock), HostId::random());
            actuator.act(Action::first(&answer, "door"), &mut recorder).expect("acts")
        };
        assert_eq!(act(), Feedback { reward: Some(0.1), ..Feedback::default() });
        assert_eq!(act(), Feedback { episode_ended: true, success: Some(true), reward: Some(0.2) });
    }

    #[test]
    fn stage_longer_than_action_is_refused() {
        let script = "while read -r word bytes rest; do head -c \"$bytes\" > /dev/null; echo stage grip 1000; echo done; done";
        let config = ActuatorConfig::Exec(ExecConfig::new(CommandLine::Shell(script.to_owned())));
        let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")));
        let mut actuator = config.build(&clock).expect("sh is there");
        let mut recorder = Recorder::new(SharedClock::clone(&clock), HostId::random());
        let answer = Sample::from_part(Description::unshaped(MediaType::Text), "left".into());
        let error =
            actuator.act(Action::first(&answer, "door"), &mut recorder).expect_err("too long").to_string();
        assert!(
            error.contains("the stage grip that it reported takes 1000s, but it replied within "),
            "{error}"
        );
        assert!(recorder.tree().find(&["grip"]).is_none());
    }

    #[test]
    fn program_is_reset_again_after_failed_reset() {
        let script = "n=0; while read -r word bytes rest; do case $word in \
                      reset) n=$((n + 1)); if [ $n = 2 ]; then echo error the gripper is stuck; continue; fi;; \
                      *) head -c \"$bytes\" > /dev/null; echo reward $n;; esac; echo done; done";
        let exec = ExecConfig { resets: true, ..ExecConfig::new(CommandLine::Shell(script.to_owned())) };
        let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")));
        let mut actuator = ActuatorConfig::Exec(exec).build(&clock).expect("sh is there");
        assert!(actuator.resets());
        let answer = Sample::from_part(Description::unshaped(MediaType::Text), "left".into());
        actuator.reset().expect("is reset");
        let error = actuator.reset().expect_err("is stuck").to_string();
        assert!(error.contains("the gripper is stuck"), "{error}");
        actuator.reset().expect("a later reset may succeed");
        let mut recorder = Recorder::new(SharedClock::clone(&clock), HostId::random());
        let feedback = actuator.act(Action::first(&answer, "door"), &mut recorder).expect("acts");
        assert_eq!(feedback.reward, Some(3.0));
    }

    #[test]
    fn program_and_script_are_recorded_with_hashes() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("my arm.sh"), "abc").expect("writable");
        let command = CommandLine::Shell("sh 'my arm.sh'".to_owned());
        let config = ExecConfig { folder: Some(folder.path().to_owned()), ..ExecConfig::new(command) };
        let facts = ActuatorConfig::Exec(config).facts();
        assert_eq!(facts[0], ("Actuator".to_owned(), "the program sh".to_owned()));
        assert_eq!(facts[1].0, "Actuator files");
        assert!(facts[1].1.contains("/my arm.sh SHA-256 ba7816bf"), "{facts:?}");
    }

    #[test]
    fn missing_command_is_found_by_check() {
        let config = ExecConfig::new(CommandLine::Words(vec!["no-such-program-anywhere".to_owned()]));
        let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")));
        let config = ActuatorConfig::Exec(config);
        let error = config.check(&clock).expect_err("is not there").to_string();
        assert!(error.contains("no-such-program-anywhere"), "{error}");
        assert_eq!(
            config.try_build(&clock).expect_err("is not there").to_string(),
            error,
            "try_build() finds the same error"
        );
    }
}
