//! A topic of ROS 1.

use std::sync::Arc;

use peernet_ros::messages::WireForm;
use peernet_ros::ros1::{
    Node, NodeError, PublisherInfo, PublisherState, ReceivedMessage, Subscriber, SubscriberOptions,
    TopicType, WhenFull,
};
use peernet_ros::topics::TopicError;

use super::sequence_gaps::SequenceGaps;
use super::{ObservedType, PublisherLocation};
use crate::pipeline::observe::message::{TopicMessage, begins_with_header, read_header};

/// A subscription of a topic of ROS 1.
pub(in crate::pipeline::observe) struct Ros1Topic {
    subscriber: Subscriber,
    gaps: SequenceGaps,
}

impl Ros1Topic {
    /// Subscribes to a topic of any type.
    ///
    /// # Errors
    /// When the name is not allowed, or the master does not answer.
    pub(in crate::pipeline::observe) async fn subscribe(node: &Node, topic: &str) -> Result<Self, NodeError> {
        // A full queue drops messages, because waiting would stall the publisher, which is part of the observed
        // system.
        let options = SubscriberOptions { when_full: WhenFull::Drop, ..SubscriberOptions::default() };
        let subscriber = node.subscribe(topic, TopicType::any(), options).await?;
        Ok(Self { subscriber, gaps: SequenceGaps::default() })
    }

    pub(super) async fn next(&mut self) -> Result<TopicMessage, TopicError> {
        let ReceivedMessage { bytes, publisher, received, .. } = self.subscriber.recv().await?;
        let has_header = begins_with_header(&publisher.kind.definition);
        let header = has_header.then(|| read_header(WireForm::Ros1, &bytes)).flatten();
        let sequence = header.as_ref().map(|header| header.seq.into());
        Ok(TopicMessage {
            received_at: received,
            length: bytes.len(),
            // If a node does not set the stamp, the stamp is 0.
            stamp: header.map(|header| header.stamp.as_nanos()).filter(|stamp| *stamp != 0),
            sequence,
            missing_before: sequence.map_or(0, |sequence| self.gaps.record(&publisher.uri, sequence)),
        })
    }

    pub(super) fn name(&self) -> &str {
        self.subscriber.topic()
    }

    pub(super) fn kind(&self) -> Option<ObservedType> {
        let publisher = self.connected_publishers().next()?;
        let has_header = Some(begins_with_header(&publisher.kind.definition));
        Some(ObservedType { name: publisher.kind.name.to_string(), has_header })
    }

    pub(super) fn problem(&self) -> Option<String> {
        let publishers = self.subscriber.publishers();
        if publishers.iter().any(|publisher| matches!(publisher.state, PublisherState::Connected(_))) {
            return None;
        }
        let failed = publishers.into_iter().find_map(|publisher| match publisher.state {
            PublisherState::Failed(reason) => Some(reason),
            PublisherState::Connecting | PublisherState::Connected(_) => None,
        });
        let no_publisher = format!("no node publishes {}", self.name());
        Some(failed.map_or_else(|| no_publisher.clone(), |reason| format!("{no_publisher} ({reason})")))
    }

    pub(super) fn publishers(&self) -> Vec<PublisherLocation> {
        let location = |info: Arc<PublisherInfo>| {
            // A connection within one host has the same address at both ends.
            let host = (info.remote.ip() != info.local.ip()).then(|| info.remote.ip().to_string());
            PublisherLocation { node: info.node.to_string(), host }
        };
        self.connected_publishers().map(location).collect()
    }

    pub(super) fn publishers_changed(&self) -> impl Future<Output = ()> + '_ {
        self.subscriber.publishers_changed()
    }

    pub(super) fn dropped(&self) -> u64 {
        self.subscriber.counts().dropped
    }

    fn connected_publishers(&self) -> impl Iterator<Item = Arc<PublisherInfo>> + use<> {
        self.subscriber.publishers().into_iter().filter_map(|publisher| match publisher.state {
            PublisherState::Connected(info) => Some(info),
            PublisherState::Connecting | PublisherState::Failed(_) => None,
        })
    }
}
