//! The DDS part of the ROS 2 client. Nothing outside this folder names `rustdds`.
//!
//! `rustdds` was chosen because it is pure Rust and exchanges messages with Cyclone DDS and Fast DDS (tested in
//! `tests/interop/ros2/run.sh`). `ros2-client` on top of it would add names and the node list, which take 200 lines
//! here, and a code generator for typed messages, which is not needed. Limitations of `rustdds` 0.15, and how they are
//! handled:
//!
//! - It compares the names of topics, but not the types. Publishers of another type are refused, and their messages are
//! dropped.
//! - It drops unread messages of a publisher that leaves, including acknowledged ones. Messages must be taken as they
//!   arrive.
//! - It does not report which messages were lost. Gaps between the sequence numbers of each publisher are counted.
//! - It repairs 8 lost fragments of 256 bytes per round of 10 ms. At most 1 MiB is unacknowledged, or half of the
//!   receive buffer. There is a warning if the kernel limits the socket buffers.
//! - It does not know whether the peer has found us as well. On a volatile topic the first messages after a match may
//!   be lost; sessions repeat their hello and confirm payloads.
//! - It keeps the cache of a topic, with its last messages, until the participant ends. `depth` is small; a task takes
//!   messages out at once.
//! - It takes the publisher's time from the last datagram of a message, in which Cyclone DDS does not repeat it.
//!   `source_time` is `None`.
//! - It allocates the size that the first fragment of a message claims, up to 4 GiB. Not handled: a host that may join
//!   the domain can exhaust the memory.
//! - It has no static peers, and cannot switch discovery off. `ROS_STATIC_PEERS` is ignored,
//!   `ROS_AUTOMATIC_DISCOVERY_RANGE=OFF` is an error.
//! - It logs through the crate `log`. Its log is not shown.
//!
//! Fast DDS uses the kernel's default receive buffer of 212,992 bytes unless it is configured otherwise. Messages of 1
//! MB do not arrive there until `receiveBufferSize` of its transport, or `net.core.rmem_default` of its host, is
//! raised.

mod conversions;
mod endpoint;
mod interfaces;
mod node;
mod publisher;
mod queries;
mod raw_message;
mod sequence_tracker;
mod subscription;

pub use node::Ros2Node;
pub use publisher::Ros2Publisher;
pub use subscription::Ros2Subscription;
