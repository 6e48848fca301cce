//! Other publishers on the topics of a connection.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use super::interface::SessionNode;
use super::names::strip_connection_id;

/// Time for which the name of a node is awaited after the node's topics were discovered.
const NAME_DISCOVERY_TIMEOUT: Duration = Duration::from_secs(2);

/// Maximum number of second publishers that are remarked on.
const MAX_SECOND_PUBLISHERS: usize = 16;

/// Nodes other than the peer that publish on a topic of the connection. One remark is made about each node, with its
/// name if the name is known.
#[derive(Debug, Default)]
pub(super) struct SecondPublishers {
    reported: BTreeSet<Arc<str>>,
    /// Nodes without a known name, each with its topic and the time when it was found.
    unnamed: BTreeMap<Arc<str>, (String, Instant)>,
}

impl SecondPublishers {
    /// Notes that the node `second` publishes a topic of the connection between `node` and `peer`. Returns a remark
    /// about `second` at most once.
    pub(super) fn check(
        &mut self,
        second: &Arc<str>,
        topic: &str,
        (peer, node): (&str, &dyn SessionNode),
        now: Instant,
    ) -> Option<String> {
        // The number of second publishers is bounded, because every host on the network can publish the topic.
        let is_below_limit = self.reported.len() + self.unnamed.len() < MAX_SECOND_PUBLISHERS;
        if self.reported.contains(second) || !is_below_limit && !self.unnamed.contains_key(second) {
            return None;
        }
        let names = node.readable_names(second);
        // The name of a node may become known slightly later than its topics.
        let since = self.unnamed.get(second).map_or(now, |(_, since)| *since);
        if names.is_empty() && now - since < NAME_DISCOVERY_TIMEOUT {
            self.unnamed.entry(Arc::clone(second)).or_insert_with(|| (topic.to_owned(), since));
            return None;
        }
        self.unnamed.remove(second);
        // There is no remark on an earlier connection of the same pipeline, because that connection ends by itself.
        let peer_names = node.readable_names(peer);
        let peer_pipelines: BTreeSet<&str> =
            peer_names.iter().filter_map(|name| strip_connection_id(name)).collect();
        let is_earlier_connection = names
            .iter()
            .any(|name| strip_connection_id(name).is_some_and(|prefix| peer_pipelines.contains(prefix)));
        if is_earlier_connection || !self.reported.insert(Arc::clone(second)) {
            return None;
        }
        let (second, first) = (node.describe(second), node.describe(peer));
        Some(format!(
            "topic {topic} has two publishers: the messages of {second} are dropped, because the session belongs to {first}; \
             stop {second}, or give the pipeline another name"
        ))
    }

    /// Returns remarks about nodes whose names have become known or are no longer awaited.
    pub(super) fn check_unnamed(
        &mut self,
        (peer, node): (&str, &dyn SessionNode),
        now: Instant,
    ) -> Vec<String> {
        let unnamed = self.unnamed.clone();
        let remark = |(second, (topic, _)): (&Arc<str>, &(String, Instant))| {
            self.check(second, topic, (peer, node), now)
        };
        unnamed.iter().filter_map(remark).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::ros::interface::test_node::TestNode;

    const TOPIC: &str = "/line/request_info";

    #[test]
    fn second_publisher_is_remarked_once_with_or_without_name() {
        let (mut node, mut second_publishers, start) =
            (TestNode::default(), SecondPublishers::default(), Instant::now());
        for id in ["named", "unnamed"] {
            assert_eq!(second_publishers.check(&id.into(), TOPIC, ("peer", &node), start), None);
        }
        node.set_readable_name("named", "/viewer");
        let remarks = second_publishers.check_unnamed(("peer", &node), start);
        assert!(matches!(&remarks[..], [remark] if remark.contains("messages of named")), "{remarks:?}");
        let remarks = second_publishers.check_unnamed(("peer", &node), start + NAME_DISCOVERY_TIMEOUT);
        assert!(matches!(&remarks[..], [remark] if remark.contains("messages of unnamed")), "{remarks:?}");
        for id in ["named", "unnamed"] {
            assert_eq!(
                second_publishers.check(&id.into(), TOPIC, ("peer", &node), start + NAME_DISCOVERY_TIMEOUT),
                None
            );
        }
    }

    #[test]
    fn earlier_connection_of_pipeline_is_not_remarked() {
        let (mut node, mut second_publishers) = (TestNode::default(), SecondPublishers::default());
        node.set_readable_name("peer", "/peernet_jetson_line_1a2b3c4d");
        node.set_readable_name("earlier", "/peernet_jetson_line_00000000");
        node.set_readable_name("other", "/peernet_orin_line_00000000");
        let mut check =
            |id: &str| second_publishers.check(&id.into(), TOPIC, ("peer", &node), Instant::now());
        assert_eq!(check("earlier"), None);
        assert!(check("other").is_some());
    }

    #[test]
    fn number_of_remarks_is_bounded() {
        let (mut node, mut second_publishers) = (TestNode::default(), SecondPublishers::default());
        let ids: Vec<String> = (0..=MAX_SECOND_PUBLISHERS).map(|number| format!("n{number}")).collect();
        ids.iter().for_each(|id| node.set_readable_name(id, "/viewer"));
        let check = |id: &String| {
            second_publishers.check(&id.as_str().into(), TOPIC, ("peer", &node), Instant::now())
        };
        assert_eq!(ids.iter().filter_map(check).count(), MAX_SECOND_PUBLISHERS);
    }
}
