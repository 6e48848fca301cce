//! The cloud's subscription to the payload topic of a connection.

use std::sync::Arc;

use peernet_ros::ros1::{SubscriberOptions, TopicType};
use tokio::task::JoinError;
use tokio::time::sleep;
use tokio_util::task::AbortOnDropHandle;

use crate::transport::ros::channel::Channel;
use crate::transport::ros::interface::{SessionNode, SessionSubscriber, TopicPurpose};
use crate::transport::ros::payload_topic::{MASTER_RETRY_INTERVAL, describe_open_failure};

/// Subscription to the payloads of one connection. The subscription is opened once and in the background, because the
/// master must be asked and may not be reachable.
#[derive(Debug)]
pub(super) enum PayloadSubscription {
    /// The connection has had no session yet. Its payload topic is not subscribed to before a session.
    Unused {
        /// Node of the cloud.
        node: Arc<dyn SessionNode>,
        /// Global name of the topic.
        topic: String,
        options: SubscriberOptions,
    },
    Opening(AbortOnDropHandle<Box<dyn SessionSubscriber>>),
    /// The subscription was opened and handed over, or the task that opens it has failed.
    OpeningEnded,
}

impl PayloadSubscription {
    /// Starts to subscribe, unless an earlier call has started to subscribe.
    pub(super) fn start(&mut self, channel: &Arc<Channel>) {
        if let Self::Unused { node, topic, options } = self {
            let (node, topic, options) = (Arc::clone(node), std::mem::take(topic), options.clone());
            let channel = Arc::clone(channel);
            // Until the topic is subscribed to, payloads arrive in their companions.
            let task = tokio::spawn(async move { subscribe(&*node, &topic, options, &channel).await });
            *self = Self::Opening(AbortOnDropHandle::new(task));
        }
    }

    /// Waits until the topic is subscribed to, which happens once.
    pub(super) async fn wait_until_open(&mut self) -> Result<Box<dyn SessionSubscriber>, JoinError> {
        let Self::Opening(task) = self else { return std::future::pending().await };
        let result = task.await;
        *self = Self::OpeningEnded;
        result
    }
}

/// Subscribes to a payload topic. Repeats the attempt until it succeeds.
async fn subscribe(
    node: &dyn SessionNode,
    topic: &str,
    options: SubscriberOptions,
    channel: &Channel,
) -> Box<dyn SessionSubscriber> {
    let mut is_reported = false;
    loop {
        match node.subscribe(topic, (TopicPurpose::Payloads, TopicType::any()), options.clone()).await {
            Ok(subscriber) => return subscriber,
            Err(error) if !is_reported => {
                channel.remark(&mut channel.lock(), describe_open_failure(topic, &error));
                is_reported = true;
            }
            Err(_) => {}
        }
        sleep(MASTER_RETRY_INTERVAL).await;
    }
}
