//! The topic on which this end publishes its payloads.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use peernet_ros::messages::Header;
use peernet_ros::ros1::{Delivery, QueueLimits};
use peernet_sample::Description;
use tokio::sync::Notify;

use super::connection::PeerState;
use super::interface::{NodeFailure, SessionNode, SessionPublisher, TopicPurpose};
use super::payload::{self, PayloadType};
use crate::transport::SendFailure;

/// Interval between attempts to open a topic while the master is not reachable.
pub(super) const MASTER_RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// Payload topic of one end of a connection. The first payload determines the topic's type and makes the connection's
/// task open the topic. A payload that cannot be sent on the topic is sent in the companion of its message.
///
/// In ROS 2 a payload is also sent in its companion until the other end has confirmed that payloads of this connection
/// arrive on the topic. Messages then also arrive if types or QoS do not fit, or if the topic has a publisher of an
/// earlier connection.
#[derive(Debug)]
pub(super) struct PayloadTopic {
    name: String,
    queue: QueueLimits,
    state: Mutex<TopicState>,
    /// Signals that the topic must be opened.
    open_requested: Notify,
}

#[derive(Debug, Default)]
struct TopicState {
    phase: TopicPhase,
    /// `true` if a remark has said that the QoS of the other end does not fit.
    has_remarked_mismatch: bool,
    /// `true` if a remark has said that payloads are too long for the topic.
    has_remarked_size: bool,
}

#[derive(Debug, Default)]
enum TopicPhase {
    /// No payload was sent yet.
    #[default]
    Unused,
    /// The topic must be opened with this type.
    Requested(PayloadType),
    /// The connection's task opens the topic.
    Opening,
    /// The topic is open with this type.
    Open(PayloadType, Box<dyn SessionPublisher>),
}

/// The first payload part of a message.
#[derive(Clone, Copy, Debug)]
pub(super) struct Payload<'a> {
    /// Header of the message's companion.
    pub(super) header: &'a Header,
    pub(super) part: &'a Description,
    pub(super) data: &'a Bytes,
}

impl PayloadTopic {
    pub(super) fn new(name: String, queue: QueueLimits) -> Self {
        Self { name, queue, state: Mutex::default(), open_requested: Notify::new() }
    }

    fn state(&self) -> MutexGuard<'_, TopicState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the global name of the topic.
    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// Publishes a payload. Returns `true` if the peer receives the payload on this topic, so that the companion need
    /// not carry the payload.
    ///
    /// # Errors
    /// If the queue for a peer that receives the topic is full, or the topic has ended.
    pub(super) fn publish(
        &self,
        node: &dyn SessionNode,
        (peer, peer_state): (&str, PeerState),
        payload: &Payload<'_>,
        remark: &mut dyn FnMut(String),
    ) -> Result<bool, SendFailure> {
        let Payload { header, part, data } = *payload;
        let kind = PayloadType::from_part(part, data.len());
        let mut state = self.state();
        let TopicState { phase, has_remarked_mismatch, has_remarked_size } = &mut *state;
        let (topic_type, publisher) = match phase {
            TopicPhase::Open(topic_type, publisher) => (topic_type, publisher),
            TopicPhase::Unused => {
                *phase = TopicPhase::Requested(kind);
                self.open_requested.notify_one();
                return Ok(false);
            }
            // Companions carry the payloads until the topic is open.
            TopicPhase::Requested(_) | TopicPhase::Opening => return Ok(false),
        };
        // A topic has one type, so payloads of other types are sent in their companions.
        if *topic_type != kind {
            return Ok(false);
        }
        let max_bytes = max_payload_bytes(node, peer_state);
        if let Some(max_bytes) = max_bytes.filter(|max_bytes| data.len() > *max_bytes) {
            if !std::mem::replace(has_remarked_size, true) {
                remark(describe_long_payload(data.len(), max_bytes, publisher.topic()));
            }
            return Ok(false);
        }
        // In ROS 1 a publisher knows its connections; in ROS 2 the peer confirms that payloads arrive on the topic.
        let is_confirmed = !node.is_connectionless() || peer_state.is_subscribed;
        if !is_confirmed
            && !*has_remarked_mismatch
            && let Some(reason) = publisher.describe_mismatch(peer)
        {
            *has_remarked_mismatch = true;
            remark(format!("payloads travel in their companions as well: {reason}"));
        }
        // A payload that this version of ROS cannot encode is sent in its companion.
        let Ok(message) = payload::encode(node.form(), header, part, data) else {
            return Ok(false);
        };
        // The payload is one message. `publish` would not return the outcome for the peer.
        match publisher.publish_fragments(peer, &[message]) {
            Ok(Delivery::Accepted) => Ok(is_confirmed),
            Ok(Delivery::Full) if is_confirmed => Err(SendFailure::Full),
            // The companion has the payload as well, so nothing is lost.
            Ok(Delivery::Full | Delivery::NotConnected) => Ok(false),
            Err(error) => Err(SendFailure::Gone(error.to_string())),
        }
    }

    /// Waits until the topic must be opened, which happens once. Returns the type of the topic. Cancel safe: dropping
    /// the future loses nothing.
    pub(super) async fn take_request(&self) -> PayloadType {
        loop {
            {
                let phase = &mut self.state().phase;
                if let TopicPhase::Requested(kind) = *phase {
                    *phase = TopicPhase::Opening;
                    return kind;
                }
            }
            self.open_requested.notified().await;
        }
    }

    /// Opens the topic.
    ///
    /// # Errors
    /// If the master does not answer, or refuses the registration.
    pub(super) async fn open(&self, node: &dyn SessionNode, kind: PayloadType) -> Result<(), NodeFailure> {
        let publisher =
            node.publish(&self.name, (TopicPurpose::Payloads, kind.topic_type()), self.queue).await?;
        self.state().phase = TopicPhase::Open(kind, publisher);
        Ok(())
    }
}

/// Returns the smaller size of both ends' socket buffers in bytes; `None` if payloads of any length arrive.
fn max_payload_bytes(node: &dyn SessionNode, peer: PeerState) -> Option<usize> {
    let own_bytes = node.receive_buffer_bytes()?;
    Some(peer.receive_buffer_bytes.map_or(own_bytes, |peer_bytes| own_bytes.min(peer_bytes as usize)))
}

/// Returns the remark about a payload that is too long for the socket buffers.
fn describe_long_payload(bytes: usize, max_bytes: usize, topic: &str) -> String {
    format!(
        "a payload of {bytes} bytes is longer than the {max_bytes} bytes of the socket buffers of both hosts: such payloads are sent \
         in fragments and not on topic {topic}, where other programs would see them; raise socket_buffer_bytes of the session, and \
         net.core.rmem_max, on both hosts"
    )
}

/// Returns the remark about a payload topic that could not be opened.
pub(super) fn describe_open_failure(topic: &str, error: &NodeFailure) -> String {
    format!(
        "cannot open topic {topic}: {error}; the attempt is repeated every {} s, and payloads are sent in their companions until \
         it succeeds",
        MASTER_RETRY_INTERVAL.as_secs()
    )
}

#[cfg(test)]
mod tests;
