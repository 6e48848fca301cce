//! Errors of the ROS 2 client.

use std::time::Duration;

use super::interfaces::UnknownInterface;
use super::peers::{EndpointRole, Refusal};
use super::qos::InvalidQos;

/// Error of the ROS 2 client.
#[derive(Debug, thiserror::Error)]
pub enum Ros2Error {
    /// The program was built without ROS 2.
    #[error(
        "this build has no ROS 2; build peernetd with the cargo feature `ros2`, or install the packages, which have it"
    )]
    NotBuilt,
    /// The name is not allowed in ROS 2.
    #[error("`{name}` is not a valid {kind} name in ROS 2; a valid name is `{example}`")]
    InvalidName {
        /// The name.
        name: String,
        /// Kind of the named object.
        kind: &'static str,
        /// Example of an allowed name.
        example: &'static str,
    },
    /// An environment variable has an unsupported value.
    #[error("the environment variable {name} is `{value}`, but must be {expected}")]
    InvalidVariable {
        /// Name of the variable.
        name: &'static str,
        /// Value of the variable.
        value: String,
        /// Supported values.
        expected: &'static str,
    },
    /// The domain is out of range.
    #[error("the domain {domain_id} is out of range; ROS 2 has the domains 0 to 232")]
    InvalidDomain {
        /// The domain.
        domain_id: u16,
    },
    /// The QoS profile is invalid.
    #[error("the QoS of topic {topic} is not valid: {source}")]
    InvalidQos {
        /// The topic.
        topic: String,
        /// Reason.
        source: InvalidQos,
    },
    /// The network interface does not exist or has no IPv4 address.
    #[error(transparent)]
    UnknownInterface(#[from] UnknownInterface),
    /// The network interfaces could not be listed.
    #[error("cannot list the network interfaces of this host: {0}")]
    Interfaces(std::io::Error),
    /// The domain could not be joined.
    #[error("cannot join the ROS 2 domain {domain_id} on {interfaces}: {reason}")]
    Join {
        /// The domain.
        domain_id: u16,
        /// The network interfaces.
        interfaces: String,
        /// Reason.
        reason: String,
    },
    /// A publisher or subscription could not be created.
    #[error("cannot create a {role} of topic {topic}: {reason}")]
    Create {
        /// Kind of the endpoint.
        role: EndpointRole,
        /// The topic.
        topic: String,
        /// Reason.
        reason: String,
    },
    /// The payload does not begin with the encapsulation header of little-endian CDR.
    #[error("a payload for topic {topic} does not begin with the header 00 01 00 00 of little-endian CDR")]
    NotCdr {
        /// The topic.
        topic: String,
    },
    /// The message could not be published in time.
    #[error(
        "a message to topic {topic} was not published within {waited:?}: not all of its {peers} subscriptions keep up; lower the rate, or raise net.core.rmem_max on their hosts"
    )]
    PublishTimeout {
        /// The topic.
        topic: String,
        /// Length of the wait.
        waited: Duration,
        /// Number of matched subscriptions.
        peers: usize,
    },
    /// The message could not be published.
    #[error("cannot publish to topic {topic}: {reason}")]
    Publish {
        /// The topic.
        topic: String,
        /// Reason.
        reason: String,
    },
    /// Some published messages were not acknowledged in time.
    #[error(
        "subscriptions of topic {topic} did not acknowledge all messages within {waited:?}; unacknowledged messages are lost"
    )]
    Unacknowledged {
        /// The topic.
        topic: String,
        /// Length of the wait.
        waited: Duration,
    },
    /// Receiving failed permanently.
    #[error("cannot receive from topic {topic}: {reason}")]
    Receive {
        /// The topic.
        topic: String,
        /// Reason.
        reason: String,
    },
    /// Leaving the domain failed. Peers notice the end of the node only when its lease expires.
    #[error("cannot leave the ROS 2 domain {domain_id} cleanly: {reason}")]
    Leave {
        /// The domain.
        domain_id: u16,
        /// Reason.
        reason: String,
    },
    /// There is no peer on the topic.
    #[error("{0}")]
    NoPeer(Box<NoPeer>),
    /// The node was shut down.
    #[error("the node of topic {topic} was shut down")]
    ShutDown {
        /// The topic.
        topic: String,
    },
}

