//! ROS 2 topics over DDS, without a ROS installation.
//!
//! A [`Ros2Node`] takes part in one DDS domain and opens [`Ros2Publisher`]s and [`Ros2Subscription`]s. Messages are
//! bytes: a CDR encapsulation header of 4 bytes, then the CDR form of the message. A received message is copied once; a
//! message to be sent is not copied.
//!
//! Settings, names and QoS are part of every build, so a configuration is checked everywhere. DDS needs the cargo
//! feature `ros2`, which is off by default because it brings many crates. Without it [`Ros2Node::new`] returns
//! [`Ros2Error::NotBuilt`], so that callers need no `cfg`.

mod discovered;
#[cfg(any(feature = "ros2", test))]
#[cfg_attr(not(feature = "ros2"), expect(dead_code, reason = "only the DDS node uses all of it"))]
mod discovery;
mod error;
mod interfaces;
mod names;
#[cfg(any(feature = "ros2", test))]
mod node_list;
mod peers;
mod qos;
mod sample;
mod settings;

#[cfg(feature = "ros2")]
mod dds;
#[cfg(feature = "ros2")]
pub use dds::{Ros2Node, Ros2Publisher, Ros2Subscription};

#[cfg(not(feature = "ros2"))]
mod not_built;
#[cfg(not(feature = "ros2"))]
pub use not_built::{Ros2Node, Ros2Publisher, Ros2Subscription};

/// `true` if this build supports ROS 2.
pub const IS_BUILT: bool = cfg!(feature = "ros2");

pub use discovered::{DiscoveredEndpoint, DiscoveredPublisher};
pub use error::{NoPeer, Ros2Error};
pub use interfaces::{UnknownInterface, check_interfaces};
pub use names::{absolute_topic, dds_type};
pub use peers::{EndpointId, EndpointRole, InvalidParticipantId, ParticipantId, PeerTable, Refusal};
pub use qos::{Durability, InvalidQos, QosProfile, Reliability};
pub use sample::{ReceiveCounts, ReceivedSample};
pub use settings::{Ros2Settings, SocketBufferWarning};
