//! Checks of a topic before it is opened.

use std::env;

use super::nodes::runtime;
use super::{MessageType, RosVersion, TopicError};
use crate::ros1::{self, Environment, NodeName};
use crate::ros2::{self, Ros2Error, Ros2Settings};

/// Purpose for which a topic is opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TopicAccess {
    /// Messages are read.
    Read,
    /// Messages are published.
    Write,
}

/// Checks the names, the environment variables, and whether this build supports the version of ROS. Does not use the
/// network. Returns the version.
///
/// # Errors
/// The first problem that is found.
pub fn check_topic(
    configured: Option<RosVersion>,
    topic: &str,
    message_type: Option<&MessageType>,
) -> Result<RosVersion, TopicError> {
    let version = RosVersion::resolve(configured, |name| env::var(name).ok())?;
    let topic = check_name(version, topic)?;
    if version == RosVersion::Ros2 && message_type.is_none() {
        return Err(TopicError::TypeRequired { topic });
    }
    Ok(version)
}

/// Checks the name of a topic, the environment variables, and whether this build supports the version of ROS. Does not
/// use the network. Returns the absolute name.
///
/// # Errors
/// The first problem that is found.
pub fn check_name(version: RosVersion, topic: &str) -> Result<String, TopicError> {
    match version {
        RosVersion::Ros1 => {
            let environment = Environment::from_process()?;
            // The node's name only matters for names that begin with `~`.
            Ok(NodeName::new(&environment.namespace, "peernet")?.resolve(topic)?)
        }
        RosVersion::Ros2 => {
            if !ros2::IS_BUILT {
                return Err(Ros2Error::NotBuilt.into());
            }
            let settings = Ros2Settings::default().with_environment(|name| env::var(name).ok())?;
            Ok(ros2::absolute_topic(&settings.namespace, &settings.node_name, topic)?)
        }
    }
}

/// Asks the ROS 1 master about a topic. Returns the reason why no messages can be exchanged at present; `None` if there
/// is no such reason. ROS 2 has no master, so nothing is checked. Blocks for a few seconds at most.
///
/// # Errors
/// If the environment cannot be used, or no master answers.
pub fn check_topic_at_master(
    version: RosVersion,
    topic: &str,
    message_type: Option<&MessageType>,
    access: TopicAccess,
) -> Result<Option<String>, TopicError> {
    if version == RosVersion::Ros2 {
        return Ok(None);
    }
    let environment = Environment::from_process()?;
    let topic = NodeName::new(&environment.namespace, "peernet")?.resolve(topic)?;
    let topics = runtime()?.block_on(ros1::topic_types(&environment))?;
    let known_type = topics.iter().find(|(name, _)| *name == topic).map(|(_, kind)| kind.as_str());
    let master = environment.master;
    Ok(match (known_type, message_type) {
        // The master knows the type as `*` if a node has subscribed to any type.
        (Some(kind), Some(message_type)) if kind != message_type.as_str() && kind != "*" => Some(format!(
            "topic {topic} has the type {kind}, not {message_type}, according to the ROS master at {master}"
        )),
        (None, _) if access == TopicAccess::Read => Some(format!(
            "the ROS master at {master} does not know topic {topic} yet; {}",
            list_topics(topics.iter().map(|(name, _)| name.as_str()))
        )),
        _ => None,
    })
}

/// Maximum number of listed topics.
const MAX_LISTED_TOPICS: usize = 8;

/// Returns a text that lists the existing topics.
pub(super) fn list_topics<'a>(topics: impl Iterator<Item = &'a str>) -> String {
    let mut names: Vec<&str> = topics.collect();
    if names.is_empty() {
        return "it knows no topic at all".to_owned();
    }
    names.sort_unstable();
    let ellipsis = if names.len() > MAX_LISTED_TOPICS { ", …" } else { "" };
    names.truncate(MAX_LISTED_TOPICS);
    format!("it knows {}{ellipsis}", names.join(", "))
}
