//! A topic of ROS 2.

use std::collections::BTreeSet;
use std::sync::Arc;

use peernet_clock::{SharedClock, Span, Stamp, WallTime};
use peernet_ros::messages::WireForm;
use peernet_ros::ros2::{
    DiscoveredPublisher, QosProfile, ReceivedSample, Reliability, Ros2Node, Ros2Subscription, absolute_topic,
};
use peernet_ros::topics::TopicError;
use tokio::sync::watch;

use super::{ObservedType, PublisherLocation};
use crate::pipeline::observe::message::{TopicMessage, read_header};

/// Maximum number of unread messages. Unread messages are in memory: 64 images of 1 MB need 64 MB.
const DEPTH: u32 = 64;

/// A topic of ROS 2. The agent subscribes to it once a publisher shows the type of the messages.
pub(in crate::pipeline::observe) struct Ros2Topic {
    // The fields are dropped in this order, so that the subscription ends before its node.
    subscription: Option<TypedSubscription>,
    node: Arc<Ros2Node>,
    /// Absolute name of the topic.
    name: String,
    /// Counter of the changes that discovery has found; marked as seen by `follow_publishers`.
    discovery: watch::Receiver<u64>,
    /// Types of publishers that were reported because the subscription has another type.
    reported_types: BTreeSet<String>,
    clock: SharedClock,
}

/// A subscription and the type with which it was created.
struct TypedSubscription {
    receiver: Ros2Subscription,
    /// Type of the messages, such as `sensor_msgs/msg/Image`.
    type_name: String,
}

impl Ros2Topic {
    /// Creates a topic of a node's domain. The agent does not subscribe before a publisher is found.
    ///
    /// # Errors
    /// When the name is not allowed.
    pub(in crate::pipeline::observe) fn new(
        node: &Arc<Ros2Node>,
        topic: &str,
        clock: &SharedClock,
    ) -> Result<Self, TopicError> {
        let settings = node.settings();
        let mut discovery = node.discovery_changes();
        // Publishers that were found before this topic existed count as a change.
        discovery.mark_changed();
        Ok(Self {
            subscription: None,
            name: absolute_topic(&settings.namespace, &settings.node_name, topic)?,
            node: Arc::clone(node),
            discovery,
            reported_types: BTreeSet::new(),
            clock: SharedClock::clone(clock),
        })
    }

    pub(super) async fn next(&mut self) -> Result<TopicMessage, TopicError> {
        loop {
            self.follow_publishers()?;
            let Some(subscription) = &mut self.subscription else {
                await_discovery_change(&mut self.discovery).await;
                continue;
            };
            tokio::select! {
                sample = subscription.receiver.receive() => return Ok(message_from_sample(&sample?, &self.clock)),
                () = await_discovery_change(&mut self.discovery) => {}
            }
        }
    }

    pub(super) fn follow_publishers(&mut self) -> Result<(), TopicError> {
        // `has_changed` fails only without a sender, which lives as long as `self.node`.
        if !self.discovery.has_changed().unwrap_or(false) {
            return Ok(());
        }
        // The change is marked as handled before the publishers are read, so that a later change is not missed.
        self.discovery.mark_unchanged();
        let publishers = self.node.publishers_of(&self.name);
        let current = self.subscription.as_ref().map(|subscription| subscription.type_name.as_str());
        if let Some(type_name) = type_to_subscribe(&publishers, current) {
            // A best-effort subscription matches reliable and best-effort publishers, and no publisher waits for the
            // agent.
            let qos =
                QosProfile { reliability: Reliability::BestEffort, depth: DEPTH, ..QosProfile::default() };
            let receiver = self.node.create_subscription(&self.name, type_name, &qos)?;
            self.subscription = Some(TypedSubscription { receiver, type_name: type_name.to_owned() });
        }
        self.report_other_types(&publishers);
        Ok(())
    }

