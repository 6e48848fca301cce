//! Messages and connections over datagrams, without I/O; the caller provides the time.
//!
//! These modules serve transports over networks that lose, duplicate and reorder datagrams, such as UDP. A *virtual
//! connection* is opened by a [`handshake`], has heartbeats, and ends with a goodbye or after a silence of the other
//! end ([`connection`]). A message is split into [fragments](fragment). At the other end, [`reassembly`] completes the
//! message or counts it as lost and reports how many of its fragments arrived. A lost message is retransmitted only if
//! it has no tag and is at most 64 KiB long. Requests and answers have a tag; all other messages have none.
//!
//! [`window`] bounds the bytes in flight, [`arrival_counter`] counts the losses of datagrams, [`endpoint`] has all
//! connections of a port, and [`packet`] describes the wire form.
//!
//! Any packet may have been altered or forged on the way. A number far above the expected number is therefore believed
//! only if a second packet agrees ([`receiving`], [`arrival_counter`]). A reported total is also believed only if a
//! second packet agrees ([`measurement`]). A packet that contradicts this end's own state makes a [`false_claim`]. A
//! single false claim has no effect.

pub(crate) mod arrival_counter;
pub(crate) mod connection;
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

/// Smallest datagram that can be configured, and that a peer may ask for. Bytes.
pub(crate) const MIN_DATAGRAM_BYTES: u16 = 512;
