//! Subscriptions of ROS 2 topics.

use std::pin::pin;
use std::time::Duration;

use futures::StreamExt;
use peernet_clock::WallTime;
use rustdds::dds::ReadError;
use rustdds::no_key::SimpleDataReader;
use tokio::sync::watch;

use super::conversions::{endpoint_id, wall_time};
use super::endpoint::Endpoint;
use super::raw_message::{RawAdapter, RawMessage};
use super::sequence_tracker::SequenceTracker;
use crate::ros2::{EndpointId, PeerTable, ReceiveCounts, ReceivedSample, Ros2Error};

/// A subscription of a topic.
pub struct Ros2Subscription {
    // Dropped before the endpoint, which then removes the subscription from the node list.
    pub(super) reader: SimpleDataReader<RawMessage, RawAdapter>,
    pub(super) endpoint: Endpoint,
    pub(super) tracker: SequenceTracker,
    pub(super) counts: ReceiveCounts,
}

impl Ros2Subscription {
    /// Returns the identity of the subscription.
    pub fn id(&self) -> EndpointId {
        self.endpoint.id
    }

    /// Returns the absolute name of the topic.
    pub fn topic(&self) -> &str {
        &self.endpoint.topic
    }

    /// Returns a receiver of the publishers of the topic and their changes.
    pub fn peers(&self) -> watch::Receiver<PeerTable> {
        self.endpoint.peers.clone()
    }

    /// Returns the counts of received and lost messages.
    pub fn counts(&self) -> ReceiveCounts {
        self.counts
    }

    /// Waits for a publisher of the topic.
    ///
    /// # Errors
    ///
    /// [`Ros2Error::NoPeer`] if no publisher is found within `time_limit`; the error says what was
    /// tried.
    pub async fn wait_for_peer(&self, time_limit: Duration) -> Result<(), Ros2Error> {
        self.endpoint.wait_for_peer(time_limit).await
    }

    /// Waits for the next message. Its payload was copied once, out of the cache of `rustdds`.
    ///
    /// Cancel safe: dropping the future loses no message. Messages should be taken as they arrive, because `rustdds`
    /// drops messages of a publisher that leaves, and unread messages beyond [`depth`](crate::ros2::QosProfile::depth).
    ///
    /// # Errors
    ///
    /// [`Ros2Error::ShutDown`] after the node was shut down, [`Ros2Error::Receive`] if `rustdds` fails.
    pub async fn receive(&mut self) -> Result<ReceivedSample, Ros2Error> {
        loop {
            let next = {
                let mut messages = pin!(self.reader.as_async_stream());
                self.endpoint.node.closed.run_until_cancelled(messages.next()).await
            };
            let message = match next.flatten() {
                None => return Err(self.endpoint.shut_down_error()),
                Some(Ok(message)) => message,
                Some(Err(ReadError::Deserialization { .. })) => {
                    self.counts.undecodable += 1;
                    continue;
                }
                Some(Err(error)) => {
                    return Err(Ros2Error::Receive {
                        topic: self.endpoint.topic.clone(),
                        reason: error.to_string(),
                    });
                }
            };
            let writer = endpoint_id(message.writer_guid());
            if self.endpoint.node.discovery().has_other_type(self.endpoint.id, writer) {
                self.counts.other_type += 1;
                continue;
            }
            let sequence = i64::from(message.sequence_number);
            let missing_before = self.tracker.record(writer, sequence, &mut self.counts);
            self.counts.received += 1;
            return Ok(ReceivedSample {
                source_time: message.source_timestamp().and_then(wall_time),
                received_time: wall_time(message.receive_instant).unwrap_or(WallTime::from_unix_nanos(0)),
                payload: message.into_value().0,
                writer,
                sequence,
                missing_before,
            });
        }
    }
}
