//! Names of nodes and topics.

/// Returns the node name of a cloud, without namespace.
pub(super) fn cloud_node(name: &str) -> String {
    format!("peernet_{name}")
}

/// Returns the topic on which edges ask a cloud for connections.
pub(super) fn sessions_topic(name: &str) -> String {
    format!("/{name}/sessions")
}

/// Returns the topic on which a cloud refuses connections.
pub(super) fn refusals_topic(name: &str) -> String {
    format!("/{name}/refusals")
}

/// Returns the first part of the names of an edge's nodes for a pipeline, without namespace. The rest of such a name
/// is the first eight digits of the connection's identifier.
pub(super) fn edge_node_prefix(host: &str, pipeline: &str) -> String {
    format!("peernet_{}_{}_", to_ros_name(host), to_ros_name(pipeline))
}

/// Returns the name of an edge's node without the identifier of its connection; `None` for other nodes.
pub(super) fn strip_connection_id(node: &str) -> Option<&str> {
    let (prefix, identifier) = node.rsplit_once('_')?;
    let is_edge = base_name(prefix).starts_with("peernet_") && identifier.len() == 8;
    (is_edge && identifier.bytes().all(|digit| digit.is_ascii_hexdigit())).then_some(prefix)
}

/// Replaces all characters that are not allowed in a ROS name by underscores. Returns the result.
pub(super) fn to_ros_name(text: &str) -> String {
    let replace = |char: char| if char.is_ascii_alphanumeric() { char } else { '_' };
    let replaced: String = text.chars().map(replace).collect();
    // A name in ROS does not begin with a digit, and a name in ROS 1 begins with a letter.
    match replaced.starts_with(|first: char| first.is_ascii_alphabetic()) {
        true => replaced,
        false => format!("p{replaced}"),
    }
}

/// Returns the last part of a global name.
pub(super) fn base_name(name: &str) -> &str {
    name.rsplit_once('/').map_or(name, |(_, base)| base)
}

/// The topics of a pipeline in one direction.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct TopicPair {
    /// Topic of the payloads.
    pub(super) payload: String,
    /// Topic of the companions.
    pub(super) info: String,
}

impl TopicPair {
    /// Returns the topics from the edge to the cloud.
    pub(super) fn request(pipeline: &str) -> Self {
        Self::new(pipeline, "request")
    }

    /// Returns the topics from the cloud to the edge.
    pub(super) fn response(pipeline: &str) -> Self {
        Self::new(pipeline, "response")
    }

    fn new(pipeline: &str, direction: &str) -> Self {
        let payload = format!("{pipeline}/{direction}");
        Self { info: format!("{payload}_info"), payload }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_contain_only_allowed_characters() {
        assert_eq!(to_ros_name("quality-control.2"), "quality_control_2");
        assert_eq!(to_ros_name("2nd"), "p2nd");
        assert_eq!(edge_node_prefix("jetson-orin", "line"), "peernet_jetson_orin_line_");
        assert_eq!(base_name("/robot/peernet_gpu"), cloud_node("gpu"));
        let (first, second) = ("/peernet_jetson_line_1a2b3c4d", "/peernet_jetson_line_00000000");
        assert_eq!(strip_connection_id(first), strip_connection_id(second));
        for other in ["/peernet_gpu", "/viewer_1a2b3c4d", "/peernet_jetson_line_nothex00"] {
            assert_eq!(strip_connection_id(other), None, "{other}");
        }
        let topics = TopicPair::request("/robot/line");
        assert_eq!((&*topics.payload, &*topics.info), ("/robot/line/request", "/robot/line/request_info"));
    }
}
