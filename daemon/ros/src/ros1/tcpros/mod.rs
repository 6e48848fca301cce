//! TCPROS without I/O: connection headers, their checks on both sides, and the frames of messages.

mod framing;
mod handshake;
mod header;
#[cfg(test)]
mod tests;

pub use framing::{FrameBuffer, FrameError};
pub use handshake::{HandshakeError, Publication, Subscription, TopicType};
pub use header::{ConnectionHeader, HeaderError};

/// Longest accepted connection header, bytes. The longest field is the definition of the message type.
pub const MAX_HEADER_BYTES: usize = 256 * 1024;
