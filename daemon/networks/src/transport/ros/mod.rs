//! `ros`: messages on topics of ROS, which other ROS programs can see.
//!
//! An edge asks for a connection on the topic `/NAME/sessions`. A connection uses the topics of its pipeline,
//! `PIPELINE/request_info` and `PIPELINE/response_info`. A message on them is a *companion* and carries all frames
//! except the *payload*, which is the first part of a sample. The payload is sent on `PIPELINE/request` or
//! `PIPELINE/response` as a message of a standard type, which ROS tools can display, once the other end has subscribed
//! to that topic. Control messages have no payload, and a part whose type does not fit the topic is sent in the
//! companion. The first payload determines the type of a payload topic; the topic is opened in the background, and no
//! message waits until the topic is open.
//!
//! [`connection`] and [`pairing`] have the protocol without I/O. [`channel`] and [`connection_task`] are one end of a
//! connection, which [`edge`] and [`cloud`] open. All of them use nodes, publishers and subscribers through
//! [`interface`], which [`ros1`] and [`ros2`] implement.
//!
//! Decisions:
//!
//! - A cloud accepts messages only from the node that asked for the connection. The names of topics are derived from
//!   the pipeline's name, so that no edge can make a cloud publish on other topics.
//! - Before a session, a companion may have at most 64 KiB, and the cloud does not subscribe to the payload topic.
//! - TCPROS and reliable topics of ROS 2 retransmit lost messages, so that nothing is retransmitted here.
//! - The two topics of a direction have no common order, but each is in order. A later message on one topic therefore
//!   proves that this topic has lost the partner of an earlier message on the other topic. If no later message arrives,
//!   a deadline ends the wait. A goodbye, and a message about the session itself, waits for the payloads whose
//!   companions arrived before it.
//! - If a peer leaves one topic, the connection waits 500 ms for the peer's last messages on the other topic. Then the
//!   connection ends even if the peer has returned, because messages may have been lost.

mod channel;
mod checks;
mod cloud;
mod connection;
mod connection_clock;
mod connection_task;
mod edge;
mod fragments;
mod frames;
mod interface;
mod limits;
mod named_cloud;
mod names;
mod pairing;
mod payload;
mod payload_topic;
mod ros1;
mod ros2;
mod second_publishers;

pub(crate) use checks::HOST_CHECKS;
pub(crate) use cloud::bind;
pub(crate) use edge::dial;

use std::io;

use super::AddressForm;
use crate::Address;

/// Form of addresses: host and port of the master, and the name of the cloud.
pub(crate) const ADDRESS_FORM: AddressForm = AddressForm::Named {
    // Port of a ROS master by default.
    port: 11311,
    name: "peernet",
    domain_scheme: "ros2",
    find: named_cloud::find_address,
};

/// Does nothing, because the system chooses the ports.
pub(crate) fn try_bind(_address: &Address) -> io::Result<()> {
    Ok(())
}
