//! Options of TCPROS sockets, and reading of frames.

use std::io;

use bytes::Bytes;
use socket2::{SockRef, TcpKeepalive};
use tokio::io::AsyncReadExt;
use tokio::net::TcpStream;

use super::limits::{KEEPALIVE_IDLE, KEEPALIVE_INTERVAL, KEEPALIVE_PROBES, USER_TIMEOUT};
use super::memory::MessageMemory;
use super::subscriber::SubscribedTopic;
use super::tcpros::{FrameBuffer, FrameError};

/// Sets TCP_NODELAY, so that a small message does not wait for the acknowledgement of the message before it. Sets
/// keepalive and a timeout of the kernel, so that a vanished peer is noticed whether or not something is being sent.
pub(super) fn configure(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let keepalive = TcpKeepalive::new()
        .with_time(KEEPALIVE_IDLE)
        .with_interval(KEEPALIVE_INTERVAL)
        .with_retries(KEEPALIVE_PROBES);
    let socket = SockRef::from(stream);
    socket.set_tcp_keepalive(&keepalive)?;
    socket.set_tcp_user_timeout(Some(USER_TIMEOUT))
}

/// Reads until a frame is complete. Returns the frame with its memory; `None` if the peer has closed the connection
/// between two frames.
///
/// The limits of a topic are read again whenever bytes have arrived, because they may change while the next frame is
/// awaited. A header has no topic; only the limit of `buffer` applies to a header.
async fn read_frame(
    stream: &mut TcpStream,
    buffer: &mut FrameBuffer,
    topic: Option<&SubscribedTopic>,
) -> io::Result<Option<(Bytes, MessageMemory)>> {
    loop {
        if let Some(topic) = topic {
            buffer.set_limits(&topic.message_limits());
        }
        let frame = buffer.next_frame().map_err(into_io_error)?;
        if frame.is_some() {
            return Ok(frame);
        }
        if stream.read_buf(&mut buffer.input().map_err(into_io_error)?).await? == 0 {
            let is_between_frames = !buffer.has_partial_frame();
            return if is_between_frames { Ok(None) } else { Err(io::ErrorKind::UnexpectedEof.into()) };
        }
    }
}

/// Reads a connection header. Returns `None` if the peer has closed the connection before the header.
pub(super) async fn read_header(
    stream: &mut TcpStream,
    buffer: &mut FrameBuffer,
) -> io::Result<Option<Bytes>> {
    Ok(read_frame(stream, buffer, None).await?.map(|(header, _)| header))
}

/// Reads a message of a topic. Returns the message with its memory; `None` if the peer has closed the connection
/// between two messages.
pub(super) async fn read_message(
    stream: &mut TcpStream,
    buffer: &mut FrameBuffer,
    topic: &SubscribedTopic,
) -> io::Result<Option<(Bytes, MessageMemory)>> {
    read_frame(stream, buffer, Some(topic)).await
}

fn into_io_error(error: FrameError) -> io::Error {
    let kind = match error {
        FrameError::TooLong { .. } => io::ErrorKind::InvalidData,
        FrameError::NoMemory { .. } => io::ErrorKind::OutOfMemory,
    };
    io::Error::new(kind, error)
}
