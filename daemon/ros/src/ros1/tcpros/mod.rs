//! TCPROS without I/O: connection headers, what both sides check in them, and the frames of messages.

mod framing;
mod handshake;
mod header;
#[cfg(test)]
mod tests;

pub use framing::{FrameBuffer, FrameError};
pub use handshake::{HandshakeError, Publication, Subscription, TopicType};
pub use header::{ConnectionHeader, HeaderError};

/// Longest connection header that is read. The longest part of it is the definition of the message type.
pub const MAX_HEADER_BYTES: usize = 256 * 1024;
