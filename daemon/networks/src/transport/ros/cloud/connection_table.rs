//! The connections of a cloud, and the rules by which the cloud opens further connections, without I/O.
//!
//! A pipeline has at most one connection. A new connection from the same host replaces the earlier connection; a
//! connection from another host is refused, because robots that shared topics would receive each other's answers.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_ros::messages::SessionHello;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::transport::ros::channel::Channel;
use crate::transport::{AddressGroup, ConnectionId};

/// Rights of a connection, derived from its sessions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Admission {
    /// The connection has no session.
    Unadmitted,
    /// The connection's request for a session is being decided.
    Greeted,
    /// The connection has a session.
    Admitted,
}

/// Connections of a cloud: at most one for each pipeline, in bounded number.
#[derive(Debug)]
pub(super) struct ConnectionTable {
    max_connections: usize,
    /// Maximum number of connections without a session.
    max_unadmitted: usize,
    table: Mutex<Table>,
}

#[derive(Debug, Default)]
struct Table {
    next_id: u64,
    /// Connections by the global names of their pipelines.
    connections: BTreeMap<String, Arc<CloudConnection>>,
}

/// Result of a request for a connection.
#[derive(Debug)]
pub(super) enum OpenOutcome {
    /// An earlier request has opened the connection.
    Repeated,
    /// The connection must not be opened now, for this reason.
    Refused(&'static str),
    /// The connection was added to the table. Its topics must be opened next.
    Started {
        connection: Arc<CloudConnection>,
        /// The pipeline's earlier connection, which was aborted.
        replaced: Option<Arc<CloudConnection>>,
    },
}

impl ConnectionTable {
    pub(super) fn new(max_connections: usize, max_unadmitted: usize) -> Self {
        Self { max_connections, max_unadmitted, table: Mutex::default() }
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds the connection that an edge requests, if the limits allow it. `abort` is the token that ends the
    /// connection.
    pub(super) fn open(
        &self,
        hello: &SessionHello,
        group: AddressGroup,
        abort: CancellationToken,
    ) -> OpenOutcome {
        let mut table = self.table();
        let earlier = table.connections.get(&hello.pipeline).cloned();
        // Edges repeat their request until they have the answer.
        if earlier.as_ref().is_some_and(|connection| connection.identifier == hello.header.frame_id) {
            return OpenOutcome::Repeated;
        }
        if let Some(reason) = self.find_refusal_reason(&table, earlier.as_deref(), &hello.host, group) {
            return OpenOutcome::Refused(reason);
        }
        let connection = Arc::new(CloudConnection {
            id: ConnectionId(table.next_id),
            identifier: hello.header.frame_id.clone(),
            host: hello.host.clone(),
            group,
            channel: Mutex::default(),
            admission: watch::Sender::new(Admission::Unadmitted),
            abort,
            ended: CancellationToken::new(),
        });
        table.next_id += 1;
        table.connections.insert(hello.pipeline.clone(), Arc::clone(&connection));
        if let Some(earlier) = &earlier {
            // Both connections use the same topics, so the earlier connection must close its topics first.
            earlier.abort.cancel();
        }
        OpenOutcome::Started { connection, replaced: earlier }
    }

    /// Returns the text of the refusal if another host uses the topics, or if one more connection would exceed a limit.
    /// `None` if the connection may be opened. `earlier` is the pipeline's earlier connection.
    fn find_refusal_reason(
        &self,
        table: &Table,
        earlier: Option<&CloudConnection>,
        host: &str,
        group: AddressGroup,
    ) -> Option<&'static str> {
        if let Some(earlier) = earlier {
            // A host may replace its connection only from the same address, because any node can claim the id of a
            // host.
            let is_same_host = earlier.host == host && earlier.group == group;
            return (!is_same_host).then_some(
                "another host uses the topics of this pipeline, and keeps them until its connection has ended; give one of \
                 the pipelines another name, or set ROS_NAMESPACE to a namespace of each robot",
            );
        }
        let is_unadmitted =
            |connection: &&Arc<CloudConnection>| *connection.admission.borrow() != Admission::Admitted;
        let (mut unadmitted, mut unadmitted_in_group) = (0, 0);
        for connection in table.connections.values().filter(is_unadmitted) {
            unadmitted += 1;
            unadmitted_in_group += usize::from(connection.group == group);
        }
        if table.connections.len() >= self.max_connections {
            Some("the cloud has too many connections; raise its limit of open files (LimitNOFILE)")
        } else if unadmitted >= self.max_unadmitted.max(1)
            || unadmitted_in_group >= (self.max_unadmitted / 2).max(1)
        {
            // One address may have half of the connections without a session, so that others can open some.
            Some("too many other connections have no session yet; try again later")
        } else {
            None
        }
    }

    /// Returns the connection with this number.
    pub(super) fn find(&self, id: ConnectionId) -> Option<Arc<CloudConnection>> {
        self.table().connections.values().find(|connection| connection.id == id).cloned()
    }

