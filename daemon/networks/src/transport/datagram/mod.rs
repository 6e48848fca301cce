//! Messages and connections over datagrams, without I/O and with time from outside.
//!
//! For transports whose network knows datagrams only: UDP, and what else loses, doubles and reorders what it carries.
//! A *virtual connection* is opened by a [`handshake`], has heartbeats, and is ended by a goodbye or by silence
//! ([`connection`]). A message is split into [fragments](fragment); at the other end [`reassembly`] puts it together
//! or counts it as lost, and then both ends learn how many of its fragments arrived. Nothing is sent again but what opens
//! and closes sessions. [`window`] bounds the bytes in flight, [`counting`] has the losses of datagrams, [`endpoint`] has all
//! connections of a port, and [`packet`] describes the wire form.
//!
//! Any packet may have been altered or forged on the way: a number far ahead and a total need a second packet that agrees
//! ([`receiving`], [`counting`], [`measurement`]), and what contradicts this end's own state is a [`false_claim`].

pub(crate) mod connection;
pub(crate) mod counting;
pub(crate) mod endpoint;
mod false_claim;
pub(crate) mod fragment;
pub mod fuzzing;
pub(crate) mod handshake;
mod measurement;
pub(crate) mod packet;
pub(crate) mod packet_writer;
mod partial_message;
pub(crate) mod reassembly;
pub(crate) mod receiving;
pub(crate) mod sending;
pub(crate) mod window;

#[cfg(test)]
mod tests;

/// The smallest datagram that can be configured, and that a peer may ask for.
pub(crate) const MIN_DATAGRAM_BYTES: u16 = 512;