    /// Logs publishers whose messages are not received because of their type.
    fn report_other_types(&mut self, publishers: &[DiscoveredPublisher]) {
        let Some(TypedSubscription { type_name, .. }) = &self.subscription else { return };
        let other_publishers = publishers.iter().filter(|publisher| publisher.type_name != *type_name);
        for other in other_publishers {
            if self.reported_types.insert(other.type_name.clone()) {
                tracing::warn!(
                    "topic {} has publishers of two types, {type_name} and {}; only {type_name} is observed: stop the other \
                     publishers, or let them publish another topic",
                    self.name,
                    other.type_name
                );
            }
        }
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    pub(super) fn kind(&self) -> Option<ObservedType> {
        let name = self.subscription.as_ref()?.type_name.clone();
        // DDS does not transmit the fields of a type. In std_msgs only the type Header has a header. For types of other
        // packages only the messages show whether there is a header.
        let has_header = name.starts_with("std_msgs/msg/").then(|| name == "std_msgs/msg/Header");
        Some(ObservedType { name, has_header })
    }

    pub(super) fn problem(&self) -> Option<String> {
        let no_publisher = format!("no node publishes {}", self.name);
        let Some(TypedSubscription { receiver, .. }) = &self.subscription else { return Some(no_publisher) };
        let peers = receiver.peers();
        let peers = peers.borrow();
        if peers.matched.is_empty() {
            let refusal = peers.refused.values().next();
            return Some(refusal.map_or_else(
                || no_publisher.clone(),
                |refusal| format!("{no_publisher} for this agent: a publisher exists, but {refusal}"),
            ));
        }
        let counts = receiver.counts();
        (counts.received == 0 && counts.undecodable > 0).then(|| {
            format!("the messages of {} cannot be read: publish them in plain CDR (XCDR1)", self.name)
        })
    }

    pub(super) fn publishers(&self) -> Vec<PublisherLocation> {
        let of_type = |publisher: &DiscoveredPublisher| {
            self.subscription
                .as_ref()
                .is_some_and(|subscription| subscription.type_name == publisher.type_name)
        };
        let publishers = self.node.publishers_of(&self.name).into_iter().filter(of_type);
        let location = |publisher: DiscoveredPublisher| PublisherLocation {
            node: publisher.name(),
            host: publisher.host.map(|host| host.to_string()),
        };
        publishers.map(location).collect()
    }

    pub(super) async fn publishers_changed(&self) {
        await_discovery_change(&mut self.discovery.clone()).await;
    }
}

/// Waits for a discovery change that was not handled yet, and leaves the receiver marked as changed.
async fn await_discovery_change(discovery: &mut watch::Receiver<u64>) {
    if discovery.changed().await.is_err() {
        // The node is shut down: there will be no changes.
        std::future::pending::<()>().await;
    }
    discovery.mark_changed();
}

/// Returns the type to subscribe with; `None` if the current one still has a publisher, or if the topic has no
/// publisher.
fn type_to_subscribe<'a>(publishers: &'a [DiscoveredPublisher], current: Option<&str>) -> Option<&'a str> {
    let types = || publishers.iter().map(|publisher| publisher.type_name.as_str());
    if types().any(|type_name| Some(type_name) == current) { None } else { types().next() }
}

/// Converts a received sample.
fn message_from_sample(sample: &ReceivedSample, clock: &SharedClock) -> TopicMessage {
    let header = read_header(WireForm::Cdr, &sample.payload);
    TopicMessage {
        // The DDS library reads the system's clock, so injected faults are applied to its time here.
        received_at: stamp_of(clock.apply_faults(sample.received_time), clock.stamp()),
        length: sample.payload.len(),
        // If a node does not set the stamp, the stamp is 0.
        stamp: header.map(|header| header.stamp.as_nanos()).filter(|stamp| *stamp != 0),
        // The header of ROS 2 has no sequence number.
        sequence: None,
        missing_before: sample.missing_before,
    }
}

/// Returns the stamp of all clocks at the wall-clock time `wall`, shortly before `now`.
fn stamp_of(wall: WallTime, now: Stamp) -> Stamp {
    // If the wall clock was set back after the reception, the reception would be in the future.
    let age = (now.wall - wall).max(Span::ZERO);
    now - age
}

#[cfg(test)]
mod tests {
    use peernet_clock::{ClockIdentity, ManualClock, MonoTime};
    use peernet_ros::ros2::EndpointId;

    use super::*;

    fn publisher(type_name: &str) -> DiscoveredPublisher {
        let type_name = type_name.to_owned();
        DiscoveredPublisher { id: EndpointId([1; 16]), type_name, host: None, node: None }
    }

    #[test]
    fn subscription_follows_the_type_of_the_publishers() {
        let (image, text) = (publisher("sensor_msgs/msg/Image"), publisher("std_msgs/msg/String"));
        let image_and_text = [image.clone(), text];
        assert_eq!(type_to_subscribe(&[], None), None);
        assert_eq!(type_to_subscribe(&image_and_text, None), Some("sensor_msgs/msg/Image"));
        assert_eq!(
            type_to_subscribe(&image_and_text, Some("std_msgs/msg/String")),
            None,
            "one publisher of the type is enough"
        );
        assert_eq!(type_to_subscribe(&[image], Some("std_msgs/msg/String")), Some("sensor_msgs/msg/Image"));
        assert_eq!(type_to_subscribe(&[], Some("std_msgs/msg/String")), None, "a publisher may return");
    }

    #[test]
    fn message_has_header_and_missing_count_of_sample() {
        let now = WallTime::from_unix_nanos(1_000_000_000_000_000_000);
        let clock: SharedClock = Arc::new(ManualClock::new(now, ClockIdentity::new("boot", "system")));
        let sample = ReceivedSample {
            // 3 s + 5 ns, frame "a".
            payload: vec![0, 1, 0, 0, 3, 0, 0, 0, 5, 0, 0, 0, 2, 0, 0, 0, b'a', 0].into(),
            source_time: None,
            received_time: now,
            writer: EndpointId([1; 16]),
            sequence: 9,
            missing_before: 2,
        };
        let message = message_from_sample(&sample, &clock);
        assert_eq!((message.stamp, message.missing_before, message.length), (Some(3_000_000_005), 2, 18));
        assert_eq!((message.received_at.wall, message.sequence), (now, None));
    }

    #[test]
    fn stamp_is_time_of_reception_and_never_in_future() {
        let now = Stamp {
            wall: WallTime::from_unix_nanos(5_000),
            mono: MonoTime::from_nanos(700),
            ..Stamp::default()
        };
        let earlier = stamp_of(WallTime::from_unix_nanos(4_900), now);
        assert_eq!((earlier.wall.unix_nanos(), earlier.mono), (4_900, MonoTime::from_nanos(600)));
        assert_eq!(stamp_of(WallTime::from_unix_nanos(9_000), now), now, "the clock was set back");
    }
}