/// Error: no peer was found on a topic. The fields say what was tried.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", self.describe())]
pub struct NoPeer {
    /// Our role on the topic.
    pub role: EndpointRole,
    /// The topic.
    pub topic: String,
    /// Our message type.
    pub type_name: String,
    /// Length of the wait.
    pub waited: Duration,
    /// The domain.
    pub domain_id: u16,
    /// The network interfaces.
    pub interfaces: String,
    /// Number of other participants that were found in the domain.
    pub participants: usize,
    /// Peers on the topic that do not match: the names of their nodes, if known, and the reasons.
    pub refused: Vec<(Option<String>, Refusal)>,
    /// ROS 2 topics of other participants.
    pub topics: Vec<String>,
}

impl NoPeer {
    fn describe(&self) -> String {
        let Self { role, topic, type_name, domain_id, interfaces, participants, .. } = self;
        let peer = role.opposite();
        let seconds = self.waited.as_secs_f64();
        let tried = format!(
            "{topic} ({type_name}) was found within {seconds} s in domain {domain_id} on {interfaces}; {participants} other \
             participants were discovered"
        );
        if let Some((node, refusal)) = self.refused.first() {
            let other_count = self.refused.len() - 1;
            let remark_on_others =
                if other_count == 0 { String::new() } else { format!(" (and {other_count} more)") };
            let of_node = node.as_ref().map(|node| format!(" of node {node}")).unwrap_or_default();
            return format!(
                "no matching {peer} of topic {tried}; a {peer}{of_node} exists, but {refusal}{remark_on_others}; use the same settings at both ends"
            );
        }
        let advice = advise(*domain_id, interfaces, *participants, &self.topics);
        format!("no {peer} of topic {tried}; {advice}")
    }
}

/// Returns advice for the case that no peer was found. It depends on the number of discovered participants and on their
/// topics.
pub(super) fn advise(domain_id: u16, interfaces: &str, participants: usize, topics: &[String]) -> String {
    /// Maximum number of listed topics.
    const MAX_LISTED_TOPICS: usize = 8;
    if participants == 0 {
        return format!(
            "is the peer running, is its ROS_DOMAIN_ID {domain_id}, and does multicast to 239.255.0.1 reach it through \
             {interfaces}?"
        );
    }
    let mut listed = topics.iter().take(MAX_LISTED_TOPICS).cloned().collect::<Vec<_>>().join(", ");
    if topics.len() > MAX_LISTED_TOPICS {
        listed.push_str(", …");
    }
    if listed.is_empty() {
        listed.push_str("none");
    }
    format!("check the name of the topic; discovered topics: {listed}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn no_peer() -> NoPeer {
        NoPeer {
            role: EndpointRole::Subscription,
            topic: "/image".into(),
            type_name: "sensor_msgs/msg/Image".into(),
            waited: Duration::from_secs(5),
            domain_id: 7,
            interfaces: "lo (127.0.0.1)".into(),
            participants: 0,
            refused: Vec::new(),
            topics: Vec::new(),
        }
    }

    #[test]
    fn missing_peer_error_contains_attempts_and_advice() {
        let error = no_peer().to_string();
        for part in
            ["no publisher of topic /image", "within 5 s", "domain 7", "lo (127.0.0.1)", "ROS_DOMAIN_ID 7"]
        {
            assert!(error.contains(part), "{part}: {error}");
        }
        let error = NoPeer { participants: 1, topics: vec!["/camera".into()], ..no_peer() }.to_string();
        assert!(error.contains("discovered topics: /camera"), "{error}");
        let refusal = Refusal::OtherType { type_name: "std_msgs/msg/String".into() };
        for (node, expected) in
            [(Some("/talker".to_owned()), "publisher of node /talker exists"), (None, "publisher exists")]
        {
            let refused = vec![(node, refusal.clone())];
            let error = NoPeer { participants: 1, refused, ..no_peer() }.to_string();
            for part in [expected, "its message type is std_msgs/msg/String"] {
                assert!(error.contains(part), "{part}: {error}");
            }
        }
    }
}
