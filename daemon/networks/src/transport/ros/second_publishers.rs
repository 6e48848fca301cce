//! Other publishers on the topics of a connection.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use super::interface::SessionNode;
use super::names::without_connection;

/// Time in which the name of a node becomes known once its topics are.
const NAME_TIMEOUT: Duration = Duration::from_secs(2);

/// Largest number of second publishers that are remarked.
const MAX_SECOND_PUBLISHERS: usize = 16;

/// Nodes other than the peer that publish on a topic of the connection. Each is remarked once, by its name where that is known.
#[derive(Debug, Default)]
pub(super) struct SecondPublishers {
    remarked: BTreeSet<Arc<str>>,
    /// Those without a known name, each with its topic and the time since when.
    unnamed: BTreeMap<Arc<str>, (String, Instant)>,
}

impl SecondPublishers {
    /// Notes a node that publishes a topic of the connection to `peer`. Returns the remark on it, once.
    pub(super) fn note(
        &mut self,
        second: &Arc<str>,
        topic: &str,
        peer: &str,
        node: &dyn SessionNode,
    ) -> Option<String> {
        let has_room = self.remarked.len() + self.unnamed.len() < MAX_SECOND_PUBLISHERS;
        if self.remarked.contains(second) || !has_room && !self.unnamed.contains_key(second) {
            return None;
        }
        let names = node.names(second);
        // Its name may be known a little later than its topics.
        let since = self.unnamed.get(second).map_or_else(Instant::now, |(_, since)| *since);
        if names.is_empty() && since.elapsed() < NAME_TIMEOUT {
            self.unnamed.entry(Arc::clone(second)).or_insert_with(|| (topic.to_owned(), since));
            return None;
        }
        self.unnamed.remove(second);
        // An earlier connection of the same pipeline ends by itself.
        let own = node.names(peer);
        let own: BTreeSet<&str> = own.iter().filter_map(|name| without_connection(name)).collect();
        let is_earlier = names.iter().any(|name| without_connection(name).is_some_and(|of| own.contains(of)));
        if is_earlier || !self.remarked.insert(Arc::clone(second)) {
            return None;
        }
        let (second, first) = (node.describe(second), node.describe(peer));
        Some(format!(
            "topic {topic} has two publishers: the messages of {second} are dropped, because the session is that of {first}; \
             stop the former, or give the pipeline another name"
        ))
    }

    /// Returns the remarks on nodes whose names have become known, or are not awaited any longer.
    pub(super) fn note_names(&mut self, peer: &str, node: &dyn SessionNode) -> Vec<String> {
        let unnamed = self.unnamed.clone();
        unnamed.iter().filter_map(|(second, (topic, _))| self.note(second, topic, peer, node)).collect()
    }
}
