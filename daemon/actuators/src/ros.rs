//! Actuator kind `ros`, which publishes each answer on a topic of ROS 1 or ROS 2.

use peernet_clock::SharedClock;
use peernet_logger::{Name, Recorder, Unit};
use peernet_ros::messages::{StringMessage, UInt8MultiArray};
use peernet_ros::topics::{
    MessageType, RosVersion, TopicAccess, TopicError, TopicWriter, WriteOutcome, check_topic,
    check_topic_at_master,
};
use peernet_sample::Part;
use serde::{Deserialize, Serialize};

use crate::{Action, Actuator, ActuatorError, ActuatorKind, Feedback};

/// Number of messages of the answer that subscribers did not get, because the subscribers are too slow and their queues
/// are full.
const DROPPED_ANSWERS: Name = Name::from_static("dropped-answers");

/// Configuration of the actuator: `{ kind = "ros", … }`. Each part of an answer is published as a message.
///
/// Environment variables select the master of ROS 1 and the domain of ROS 2, as for every ROS node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RosActuatorConfig {
    /// Name of the topic; a relative name is below `ROS_NAMESPACE` in ROS 1.
    pub topic: String,
    /// Type of the messages. Default: `std_msgs/String`.
    #[serde(default, rename = "type")]
    pub message_type: AnswerType,
    /// ROS version, 1 or 2. Default: the value of `ROS_VERSION`, else the version of `ROS_DISTRO`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ros_version: Option<RosVersion>,
}

/// Message type of published answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum AnswerType {
    /// The text or JSON document of the answer. An answer that is not text is an error.
    #[default]
    #[serde(rename = "std_msgs/String")]
    Text,
    /// The bytes of the answer.
    #[serde(rename = "std_msgs/UInt8MultiArray")]
    Bytes,
}

impl AnswerType {
    const fn name(self) -> &'static str {
        match self {
            Self::Text => "std_msgs/String",
            Self::Bytes => "std_msgs/UInt8MultiArray",
        }
    }

    fn open(self, version: RosVersion, topic: &str, clock: &SharedClock) -> Result<TopicWriter, TopicError> {
        match self {
            Self::Text => TopicWriter::open::<StringMessage>(version, topic, clock),
            Self::Bytes => TopicWriter::open::<UInt8MultiArray>(version, topic, clock),
        }
    }
}

impl RosActuatorConfig {
    fn check_topic_and_type(&self) -> Result<(RosVersion, MessageType), ActuatorError> {
        let message_type = MessageType::try_from(self.message_type.name().to_owned())?;
        let version = check_topic(self.ros_version, &self.topic, Some(&message_type))?;
        Ok((version, message_type))
    }
}

impl ActuatorKind for RosActuatorConfig {
    /// Announces the topic now, so that subscribers are connected before the first answer is published. If the ROS
    /// master does not answer, each action tries again.
    fn build(&self, clock: &SharedClock) -> Result<Box<dyn Actuator>, ActuatorError> {
        let (version, _) = self.check_topic_and_type()?;
        let mut ros =
            RosActuator { config: self.clone(), version, clock: SharedClock::clone(clock), writer: None };
        if let Err(error) = ros.writer() {
            tracing::warn!(topic = self.topic, %error, "cannot publish answers on a topic yet; each answer tries again");
        }
        Ok(Box::new(ros))
    }

    fn facts(&self) -> Vec<(String, String)> {
        let version = self.check_topic_and_type().map(|(version, _)| version.to_string());
        let version = version.unwrap_or_else(|_| "ROS".to_owned());
        let topic = format!("{version} topic {} ({})", self.topic, self.message_type.name());
        vec![("Actuator".to_owned(), topic)]
    }

    fn check(&self, _clock: &SharedClock) -> Result<(), ActuatorError> {
        self.check_topic_and_type().map(drop)
    }

    fn try_build(&self, _clock: &SharedClock) -> Result<(), ActuatorError> {
        let (version, message_type) = self.check_topic_and_type()?;
        match check_topic_at_master(version, &self.topic, Some(&message_type), TopicAccess::Write)? {
            Some(reason) => Err(ActuatorError::NotPublished(reason)),
            None => Ok(()),
        }
    }
}

/// Actuator that publishes answers on a topic.
struct RosActuator {
    config: RosActuatorConfig,
    version: RosVersion,
    clock: SharedClock,
    /// The publisher; `None` while no master answers, and after the node of the publisher has ended.
    writer: Option<TopicWriter>,
}

impl RosActuator {
    fn writer(&mut self) -> Result<&TopicWriter, TopicError> {
        let RosActuatorConfig { topic, message_type, .. } = &self.config;
        Ok(match &mut self.writer {
            Some(writer) => writer,
            empty => empty.insert(message_type.open(self.version, topic, &self.clock)?),
        })
    }

    fn publish(&mut self, part: &Part) -> Result<WriteOutcome, ActuatorError> {
        let outcome = match self.config.message_type {
            AnswerType::Text => {
                let data = String::from_utf8(part.bytes.to_vec()).map_err(|_| self.not_text_error(part))?;
                self.writer().and_then(|writer| writer.write(&StringMessage { data }))
            }
            AnswerType::Bytes => {
                let message = UInt8MultiArray { data: part.bytes.clone(), ..UInt8MultiArray::default() };
                self.writer().and_then(|writer| writer.write(&message))
            }
        };
        if outcome.as_ref().is_err_and(TopicError::needs_reopening) {
            self.writer = None;
        }
        Ok(outcome?)
    }

    fn not_text_error(&self, part: &Part) -> ActuatorError {
        ActuatorError::NotText {
            media: part.description.media.iana().to_string(),
            topic: self.config.topic.clone(),
            bytes_type: AnswerType::Bytes.name(),
        }
    }
}

impl Actuator for RosActuator {
    fn act(&mut self, action: Action<'_>, recorder: &mut Recorder) -> Result<Feedback, ActuatorError> {
        let mut dropped = 0;
        for part in &action.answer.parts {
            dropped += self.publish(part)?.dropped;
        }
        recorder.record_value(DROPPED_ANSWERS, dropped as f64, Unit::NONE);
        Ok(Feedback::default())
    }

    fn blocks(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, SharedClock, SystemClock};

    use crate::ActuatorConfig;

    fn clock() -> SharedClock {
        Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")))
    }

    fn read(text: &str) -> Result<ActuatorConfig, String> {
        toml::from_str(text).map_err(|error| error.to_string())
    }

    #[test]
    fn unknown_type_error_lists_possible_types() {
        let error =
            read("kind = 'ros'\ntopic = '/a'\ntype = 'std_msgs/Strin'").expect_err("is no message type");
        assert!(error.contains("`std_msgs/String` or `std_msgs/UInt8MultiArray`"), "{error}");
        let error = read("kind = 'ros'\ntopic = '/a'\nros_version = 3").expect_err("is no ROS version");
        assert!(error.contains("there is no ROS 3; write 1 or 2"), "{error}");
    }

    #[test]
    fn topic_name_with_hyphen_is_refused() {
        use crate::ActuatorKind;
        let config = read("kind = 'ros'\ntopic = '/a-b'\nros_version = 1").expect("is well formed");
        let error = config.check(&clock()).expect_err("has a hyphen").to_string();
        assert!(error.contains("\"/a-b\" contains '-'"), "{error}");
        let config = read("kind = 'ros'\ntopic = '/answer'\nros_version = 1").expect("is well formed");
        config.check(&clock()).expect("is allowed");
    }
}
