//! Membership of this process in a domain.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use peernet_ros::ros2::{ParticipantId, Ros2Node, Ros2Settings};

use crate::transport::ros::interface::NodeFailure;

/// Participants of this process. On a pipeline's topics there may still be publishers of this process's earlier
/// connections; such publishers are not taken for another program.
static LOCAL_PARTICIPANTS: Mutex<BTreeSet<ParticipantId>> = Mutex::new(BTreeSet::new());

fn local_participants() -> MutexGuard<'static, BTreeSet<ParticipantId>> {
    LOCAL_PARTICIPANTS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns whether a participant belongs to this process.
pub(super) fn is_local_participant(id: ParticipantId) -> bool {
    local_participants().contains(&id)
}

/// A participant of this process. It is one of the [`LOCAL_PARTICIPANTS`] until it leaves its domain.
pub(super) struct Participant {
    /// `None` after the participant has left.
    node: Mutex<Option<Arc<Ros2Node>>>,
    id: ParticipantId,
    name: String,
    receive_buffer_bytes: usize,
    caveat: Option<String>,
}

impl Participant {
    /// Joins a domain.
    ///
    /// # Errors
    /// If the settings are invalid, or DDS cannot be started.
    pub(super) async fn join(settings: Ros2Settings) -> Result<Self, NodeFailure> {
        let node = Ros2Node::new(settings).await?;
        let id = node.id();
        local_participants().insert(id);
        Ok(Self {
            id,
            name: id.to_string(),
            receive_buffer_bytes: node.receive_buffer_bytes(),
            caveat: node.socket_buffer_warnings().first().map(ToString::to_string),
            node: Mutex::new(Some(Arc::new(node))),
        })
    }

    fn lock(&self) -> MutexGuard<'_, Option<Arc<Ros2Node>>> {
        self.node.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the DDS client.
    ///
    /// # Errors
    /// If the participant has left its domain.
    pub(super) fn node(&self) -> Result<Arc<Ros2Node>, NodeFailure> {
        self.lock().clone().ok_or_else(|| NodeFailure("the node of ROS 2 has left its domain".to_owned()))
    }

    /// Returns the text form of the identity, by which other ends recognize messages of this participant.
    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// Returns the size of a receive buffer of this host's sockets. Bytes.
    pub(super) fn receive_buffer_bytes(&self) -> usize {
        self.receive_buffer_bytes
    }

    /// Returns a warning about a limit of this host that slows connections down, and what to do about it.
    pub(super) fn caveat(&self) -> Option<&str> {
        self.caveat.as_deref()
    }

    /// Starts to leave the domain, and does not wait until the participant has left it.
    pub(super) fn leave(&self) {
        let node = self.lock().take();
        local_participants().remove(&self.id);
        // Dropping the node leaves the domain on a separate thread.
        drop(node);
    }
}

impl Drop for Participant {
    fn drop(&mut self) {
        self.leave();
    }
}
