//! Names of message types.

use std::fmt;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Name of a message type, such as `sensor_msgs/Image`. The form of ROS 2, `sensor_msgs/msg/Image`, is accepted as
/// well.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct MessageType {
    name: String,
}

/// Error: the text cannot be the name of a message type.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`{0}` is not the name of a ROS message type; write PACKAGE/TYPE, such as sensor_msgs/Image")]
pub struct InvalidMessageType(String);

impl MessageType {
    /// Returns the name with one slash, as in ROS 1.
    pub fn as_str(&self) -> &str {
        &self.name
    }
}

impl TryFrom<String> for MessageType {
    type Error = InvalidMessageType;

    fn try_from(text: String) -> Result<Self, InvalidMessageType> {
        let parts: Vec<&str> = text.split('/').collect();
        let is_name = |part: &str| {
            part.starts_with(|first: char| first.is_ascii_alphabetic())
                && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        };
        match parts[..] {
            [package, "msg", name] | [package, name] if is_name(package) && is_name(name) => {
                Ok(Self { name: format!("{package}/{name}") })
            }
            _ => Err(InvalidMessageType(text)),
        }
    }
}

impl From<MessageType> for String {
    fn from(message_type: MessageType) -> Self {
        message_type.name
    }
}

impl fmt::Display for MessageType {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_name_one_type() {
        let parse = |text: &str| MessageType::try_from(text.to_owned());
        assert_eq!(parse("sensor_msgs/msg/Image"), parse("sensor_msgs/Image"));
        assert_eq!(parse("sensor_msgs/Image").unwrap().as_str(), "sensor_msgs/Image");
        for wrong in ["", "Image", "a/b/c", "sensor_msgs/", "sensor msgs/Image", "*", "1a/B"] {
            assert_eq!(parse(wrong), Err(InvalidMessageType(wrong.to_owned())));
        }
    }
}
