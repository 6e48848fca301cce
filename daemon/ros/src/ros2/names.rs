//! Names of ROS 2, and their DDS names.
//!
//! Rules: <https://design.ros2.org/articles/topic_and_service_names.html>.

use super::Ros2Error;

/// Returns the absolute name of a topic, such as `/camera/image`.
///
/// A relative name is below the namespace, and a name that begins with `~/` is below the node.
///
/// # Errors
///
/// [`Ros2Error::InvalidName`] if ROS 2 does not allow the name.
pub fn absolute_topic(namespace: &str, node: &str, topic: &str) -> Result<String, Ros2Error> {
    let namespace = namespace.trim_end_matches('/');
    let absolute = if topic.starts_with('/') {
        topic.to_owned()
    } else if let Some(private) = topic.strip_prefix("~/") {
        format!("{namespace}/{node}/{private}")
    } else {
        format!("{namespace}/{topic}")
    };
    if absolute.strip_prefix('/').is_some_and(|path| path.split('/').all(is_token)) {
        Ok(absolute)
    } else {
        Err(Ros2Error::InvalidName { name: topic.to_owned(), kind: "topic", example: "/camera/image" })
    }
}

/// Returns the DDS name of a topic with this absolute name.
#[cfg(feature = "ros2")]
pub(super) fn dds_topic(absolute: &str) -> String {
    format!("rt{absolute}")
}

/// Returns the DDS name of a message type, such as `std_msgs::msg::dds_::String_` for `std_msgs/msg/String`.
///
/// # Errors
///
/// [`Ros2Error::InvalidName`] for anything but `PACKAGE/msg/TYPE` and the short form `PACKAGE/TYPE`.
pub fn dds_type(type_name: &str) -> Result<String, Ros2Error> {
    let parts: Vec<&str> = type_name.split('/').collect();
    match parts[..] {
        [package, "msg", name] | [package, name] if is_token(package) && is_token(name) => {
            Ok(format!("{package}::msg::dds_::{name}_"))
        }
        _ => Err(Ros2Error::InvalidName {
            name: type_name.to_owned(),
            kind: "message type",
            example: "sensor_msgs/msg/CompressedImage",
        }),
    }
}

/// Returns the ROS 2 name of a DDS type, or the DDS name if the type is not a ROS 2 type.
#[cfg(any(feature = "ros2", test))]
pub(super) fn ros_type(dds_type: &str) -> String {
    let message = dds_type
        .split_once("::msg::dds_::")
        .and_then(|(package, name)| Some((package, name.strip_suffix('_')?)));
    match message {
        Some((package, name)) => format!("{package}/msg/{name}"),
        None => dds_type.to_owned(),
    }
}

/// Checks the name of a node and its namespace.
///
/// # Errors
///
/// [`Ros2Error::InvalidName`] if ROS 2 does not allow the name or the namespace.
pub(super) fn check_node(namespace: &str, name: &str) -> Result<(), Ros2Error> {
    if !is_token(name) {
        return Err(Ros2Error::InvalidName { name: name.to_owned(), kind: "node", example: "peernet" });
    }
    let below_root = namespace.strip_prefix('/');
    if below_root.is_some_and(|path| path.is_empty() || path.split('/').all(is_token)) {
        Ok(())
    } else {
        Err(Ros2Error::InvalidName { name: namespace.to_owned(), kind: "namespace", example: "/robot1" })
    }
}

/// Returns whether ROS 2 allows a part of a name: letters, digits and underscores, not beginning with a digit, without
/// two successive underscores.
fn is_token(token: &str) -> bool {
    let mut characters = token.chars();
    characters.next().is_some_and(|first| first.is_ascii_alphabetic() || first == '_')
        && characters.all(|other| other.is_ascii_alphanumeric() || other == '_')
        && !token.contains("__")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topic_name_is_resolved_in_its_namespace() {
        let absolute = |namespace, topic| absolute_topic(namespace, "peernet", topic).ok();
        assert_eq!(absolute("/", "image").as_deref(), Some("/image"));
        assert_eq!(absolute("/robot1", "camera/image").as_deref(), Some("/robot1/camera/image"));
        assert_eq!(absolute("/robot1", "/image").as_deref(), Some("/image"));
        assert_eq!(absolute("/robot1", "~/image").as_deref(), Some("/robot1/peernet/image"));
        for wrong in ["", "/", "a//b", "a/", "1a", "a b", "a__b", "~", "ä"] {
            assert_eq!(absolute("/", wrong), None, "{wrong}");
        }
    }

    #[test]
    fn type_has_one_dds_name() {
        assert_eq!(dds_type("std_msgs/msg/String").ok().as_deref(), Some("std_msgs::msg::dds_::String_"));
        assert_eq!(dds_type("std_msgs/String").ok().as_deref(), Some("std_msgs::msg::dds_::String_"));
        assert_eq!(ros_type("std_msgs::msg::dds_::String_"), "std_msgs/msg/String");
        assert_eq!(ros_type("HelloWorldData::Msg"), "HelloWorldData::Msg");
        for wrong in
            ["", "String", "std_msgs/srv/String", "std_msgs/msg/", "std_msgs::msg::String", "a/msg/b/c"]
        {
            assert!(dds_type(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn node_names_are_checked() {
        assert!(check_node("/", "peernet").is_ok());
        assert!(check_node("/robot1/arm", "peernet").is_ok());
        for (namespace, name) in
            [("robot1", "peernet"), ("/robot1/", "peernet"), ("/", ""), ("/", "a/b"), ("/", "a-b")]
        {
            assert!(check_node(namespace, name).is_err(), "{namespace} {name}");
        }
    }
}
