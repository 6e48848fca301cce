//! The DDS part of the ROS 2 client. Nothing outside this folder names `rustdds`.
//!
//! `rustdds` was chosen because it is pure Rust and exchanges messages with Cyclone DDS and Fast DDS (tested in
//! `tests/interop/ros2/run.sh`). `ros2-client` on top of it would add names and the node list, which take 200 lines
//! here, and a code generator for typed messages, which is not needed. Limitations of `rustdds` 0.15, and how they are
//! handled:
//!
//! - It compares the names of topics, but not the types. Therefore this client refuses publishers of another type, and
//!   drops their messages.
//! - It drops unread messages of a publisher that leaves, including acknowledged messages. Therefore callers must take
//!   messages as they arrive.
//! - It does not report which messages were lost. Therefore gaps between the sequence numbers of each publisher are
//!   counted.
//! - It repairs 8 lost fragments of 256 bytes per round of 10 ms. Therefore at most 1 MiB, or half of the receive
//!   buffer if that is less, is unacknowledged, and a warning appears if the kernel limits the socket buffers.
//! - It does not know whether the peer has discovered us as well, so on a volatile topic the first messages after a
//!   match may be lost. Therefore sessions repeat their hello and confirm payloads.
//! - It keeps the cache of a topic, with its last messages, until the participant ends. Therefore `depth` is small, and
//!   a task takes messages out of the cache at once.
//! - It takes the publisher's time from the last datagram of a message, in which Cyclone DDS does not repeat the time.
//!   `source_time` is then `None`.
//! - It allocates the size that the first fragment of a message claims, up to 4 GiB. This is not handled: a host that
//!   may join the domain can exhaust the memory.
//! - It has no static peers, and cannot switch discovery off. Therefore `ROS_STATIC_PEERS` is ignored, and
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
