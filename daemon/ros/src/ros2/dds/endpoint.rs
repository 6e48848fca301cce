//! State and functions that publishers and subscriptions have in common.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;

use super::node::NodeState;
use crate::ros2::error::NoPeer;
use crate::ros2::{EndpointId, EndpointRole, PeerTable, Ros2Error};

/// One of our endpoints. It leaves the node list when it is dropped.
pub(super) struct Endpoint {
    pub(super) id: EndpointId,
    pub(super) role: EndpointRole,
    /// Absolute name of the topic.
    pub(super) topic: String,
    pub(super) type_name: String,
    pub(super) peers: watch::Receiver<PeerTable>,
    pub(super) node: Arc<NodeState>,
}

impl Endpoint {
    /// Waits for a peer on the topic.
    ///
    /// # Errors
    ///
    /// [`Ros2Error::NoPeer`] if no peer is found within `time_limit`, [`Ros2Error::ShutDown`] if the node is shut
    /// down before.
    pub(super) async fn wait_for_peer(&self, time_limit: Duration) -> Result<(), Ros2Error> {
        let mut peers = self.peers.clone();
        let first_match = peers.wait_for(|peers| !peers.matched.is_empty());
        let in_time = tokio::time::timeout(time_limit, first_match);
        match self.node.closed.run_until_cancelled(in_time).await {
            Some(Ok(Ok(_))) => Ok(()),
            Some(Err(_elapsed)) => Err(Ros2Error::NoPeer(Box::new(self.no_peer_error(time_limit)))),
            // The sender of `peers` exists until the endpoint is dropped, so `Some(Ok(Err(_)))` does not occur.
            None | Some(Ok(Err(_))) => Err(self.shut_down_error()),
        }
    }

    pub(super) fn shut_down_error(&self) -> Ros2Error {
        Ros2Error::ShutDown { topic: self.topic.clone() }
    }

    fn no_peer_error(&self, waited: Duration) -> NoPeer {
        let discovery = self.node.discovery();
        let node_name = |id| discovery.node_of(id).map(str::to_owned);
        let refused = self
            .peers
            .borrow()
            .refused
            .iter()
            .map(|(id, refusal)| (node_name(*id), refusal.clone()))
            .collect();
        NoPeer {
            role: self.role,
            topic: self.topic.clone(),
            type_name: self.type_name.clone(),
            waited,
            domain_id: self.node.domain_id,
            interfaces: self.node.interfaces.clone(),
            participants: discovery.participant_count(),
            refused,
            topics: discovery.topics(),
        }
    }
}

impl Drop for Endpoint {
    fn drop(&mut self) {
        self.node.remove_endpoint(self.id);
    }
}
