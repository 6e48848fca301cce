//! `ros`: messages on topics of ROS, which other programs of ROS can see.
//!
//! An edge asks on the topic `/NAME/sessions` for a connection to the topics of its pipeline. Then both talk on
//! `PIPELINE/request_info` and `PIPELINE/response_info`, whose messages have the frames of ours; the first part of a sample
//! travels on `PIPELINE/request` or `PIPELINE/response` as a message of a type that tools know, once the other end has
//! subscribed to it. [`connection`] and [`pairing`] have the protocol without I/O; [`channel`] and [`serving`] are one end of a
//! connection, which [`edge`] and [`cloud`] open.

mod channel;
mod checks;
mod cloud;
mod connection;
mod connection_clock;
mod edge;
mod frames;
mod interface;
mod limits;
mod names;
mod pairing;
mod parts;
mod payload;
mod payload_topic;
mod ros1;
mod ros2;
mod second_publishers;
mod serving;
mod version;

pub(crate) use checks::HOST_CHECKS;
pub(crate) use cloud::bind;
pub(crate) use edge::dial;

use std::io;

use super::AddressForm;
use crate::Address;

/// Form of addresses: the place of the master, and the name of the cloud.
pub(crate) const ADDRESS_FORM: AddressForm =
    AddressForm::Named { port: 11311, name: "peernet", in_domain: "ros2", find: version::find };

/// Ports are the system's choice: there is nothing to try.
pub(crate) fn try_bind(_address: &Address) -> io::Result<()> {
    Ok(())
}
