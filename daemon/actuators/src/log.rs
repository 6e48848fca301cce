//! Actuator kind `log`, which writes each answer to the log.

use peernet_clock::SharedClock;
use peernet_logger::Recorder;
use peernet_sample::Classification;
use serde::{Deserialize, Serialize};

use crate::{Action, Actuator, ActuatorError, ActuatorKind, Feedback};

/// Configuration of the actuator: `{ kind = "log" }`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogActuatorConfig {}

impl ActuatorKind for LogActuatorConfig {
    fn build(&self, _clock: &SharedClock) -> Result<Box<dyn Actuator>, ActuatorError> {
        Ok(Box::new(LogActuator))
    }

    fn facts(&self) -> Vec<(String, String)> {
        vec![("Actuator".to_owned(), "log".to_owned())]
    }
}

/// Actuator that logs one line per answer: label and score of a classification, and the size of any other answer.
struct LogActuator;

impl Actuator for LogActuator {
    fn act(&mut self, action: Action<'_>, _recorder: &mut Recorder) -> Result<Feedback, ActuatorError> {
        let Action { answer, source, .. } = action;
        match answer.classification() {
            Some(Classification { label, score }) => tracing::info!(source, label, score, "answer"),
            None => tracing::info!(source, bytes = answer.payload_bytes(), "answer"),
        }
        Ok(Feedback::default())
    }
}

#[cfg(test)]
mod tests {
    use std::io::{self, Write};
    use std::sync::{Arc, Mutex};

    use peernet_clock::{ClockIdentity, ManualClock, WallTime};
    use peernet_logger::HostId;
    use peernet_sample::{Description, MediaType, Sample};

    use super::*;

    /// Log output that the test can read.
    #[derive(Clone, Default)]
    struct LogBuffer(Arc<Mutex<Vec<u8>>>);

    impl Write for LogBuffer {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().expect("no test panics while writing").extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn log_output(answer: &Sample) -> String {
        let clock = ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("b", "c"));
        let clock: SharedClock = Arc::new(clock);
        let mut actuator = LogActuatorConfig {}.build(&clock).expect("needs nothing");
        let mut recorder = Recorder::new(clock, HostId::random());
        let buffer = LogBuffer::default();
        let writer = buffer.clone();
        let subscriber =
            tracing_subscriber::fmt().with_ansi(false).with_writer(move || writer.clone()).finish();
        tracing::subscriber::with_default(subscriber, || {
            actuator.act(Action::first(answer, "part-1.jpg"), &mut recorder).expect("only logs");
        });
        let text = buffer.0.lock().expect("no test panics while writing").clone();
        String::from_utf8(text).expect("is text")
    }

    #[test]
    fn log_shows_label_or_size_of_answer() {
        let json = |text: &'static str| {
            Sample::from_part(Description::unshaped(MediaType::Json), text.as_bytes().into())
        };
        let line =
            log_output(&json(r#"{"label":"dented","score":0.98,"top":[{"label":"dented","score":0.98}]}"#));
        for part in ["INFO", "part-1.jpg", "dented", "0.98"] {
            assert!(line.contains(part), "{line}");
        }
        assert!(log_output(&json(r#"{"boxes":[]}"#)).contains("bytes=12"));
        assert!(log_output(&json("{")).contains("bytes=1"));
        assert!(log_output(&Sample::from_part(Description::bytes(), vec![0; 5].into())).contains("bytes=5"));
    }
}
