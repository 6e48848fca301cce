//! The cloud's handling of one connection's events and admission.

use std::sync::Arc;
use std::time::Duration;

use peernet_ros::messages::MessageInfo;
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until};

use super::connection_table::Admission;
use super::payload_subscription::PayloadSubscription;
use super::peers::Delivery;
use crate::transport::ros::channel::Channel;
use crate::transport::ros::connection::Event;
use crate::transport::ros::connection_task::{Directive, Sink};
use crate::transport::ros::limits::ReceiveLimits;
use crate::transport::{CLOSED_HERE, ListenerEvent, Peer};

/// Hands the events of a connection to the layer above, and sets the connection's limits according to its admission.
pub(super) struct CloudSink {
    peer: Peer,
    admission: watch::Receiver<Admission>,
    /// Time limit for opening a session on a connection that has no session.
    hello_timeout: Duration,
    /// Time at which the connection ends; `None` while it has a session or has asked for one.
    deadline: Option<Instant>,
    unadmitted_limits: ReceiveLimits,
    admitted_limits: ReceiveLimits,
    payloads: PayloadSubscription,
}

impl CloudSink {
    pub(super) fn new(
        (peer, admission): (Peer, watch::Receiver<Admission>),
        hello_timeout: Duration,
        (unadmitted_limits, admitted_limits): (ReceiveLimits, ReceiveLimits),
        payloads: PayloadSubscription,
    ) -> Self {
        let deadline = Some(Instant::now() + hello_timeout);
        Self { peer, admission, hello_timeout, deadline, unadmitted_limits, admitted_limits, payloads }
    }

    fn apply_admission(&mut self, admission: Admission, channel: &Arc<Channel>) -> Directive {
        self.deadline = (admission == Admission::Unadmitted).then(|| Instant::now() + self.hello_timeout);
        if admission != Admission::Admitted {
            // If the connection had a session before, it stays subscribed to the payload topic.
            return Directive::SetLimits(self.unadmitted_limits.clone());
        }
        self.payloads.start(channel);
        Directive::SetLimits(self.admitted_limits.clone())
    }
}

impl Sink for CloudSink {
    type Delivery = Delivery;

    fn handle_event(&mut self, channel: &Channel, event: Event) -> Option<Delivery> {
        let connection = self.peer.connection;
        let (delivered_event, memory_reservations) = match event {
            Event::Hello => {
                // Each hello is answered: a welcome is lost if the edge has not yet found this publisher.
                channel.announce(MessageInfo::WELCOME);
                return None;
            }
            Event::Welcome => return None,
            Event::Message(frames, memory_reservations) => {
                (ListenerEvent::Message(self.peer.clone(), frames), memory_reservations)
            }
            Event::IncomingLost(loss) => (ListenerEvent::IncomingLost(connection, loss), Vec::new()),
            Event::OutgoingLost(loss) => (ListenerEvent::OutgoingLost(connection, loss), Vec::new()),
            Event::InvalidData(problem) => {
                (ListenerEvent::InvalidData(self.peer.address, problem), Vec::new())
            }
            Event::Remark(text) => (ListenerEvent::Remark(connection, text), Vec::new()),
            Event::Gone(reason) => (ListenerEvent::Gone(connection, reason), Vec::new()),
        };
        Some((delivered_event, memory_reservations))
    }

    async fn next_directive(&mut self, channel: &Arc<Channel>) -> Directive {
        let deadline = self.deadline;
        let hello_timeout_passed = async move {
            match deadline {
                Some(deadline) => sleep_until(deadline).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            subscriber = self.payloads.wait_until_open() => match subscriber {
                Ok(subscriber) => Directive::ReceivePayloads(subscriber),
                Err(error) => Directive::End(error.to_string()),
            },
            changed = self.admission.changed() => {
                let admission = *self.admission.borrow_and_update();
                match changed {
                    Ok(()) => self.apply_admission(admission, channel),
                    Err(_) => Directive::End(CLOSED_HERE.to_owned()),
                }
            }
            () = hello_timeout_passed => Directive::End("no session was opened in time".to_owned()),
        }
    }
}
