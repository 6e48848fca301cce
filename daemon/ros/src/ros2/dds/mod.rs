//! What speaks DDS; nothing outside this folder names `rustdds`.

mod conversions;
mod endpoint;
mod interfaces;
mod node;
mod publisher;
mod raw_message;
mod sequence_tracker;
mod subscription;
mod survey;

pub use node::Ros2Node;
pub use publisher::Ros2Publisher;
pub use subscription::Ros2Subscription;
