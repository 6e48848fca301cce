//! The nodes that all readers and writers of this process share.

use std::io;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, LazyLock, Weak};

use peernet_clock::SharedClock;
use tokio::runtime::{Builder, Runtime};
use tokio::sync::Mutex;

use super::TopicError;
use crate::ros1::{Environment, Node, NodeError};
use crate::ros2::{Ros2Node, Ros2Settings};

/// Runtime that serves the sockets of all nodes. It has one thread, which exists as long as the process.
// A `new_current_thread` runtime would run its tasks only while a caller blocks in it.
static RUNTIME: LazyLock<io::Result<Runtime>> =
    LazyLock::new(|| Builder::new_multi_thread().worker_threads(1).thread_name("ros").enable_all().build());

/// ROS 1 nodes that are in use.
static ROS1_NODES: Mutex<Vec<Weak<SharedNode>>> = Mutex::const_new(Vec::new());

/// ROS 2 node, while it is in use. The environment selects its domain, so one node suffices.
static ROS2_NODE: Mutex<Weak<Ros2Node>> = Mutex::const_new(Weak::new());

/// Number of ROS 1 nodes that this process has created.
static CREATED_NODES: AtomicU32 = AtomicU32::new(0);

/// Returns the runtime of the nodes.
pub(super) fn runtime() -> Result<&'static Runtime, TopicError> {
    RUNTIME.as_ref().map_err(|error| TopicError::Thread(error.to_string()))
}

/// A ROS 1 node. It unregisters when the last reader or writer that uses it is dropped. The end of the process does not
/// wait for the unregistration. The wait might not end, because a sensor that waits for a message keeps its reader, and
/// thus the node.
#[derive(Debug)]
pub(super) struct SharedNode {
    environment: Environment,
    /// Present until the shared node is dropped.
    node: Option<Node>,
}

impl Drop for SharedNode {
    fn drop(&mut self) {
        let (Some(node), Ok(runtime)) = (self.node.take(), runtime()) else { return };
        runtime.spawn(async move {
            if let Err(error) = node.shutdown().await {
                tracing::warn!(
                    %error,
                    "cannot unregister a ROS node that has ended; the master lists it until `rosnode cleanup`"
                );
            }
        });
    }
}

/// Opens a reader or writer on the node that this process has for a master. If that node has ended or already has the
/// topic, another node is used, because a ROS 1 node can have only one publisher and one subscriber of a topic.
pub(super) async fn open_on_ros1<T>(
    environment: &Environment,
    clock: &SharedClock,
    open: impl AsyncFn(&Node) -> Result<T, NodeError>,
) -> Result<(T, Arc<SharedNode>), TopicError> {
    // The lock is held until the node is open, so that concurrent callers share one node.
    let mut nodes = ROS1_NODES.lock().await;
    nodes.retain(|node| node.strong_count() > 0);
    for shared_node in
        nodes.iter().filter_map(Weak::upgrade).filter(|shared_node| shared_node.environment == *environment)
    {
        let Some(node) = &shared_node.node else { continue };
        match open(node).await {
            Ok(endpoint) => return Ok((endpoint, shared_node)),
            Err(
                NodeError::AlreadyPublished { .. }
                | NodeError::AlreadySubscribed { .. }
                | NodeError::Closed { .. },
            ) => {}
            Err(error) => return Err(error.into()),
        }
    }
    let node = Node::new(environment, &node_name(), SharedClock::clone(clock)).await?;
    let opened = open(&node).await;
    let shared_node = Arc::new(SharedNode { environment: environment.clone(), node: Some(node) });
    // The master may know the node although opening failed, such as if its answer came too late. The node is unregistered
    // when `shared_node` is dropped.
    let endpoint = opened?;
    nodes.push(Arc::downgrade(&shared_node));
    Ok((endpoint, shared_node))
}

/// Returns the ROS 2 node. It joins the domain of the environment at the first call.
pub(super) async fn ros2_node() -> Result<Arc<Ros2Node>, TopicError> {
    // The lock is held until the node has joined the domain, so that concurrent callers share one node.
    let mut shared = ROS2_NODE.lock().await;
    if let Some(node) = shared.upgrade() {
        return Ok(node);
    }
    let settings = Ros2Settings { node_name: base_name(), ..Ros2Settings::default() };
    let node = Arc::new(Ros2Node::new(settings).await?);
    for warning in node.socket_buffer_warnings() {
        tracing::warn!("{warning}");
    }
    *shared = Arc::downgrade(&node);
    Ok(node)
}

/// Returns the ROS 2 node that the readers and writers of this process share, for callers that open topics themselves.
/// The node leaves the domain when the last caller has dropped it.
///
/// # Errors
/// If the environment cannot be used, the domain cannot be joined, or this build has no ROS 2.
pub async fn shared_ros2_node() -> Result<Arc<Ros2Node>, TopicError> {
    let result = runtime()?.spawn(ros2_node()).await;
    result.map_err(|error| TopicError::Thread(error.to_string()))?
}

/// Returns the name of the next ROS 1 node. Names differ, because the master ends an older node of the same name.
fn node_name() -> String {
    let base = base_name();
    match CREATED_NODES.fetch_add(1, Ordering::Relaxed) {
        0 => base,
        earlier_count => format!("{base}_{}", earlier_count + 1),
    }
}

/// Returns a name that no other program has. It consists of `peernet`, the host's name and the process's number.
fn base_name() -> String {
    let system = rustix::system::uname();
    let host = system.nodename().to_string_lossy();
    let host: String = host.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    // ROS 2 does not allow two successive underscores.
    let words: Vec<&str> = host.split('_').filter(|word| !word.is_empty()).collect();
    format!("peernet_{}_{}", words.join("_"), std::process::id()).replace("__", "_")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::StringMessage;
    use crate::ros1::tests::{TestMaster, clock, environment, within};
    use crate::ros1::{NodeName, PublisherOptions, TopicType};

    #[test]
    fn names_of_nodes_are_allowed_and_differ() {
        let (first, second) = (node_name(), node_name());
        assert_ne!(first, second);
        for name in [first, second] {
            NodeName::new("/", &name).unwrap();
            assert!(!name.contains("__"), "{name}");
        }
    }

    #[tokio::test]
    async fn node_is_unregistered_if_its_topic_cannot_be_opened() {
        let master = TestMaster::start().await;
        let open = async |node: &Node| {
            let kind = TopicType::from_message::<StringMessage>();
            let _registered = node.publish("/t", kind, PublisherOptions::default()).await?;
            // A wildcard cannot be published.
            node.publish("/u", TopicType::any(), PublisherOptions::default()).await
        };
        open_on_ros1(&environment(&master.uri()), &clock(), open).await.expect_err("is a wildcard");
        within(master.wait_until(|master| master.publishers("/t").is_empty())).await;
    }
}
