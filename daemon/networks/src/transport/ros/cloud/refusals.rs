//! Refusals of connections.

use std::sync::{Arc, Mutex, PoisonError};

use peernet_clock::{LogThrottle, SharedClock};
use peernet_ros::messages::{Header, Message, MessageInfo, SessionHello};
use tokio::sync::mpsc;

use super::peers::Delivery;
use crate::transport::ListenerEvent;
use crate::transport::ros::interface::{NodeFailure, RemoteNode, SessionNode, SessionPublisher};

/// Publishes the reasons of refusals for edges, and reports refusals to the layer above. An edge repeats its request,
/// so the same refusal may occur often.
#[derive(Debug)]
pub(super) struct Refusals {
    node: Arc<dyn SessionNode>,
    clock: SharedClock,
    publisher: Box<dyn SessionPublisher>,
    deliveries: mpsc::Sender<Delivery>,
    throttle: Mutex<LogThrottle>,
}

impl Refusals {
    pub(super) fn new(
        (node, clock): (Arc<dyn SessionNode>, SharedClock),
        publisher: Box<dyn SessionPublisher>,
        deliveries: mpsc::Sender<Delivery>,
    ) -> Self {
        Self { node, clock, publisher, deliveries, throttle: Mutex::default() }
    }

    /// Refuses a connection that cannot be opened now. Reports the refusal to the layer above once a minute for each
    /// reason and address.
    pub(super) fn refuse(&self, hello: &SessionHello, edge: &RemoteNode, reason: &str) {
        let address = Some(edge.remote.ip());
        let mut throttle = self.throttle.lock().unwrap_or_else(PoisonError::into_inner);
        let is_due = throttle.count_event(reason, address, self.clock.mono()).is_some();
        drop(throttle);
        // The reason is published each time, because an edge waits for the refusal of its own connection.
        self.publish(hello, reason);
        if is_due {
            self.report(hello, edge, reason);
        }
    }

    /// Refuses a connection whose opening failed. Reports every such refusal to the layer above.
    pub(super) fn refuse_after_failure(&self, hello: &SessionHello, edge: &RemoteNode, reason: &str) {
        self.publish(hello, reason);
        self.report(hello, edge, reason);
    }

    fn publish(&self, hello: &SessionHello, reason: &str) {
        let header = Header { frame_id: hello.header.frame_id.clone(), ..Header::default() };
        let goodbye = MessageInfo {
            header,
            kind: MessageInfo::GOODBYE,
            request: MessageInfo::NO_REQUEST,
            reason: peernet_sample::printable_line(reason).into_owned(),
            ..MessageInfo::default()
        };
        let encoded = goodbye.encode(self.node.form()).map_err(|error| NodeFailure(error.to_string()));
        if let Err(error) = encoded.and_then(|message| self.publisher.publish(message)) {
            let topic = self.publisher.topic();
            tracing::debug!(%error, topic, "cannot publish the reason of a refusal");
        }
    }

    fn report(&self, hello: &SessionHello, edge: &RemoteNode, reason: &str) {
        let node = self.node.describe(&edge.node);
        let pipeline = peernet_sample::printable_line(&hello.pipeline);
        let reason = peernet_sample::printable_line(reason);
        let host = edge.remote.ip();
        let text = format!("refused a connection to {node} on {host} for pipeline {pipeline}: {reason}");
        let refused = ListenerEvent::Refused(hello.host.parse().ok(), text.clone());
        // The layer above records the refusal. If the queue of events is full, the refusal is logged here.
        if self.deliveries.try_send((refused, Vec::new())).is_err() {
            tracing::warn!("{text}");
        }
    }
}

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;

    use peernet_clock::{ClockIdentity, ManualClock, Span, WallTime};

    use super::*;
    use crate::transport::ros::interface::test_node::TestNode;

    #[test]
    fn repeated_refusal_is_reported_once_a_minute() {
        let identity = ClockIdentity::new("boot", "system");
        let clock = Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), identity));
        let (sender, mut deliveries) = mpsc::channel(10);
        let shared =
            (Arc::new(TestNode::default()) as Arc<dyn SessionNode>, Arc::clone(&clock) as SharedClock);
        let refusals = Refusals::new(shared, Box::new(TestNode::default()), sender);
        let hello =
            SessionHello { host: "robot".into(), pipeline: "/line".into(), ..SessionHello::default() };
        let address = SocketAddr::from(([192, 0, 2, 1], 1));
        let edge = RemoteNode { node: "/edge".into(), local: address, remote: address };
        let mut is_reported = |refuse: &dyn Fn(&Refusals)| {
            refuse(&refusals);
            let Ok((ListenerEvent::Refused(_, text), _)) = deliveries.try_recv() else { return false };
            assert_eq!(text, "refused a connection to /edge on 192.0.2.1 for pipeline /line: too many");
            true
        };
        let repeated = |refusals: &Refusals| refusals.refuse(&hello, &edge, "too\nmany");
        let failed = |refusals: &Refusals| refusals.refuse_after_failure(&hello, &edge, "too\nmany");
        assert_eq!([is_reported(&repeated), is_reported(&repeated)], [true, false]);
        assert_eq!([is_reported(&failed), is_reported(&failed)], [true, true]);
        clock.advance(Span::from_seconds(60));
        assert!(is_reported(&repeated));
    }
}
