//! Checks by which publisher and subscriber decide whether they can exchange messages.

use std::sync::Arc;

use thiserror::Error;

use super::{ConnectionHeader, HeaderError};
use crate::messages::Message;

/// Wildcard for any type or MD5 sum.
const ANY: &str = "*";

/// A message type as named in connection headers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicType {
    /// Package and name, or `*`.
    pub name: Arc<str>,
    /// MD5 sum, or `*`.
    pub md5: Arc<str>,
    /// Full text of the definition; may be empty.
    pub definition: Arc<str>,
}

impl TopicType {
    /// Returns the type of a [`Message`].
    pub fn from_message<M: Message>() -> Self {
        let definition = M::DEFINITION;
        Self {
            name: definition.name.into(),
            md5: definition.md5.into(),
            definition: definition.full_text().into(),
        }
    }

    /// Returns the wildcard type, which every type matches, for subscribers that receive messages as bytes.
    pub fn any() -> Self {
        Self { name: ANY.into(), md5: ANY.into(), definition: "".into() }
    }

    /// Returns whether the MD5 sum is the wildcard, as in [`TopicType::any`].
    pub fn is_any(&self) -> bool {
        &*self.md5 == ANY
    }

    /// Returns whether this type matches the type of a peer: their MD5 sums are equal or one of the sums is `*`, and
    /// their names are equal or one of the names is `*`.
    fn matches(&self, peer_name: &str, peer_md5: &str) -> bool {
        let is_same = |local: &str, peer: &str| local == peer || local == ANY || peer == ANY;
        is_same(&self.md5, peer_md5) && is_same(&self.name, peer_name)
    }

    fn description(name: &str, md5: &str) -> String {
        format!("{name} (md5sum {md5})")
    }
}

/// Reason why publisher and subscriber cannot exchange messages.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum HandshakeError {
    /// The header is invalid or lacks a field.
    #[error(transparent)]
    Header(#[from] HeaderError),
    /// The subscriber asks for a topic that this node does not publish.
    #[error("topic {topic} is not published by node {node}")]
    UnknownTopic {
        /// Topic that was asked for.
        topic: String,
        /// Name of the node that was asked.
        node: String,
    },
    /// Publisher and subscriber have different types.
    #[error(
        "topic {topic} has two message types: {local_type} here, {peer_type} at node {peer}; \
         both must use the same definition of the type"
    )]
    TypeMismatch {
        /// Topic.
        topic: String,
        /// Type and sum at this node.
        local_type: String,
        /// Type and sum at the peer.
        peer_type: String,
        /// Name of the peer's node.
        peer: String,
    },
    /// The publisher refused the subscription.
    #[error("the publisher of topic {topic} refuses the subscription: {reason}")]
    Refused {
        /// Topic.
        topic: String,
        /// Reason that the publisher gave.
        reason: String,
    },
}

/// A topic that a node publishes, with the answer to subscribers.
#[derive(Clone, Debug)]
pub struct Publication {
    /// Name of the node.
    pub node: Arc<str>,
    /// Global name of the topic.
    pub topic: Arc<str>,
    /// Type of the messages.
    pub kind: TopicType,
    /// `true` if a new subscriber gets the last message at once.
    pub is_latching: bool,
}

impl Publication {
    /// Answers the header of a subscriber. Returns the header of the answer, and the subscriber's name.
    ///
    /// # Errors
    /// If the subscriber requests another topic or type. The caller must send the subscriber
    /// [`ConnectionHeader::error`] with the text of the error.
    pub fn answer(&self, request: &ConnectionHeader) -> Result<(ConnectionHeader, Arc<str>), HandshakeError> {
        let topic = request.require("topic")?;
        let md5 = request.require("md5sum")?;
        let peer = request.get("callerid").unwrap_or("without a name");
        // Some clients omit the type if the sum is a wildcard.
        let name = request.get("type").unwrap_or(ANY);
        if topic != &*self.topic {
            return Err(HandshakeError::UnknownTopic { topic: topic.into(), node: self.node.to_string() });
        }
        if !self.kind.matches(name, md5) {
            return Err(HandshakeError::TypeMismatch {
                topic: topic.into(),
                local_type: TopicType::description(&self.kind.name, &self.kind.md5),
                peer_type: TopicType::description(name, md5),
                peer: peer.into(),
            });
        }
        let answer = ConnectionHeader::from_fields([
            ("callerid", &*self.node),
            ("latching", if self.is_latching { "1" } else { "0" }),
            ("md5sum", &*self.kind.md5),
            ("message_definition", &*self.kind.definition),
            ("topic", &*self.topic),
            ("type", &*self.kind.name),
        ]);
        Ok((answer, peer.into()))
    }
}

/// A topic that a node subscribes to, with the request to publishers.
#[derive(Clone, Debug)]
pub struct Subscription {
    /// Name of the node.
    pub node: Arc<str>,
    /// Global name of the topic.
    pub topic: Arc<str>,
    /// Expected type of the messages.
    pub kind: TopicType,
}

impl Subscription {
    /// Returns the header that opens a connection.
    pub fn request(&self) -> ConnectionHeader {
        ConnectionHeader::from_fields([
            ("callerid", &*self.node),
            ("md5sum", &*self.kind.md5),
            ("message_definition", &*self.kind.definition),
            // Asks the publisher to send short messages without delay.
            ("tcp_nodelay", "1"),
            ("topic", &*self.topic),
            ("type", &*self.kind.name),
        ])
    }

    /// Checks the publisher's answer. Returns the publisher's name and type.
    ///
    /// # Errors
    /// If the publisher refuses or publishes another type.
    pub fn accept(&self, answer: &ConnectionHeader) -> Result<(Arc<str>, TopicType), HandshakeError> {
        let topic = || self.topic.to_string();
        if let Some(reason) = answer.get("error") {
            return Err(HandshakeError::Refused { topic: topic(), reason: reason.to_owned() });
        }
        let md5 = answer.require("md5sum")?;
        let name = answer.require("type")?;
        let peer = answer.get("callerid").unwrap_or("without a name");
        if !self.kind.matches(name, md5) {
            return Err(HandshakeError::TypeMismatch {
                topic: topic(),
                local_type: TopicType::description(&self.kind.name, &self.kind.md5),
                peer_type: TopicType::description(name, md5),
                peer: peer.into(),
            });
        }
        let definition = answer.get("message_definition").unwrap_or_default().into();
        Ok((peer.into(), TopicType { name: name.into(), md5: md5.into(), definition }))
    }
}
