//! Actuator kind `socket`, which sends each answer as a line of JSON to a robot's controller, over UDP or TCP.

mod address;
mod connection;
mod line;
#[cfg(test)]
mod tests;

pub use address::SocketAddress;

use std::num::NonZeroU64;

use peernet_clock::{SharedClock, Span};
use peernet_external::process::MAX_TIMEOUT_MS;
use peernet_logger::Recorder;
use serde::{Deserialize, Serialize};

use crate::{Action, Actuator, ActuatorError, ActuatorKind, Feedback, SocketError};
use connection::{Connection, Deadline};

/// Configuration of the actuator: `{ kind = "socket", address = "udp://10.0.0.5:9000" }`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SocketConfig {
    /// Address of the controller: `udp://host:port` or `tcp://host:port`.
    pub address: SocketAddress,
    /// `true` if the controller replies to each line with a line of feedback. Default: `false`.
    #[serde(default)]
    pub feedback: bool,
    /// Maximum duration of an action, which includes connecting and feedback; milliseconds, up to one day. Default:
    /// 1000.
    #[serde(default = "one_second")]
    pub timeout_ms: NonZeroU64,
}

const fn one_second() -> NonZeroU64 {
    NonZeroU64::new(1000).expect("above 0")
}

impl SocketConfig {
    fn unconnected_actuator(&self, clock: &SharedClock) -> SocketActuator {
        SocketActuator { config: self.clone(), clock: SharedClock::clone(clock), connection: None }
    }
}

impl ActuatorKind for SocketConfig {
    /// Connects now, so that the first action does not wait for the connection. If connecting fails, each action tries
    /// again.
    fn build(&self, clock: &SharedClock) -> Result<Box<dyn Actuator>, ActuatorError> {
        self.check(clock)?;
        let mut socket = self.unconnected_actuator(clock);
        match Connection::open(&self.address, &socket.deadline()) {
            Ok(connection) => socket.connection = Some(connection),
            Err(error) => {
                tracing::warn!(%error, "cannot send answers to a controller yet; each answer tries again");
            }
        }
        Ok(Box::new(socket))
    }

    /// Resolves the controller's host. Over TCP also connects, and closes the connection without sending a line.
    fn try_build(&self, clock: &SharedClock) -> Result<(), ActuatorError> {
        self.check(clock)?;
        Ok(Connection::open(&self.address, &self.unconnected_actuator(clock).deadline()).map(drop)?)
    }

    fn ends_episodes(&self) -> bool {
        self.feedback
    }

    fn facts(&self) -> Vec<(String, String)> {
        let feedback = if self.feedback { ", with feedback" } else { "" };
        vec![("Actuator".to_owned(), format!("{}{feedback}", self.address))]
    }

    fn check(&self, _clock: &SharedClock) -> Result<(), ActuatorError> {
        if self.timeout_ms.get() > MAX_TIMEOUT_MS {
            return Err(SocketError::Timeout { timeout_ms: self.timeout_ms }.into());
        }
        Ok(())
    }
}

/// Actuator that sends lines to a controller. It opens a new connection after a failure.
struct SocketActuator {
    config: SocketConfig,
    clock: SharedClock,
    /// `None` after a failure, so that late feedback on the old connection is not taken for the feedback on a later
    /// action.
    connection: Option<Connection>,
}

impl SocketActuator {
    /// Returns the deadline of an action that begins now.
    fn deadline(&self) -> Deadline {
        let timeout_ms = self.config.timeout_ms;
        let until = self.clock.mono() + Span::from_millis(timeout_ms.get().cast_signed());
        Deadline { clock: SharedClock::clone(&self.clock), until, timeout_ms }
    }

    fn send(&mut self, action: &Action<'_>) -> Result<Feedback, SocketError> {
        let line = line::encode(action)?;
        let deadline = self.deadline();
        // `take()` removes the connection, so that each failure below leaves none.
        let open_connection = match self.connection.take() {
            Some(mut connection) => {
                let is_open = connection.discard_unsolicited(self.config.feedback)?;
                is_open.then_some(connection)
            }
            None => None,
        };
        let mut connection = match open_connection {
            Some(connection) => connection,
            None => Connection::open(&self.config.address, &deadline)?,
        };
        connection.send(&line, &deadline)?;
        let feedback = if self.config.feedback {
            connection.receive_feedback(action.iteration, &deadline)?
        } else {
            Feedback::default()
        };
        self.connection = Some(connection);
        Ok(feedback)
    }
}

impl Actuator for SocketActuator {
    fn act(&mut self, action: Action<'_>, _recorder: &mut Recorder) -> Result<Feedback, ActuatorError> {
        Ok(self.send(&action)?)
    }

    fn blocks(&self) -> bool {
        true
    }
}
