//! Types of PEERNet's package `peernet_msgs`, which carry sessions over topics.

use bytes::Bytes;

use super::field::struct_field;
use super::{Header, Message, MessageDefinition};

/// `peernet_msgs/SessionHello`: request of an edge for a connection, on the topic `/NAME/sessions` of a cloud.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SessionHello {
    /// Header whose `frame_id` is the connection's random identifier, 32 hexadecimal digits.
    pub header: Header,
    /// Name of the edge's node.
    pub node: String,
    /// Identifier of the edge's host.
    pub host: String,
    /// Global name of the pipeline, which is the prefix of its topics.
    pub pipeline: String,
}

struct_field!(SessionHello { header: Header, node: String, host: String, pipeline: String });

impl Message for SessionHello {
    const DEFINITION: &'static MessageDefinition = &MessageDefinition {
        name: "peernet_msgs/SessionHello",
        md5: "ecb45007684a8caf9068606c041792bc",
        text: "std_msgs/Header header\nstring node\nstring host\nstring pipeline\n",
        dependencies: &[&Header::DEFINITION],
    };
    const DDS_TYPE: &'static str = "peernet_msgs::msg::dds_::SessionHello_";
}

/// `peernet_msgs/MessageInfo`: a companion. It carries a message without its payload, on the topic
/// `<payload topic>_info`.
///
/// If [`has_payload`](Self::has_payload) is set, the payload message with the same `header.stamp` and `header.frame_id`
/// belongs to the companion. `std_msgs/UInt8MultiArray` has no header, so the label of its first dimension
/// contains the stamp and the identifier.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MessageInfo {
    /// Header whose `frame_id` is the connection's identifier. Its `stamp` is the departure by the sender's wall clock;
    /// the `stamp` increases from message to message.
    pub header: Header,
    /// Kind of the message: one of the constants.
    pub kind: u8,
    /// Number of the companion on this topic and connection, from 0.
    pub sequence: u64,
    /// Number of the request that the message belongs to; [`NO_REQUEST`](Self::NO_REQUEST) if the message belongs to no
    /// request.
    pub request: u64,
    /// `true` if the third frame, which is the first part of the sample, is the data of the payload message and not a
    /// part of [`frames`](Self::frames).
    pub has_payload: bool,
    /// Length of each frame of the message in bytes: header, tree, and the parts of the sample. In a
    /// [`HELLO`](Self::HELLO) and a [`WELCOME`](Self::WELCOME) of ROS 2 this list has one number: the size of the
    /// sender's socket buffers, which no payload message may exceed.
    pub frame_lengths: Vec<u32>,
    /// Concatenated frames.
    pub frames: Bytes,
    /// Reason for the end of the connection.
    pub reason: String,
}

struct_field!(MessageInfo {
    header: Header,
    kind: u8,
    sequence: u64,
    request: u64,
    has_payload: bool,
    frame_lengths: Vec<u32>,
    frames: Bytes,
    reason: String,
});

impl MessageInfo {
    /// Kind of a message with frames.
    pub const DATA: u8 = 0;
    /// Kind of a hello. The edge repeats its hello until it gets [`WELCOME`](Self::WELCOME).
    pub const HELLO: u8 = 1;
    /// Kind of the cloud's answer to a hello.
    pub const WELCOME: u8 = 2;
    /// Kind of a heartbeat, which shows that the sender still runs.
    pub const HEARTBEAT: u8 = 3;
    /// Kind of a notice that the message of a request arrived incompletely.
    pub const LOST: u8 = 4;
    /// Kind of a goodbye, which ends the connection.
    pub const GOODBYE: u8 = 5;
    /// Kind of a confirmation that the sender receives the payload topic (ROS 2 only).
    pub const SUBSCRIBED: u8 = 6;
    /// Kind of a companion with a fragment of the frames of a message. The companion with the remaining bytes follows
    /// and has the same stamp (ROS 2 only).
    pub const PART: u8 = 7;
    /// Value of [`request`](Self::request) in a message that belongs to no request.
    pub const NO_REQUEST: u64 = u64::MAX;
}

impl Message for MessageInfo {
    const DEFINITION: &'static MessageDefinition = &MessageDefinition {
        name: "peernet_msgs/MessageInfo",
        md5: "bcd1973f585a8ee7fae73511934453d5",
        text: "uint8 DATA=0\nuint8 HELLO=1\nuint8 WELCOME=2\nuint8 HEARTBEAT=3\nuint8 LOST=4\nuint8 GOODBYE=5\n\
               uint8 SUBSCRIBED=6\nuint8 PART=7\n\
               std_msgs/Header header\nuint8 kind\nuint64 sequence\nuint64 request\nbool has_payload\n\
               uint32[] frame_lengths\nuint8[] frames\nstring reason\n",
        dependencies: &[&Header::DEFINITION],
    };
    const DDS_TYPE: &'static str = "peernet_msgs::msg::dds_::MessageInfo_";
}