    /// Removes a connection that has ended, unless another connection has its topics already.
    pub(super) fn remove(&self, pipeline: &str, connection: &Arc<CloudConnection>) {
        let mut table = self.table();
        // The topics may belong to a newer connection of the pipeline by now.
        if table.connections.get(pipeline).is_some_and(|current| Arc::ptr_eq(current, connection)) {
            table.connections.remove(pipeline);
        }
    }
}

/// A connection of a cloud.
#[derive(Debug)]
pub(super) struct CloudConnection {
    id: ConnectionId,
    /// Random identifier that the edge gave the connection.
    identifier: String,
    /// Host of the edge.
    host: String,
    /// Group of the edge's address.
    group: AddressGroup,
    /// This end of the connection, while its topics are open.
    channel: Mutex<Option<Arc<Channel>>>,
    admission: watch::Sender<Admission>,
    /// Token that ends the connection without a goodbye.
    abort: CancellationToken,
    /// Token that is cancelled once the topics are closed.
    ended: CancellationToken,
}

impl CloudConnection {
    /// Returns the number of the connection.
    pub(super) fn id(&self) -> ConnectionId {
        self.id
    }

    /// Returns the random identifier that the edge gave the connection.
    pub(super) fn identifier(&self) -> &str {
        &self.identifier
    }

    fn lock_channel(&self) -> MutexGuard<'_, Option<Arc<Channel>>> {
        self.channel.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns this end of the connection, while its topics are open.
    pub(super) fn channel(&self) -> Option<Arc<Channel>> {
        self.lock_channel().clone()
    }

    /// Sets this end of the connection once its topics are open.
    pub(super) fn set_channel(&self, channel: Arc<Channel>) {
        *self.lock_channel() = Some(channel);
    }

    pub(super) fn set_admission(&self, admission: Admission) {
        self.admission.send_replace(admission);
    }

    /// Returns a receiver of the admission and its changes.
    pub(super) fn watch_admission(&self) -> watch::Receiver<Admission> {
        self.admission.subscribe()
    }

    /// Returns the token that ends the connection without a goodbye.
    pub(super) fn abort_token(&self) -> CancellationToken {
        self.abort.clone()
    }

    /// Closes the topics, because the pipeline's next connection publishes the same topics.
    pub(super) fn end(&self) {
        self.lock_channel().take();
        self.ended.cancel();
    }

    /// Waits until the topics are closed.
    pub(super) async fn wait_for_end(&self) {
        self.ended.cancelled().await;
    }
}

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;

    use peernet_ros::messages::Header;

    use super::*;

    /// Asks for a connection for a pipeline of a host at an address.
    fn open(
        table: &ConnectionTable,
        identifier: &str,
        (host, address): (&str, &str),
        pipeline: &str,
    ) -> OpenOutcome {
        let header = Header { frame_id: identifier.into(), ..Header::default() };
        let (host, pipeline) = (host.to_owned(), pipeline.to_owned());
        let hello = SessionHello { header, host, pipeline, ..SessionHello::default() };
        let address: SocketAddr = format!("{address}:1").parse().expect("an address");
        table.open(&hello, AddressGroup::from_address(address), CancellationToken::new())
    }

    fn started(outcome: OpenOutcome) -> Arc<CloudConnection> {
        match outcome {
            OpenOutcome::Started { connection, .. } => connection,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn new_connection_of_same_host_replaces_earlier_one() {
        let table = ConnectionTable::new(10, 10);
        let robot = ("a", "192.0.2.1");
        let first = started(open(&table, "1", robot, "/line"));
        assert!(matches!(open(&table, "1", robot, "/line"), OpenOutcome::Repeated));
        for (host, address) in [("b", "192.0.2.1"), ("a", "198.51.100.1")] {
            let outcome = open(&table, "2", (host, address), "/line");
            assert!(matches!(outcome, OpenOutcome::Refused(_)), "{host} at {address}: {outcome:?}");
        }
        assert!(!first.abort_token().is_cancelled());
        let second = open(&table, "2", robot, "/line");
        let OpenOutcome::Started { connection: second, replaced: Some(replaced) } = second else {
            panic!("{second:?}")
        };
        assert!(Arc::ptr_eq(&first, &replaced) && first.abort_token().is_cancelled());
        table.remove("/line", &first);
        assert!(table.find(second.id()).is_some() && table.find(first.id()).is_none());
        table.remove("/line", &second);
        assert!(table.find(second.id()).is_none());
    }

    #[test]
    fn connections_are_bounded_with_and_without_session() {
        let table = ConnectionTable::new(3, 2);
        // The name of the pipeline also serves as the identifier of the connection.
        let open = |pipeline, address| open(&table, pipeline, ("a", address), pipeline);
        let refusal = |pipeline, address| match open(pipeline, address) {
            OpenOutcome::Refused(reason) => reason,
            other => panic!("{other:?}"),
        };
        let first = started(open("/1", "192.0.2.1"));
        let unadmitted = "too many other connections have no session yet; try again later";
        assert_eq!(
            refusal("/2", "192.0.2.1"),
            unadmitted,
            "half of the connections without a session is for other addresses"
        );
        started(open("/2", "198.51.100.1"));
        assert_eq!(refusal("/3", "203.0.113.1"), unadmitted);
        first.set_admission(Admission::Admitted);
        let third = started(open("/3", "203.0.113.1"));
        third.set_admission(Admission::Admitted);
        assert!(refusal("/4", "203.0.113.1").starts_with("the cloud has too many"));
    }
}
