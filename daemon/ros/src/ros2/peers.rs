//! Peers of an endpoint: the endpoints at the other end of its topic.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::str::FromStr;

/// Identity of a publisher or subscription in DDS (its GUID): 12 bytes of the participant and 4 of the endpoint.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct EndpointId(pub [u8; 16]);

/// Identity of a participant: the first 12 bytes of the identities of its endpoints.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ParticipantId(pub [u8; 12]);

/// Role of an endpoint on its topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EndpointRole {
    /// The endpoint publishes.
    Publisher,
    /// The endpoint subscribes.
    Subscription,
}

/// Reason why an endpoint exchanges no messages with an endpoint at the other end of its topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The peer gives the topic another message type.
    OtherType {
        /// Type of the peer, such as `std_msgs/msg/String`.
        type_name: String,
    },
    /// The subscription requests more than the publisher offers.
    IncompatibleQos {
        /// Name of the policy, such as `reliability`.
        policy: String,
        /// Value that the publisher offers.
        offered: String,
        /// Value that the subscription requests.
        requested: String,
    },
}

/// Endpoints that exist at the other end of a topic.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PeerTable {
    /// Endpoints with which messages are exchanged.
    pub matched: BTreeSet<EndpointId>,
    /// Endpoints with which no messages are exchanged, with the reasons.
    pub refused: BTreeMap<EndpointId, Refusal>,
    /// Number of peers that were matched since the endpoint was created.
    pub matched_total: u64,
    /// Number of matched peers that have left or do not match any more.
    pub unmatched_total: u64,
}

impl EndpointId {
    /// Returns the identity of the participant, which all endpoints of a node have in common.
    pub fn participant(self) -> ParticipantId {
        let [participant @ .., _, _, _, _] = self.0;
        ParticipantId(participant)
    }

    /// Returns the role, which is in the last byte (RTPS 2.5, section 9.3.1.2); `None` if the byte stands for another
    /// kind of entity.
    pub fn role(self) -> Option<EndpointRole> {
        match self.0[15] & 0x0f {
            0x02 | 0x03 => Some(EndpointRole::Publisher),
            0x04 | 0x07 => Some(EndpointRole::Subscription),
            _ => None,
        }
    }
}

/// Error: the text is not the identity of a participant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the identity of a participant has 24 hexadecimal digits")]
pub struct InvalidParticipantId;

impl FromStr for ParticipantId {
    type Err = InvalidParticipantId;

    fn from_str(text: &str) -> Result<Self, InvalidParticipantId> {
        let mut id = [0; 12];
        // Slicing below needs single-byte characters, and `from_str_radix` would accept a sign.
        if text.len() != 2 * id.len() || !text.bytes().all(|digit| digit.is_ascii_hexdigit()) {
            return Err(InvalidParticipantId);
        }
        for (index, byte) in id.iter_mut().enumerate() {
            *byte =
                u8::from_str_radix(&text[2 * index..2 * index + 2], 16).map_err(|_| InvalidParticipantId)?;
        }
        Ok(Self(id))
    }
}

impl fmt::Display for ParticipantId {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(formatter, "{byte:02x}"))
    }
}

#[cfg(any(feature = "ros2", test))]
impl PeerTable {
    /// Adds a matched peer. Returns whether the table has changed.
    pub(super) fn add(&mut self, id: EndpointId) -> bool {
        let was_refused = self.refused.remove(&id).is_some();
        let is_new = self.matched.insert(id);
        self.matched_total += u64::from(is_new);
        was_refused || is_new
    }

    /// Removes a peer, whether it is matched or refused.
    pub(super) fn remove(&mut self, id: EndpointId) {
        self.refused.remove(&id);
        self.unmatched_total += u64::from(self.matched.remove(&id));
    }
}

impl EndpointRole {
    /// Returns the role at the other end of the topic.
    pub fn opposite(self) -> Self {
        match self {
            Self::Publisher => Self::Subscription,
            Self::Subscription => Self::Publisher,
        }
    }
}

impl fmt::Display for EndpointRole {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Publisher => "publisher",
            Self::Subscription => "subscription",
        })
    }
}

impl fmt::Display for EndpointId {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(formatter, "{byte:02x}"))
    }
}

impl fmt::Debug for EndpointId {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, formatter)
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OtherType { type_name } => write!(formatter, "its message type is {type_name}"),
            Self::IncompatibleQos { policy, offered, requested } => write!(
                formatter,
                "the QoS policy {policy} does not fit: the publisher offers {offered}, the subscription requests \
                 {requested}"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn participant_id_round_trips_as_text() {
        let id = ParticipantId([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 0xab, 0xff]);
        assert_eq!(id.to_string().parse(), Ok(id));
        for other in ["", "00", "0001020304050607080900zz", "+001020304050607080900ab", "äääääääääääää"]
        {
            assert_eq!(other.parse::<ParticipantId>(), Err(InvalidParticipantId), "{other}");
        }
    }
}
