//! Connection to a controller. No call blocks beyond its deadline, except while the system resolves the name of a host.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::num::NonZeroU64;
use std::time::Duration;

use peernet_clock::{MonoTime, SharedClock, Span};

use super::SocketAddress;
use super::address::Protocol;
use super::line::{self, MAX_LINE_BYTES};
use crate::{Feedback, SocketError};

/// Maximum number of bytes that are discarded before an answer is sent.
// Without a maximum, a controller that sends without pause would delay the action for ever.
const MAX_DISCARDED_BYTES: usize = 1 << 20;

/// Deadline of an action.
pub(super) struct Deadline {
    pub(super) clock: SharedClock,
    /// Time at which the action must have ended.
    pub(super) until: MonoTime,
    /// The configured timeout, for error texts.
    pub(super) timeout_ms: NonZeroU64,
}

impl Deadline {
    /// Returns the remaining time.
    ///
    /// # Errors
    /// If the deadline has passed.
    fn remaining(&self) -> io::Result<Duration> {
        let remaining = self.until - self.clock.mono();
        // The system rounds a timeout below a microsecond down to zero, which would mean no timeout.
        if remaining >= Span::from_micros(1) {
            Ok(remaining.to_duration())
        } else {
            Err(ErrorKind::TimedOut.into())
        }
    }
}

/// Socket of a connection.
enum Channel {
    Udp(UdpSocket),
    Tcp(TcpStream),
}

/// Connection to a controller.
pub(super) struct Connection {
    address: String,
    channel: Channel,
    /// Bytes received over TCP that no call has returned yet; they may end within a line.
    received: Vec<u8>,
}

impl Connection {
    /// Connects to a controller.
    ///
    /// # Errors
    /// If no connection to any address of the host can be opened before the deadline.
    pub(super) fn open(address: &SocketAddress, deadline: &Deadline) -> Result<Self, SocketError> {
        let connect_error = |error: io::Error| match error.kind() {
            ErrorKind::TimedOut | ErrorKind::WouldBlock => SocketError::TimedOut {
                address: address.to_string(),
                waited_for: "accept the connection",
                timeout_ms: deadline.timeout_ms,
            },
            _ => SocketError::Connect { address: address.to_string(), error },
        };
        let mut last_error = io::Error::new(ErrorKind::NotFound, "the host has no address");
        let resolve_error = |error: io::Error| SocketError::Resolve { address: address.to_string(), error };
        for resolved in address.host_and_port.to_socket_addrs().map_err(resolve_error)? {
            match open_channel(address.protocol, resolved, deadline) {
                Ok(channel) => {
                    return Ok(Self { address: address.to_string(), channel, received: Vec::new() });
                }
                Err(error) => last_error = error,
            }
        }
        Err(connect_error(last_error))
    }

    /// Discards the bytes that the controller sent while no answer waited for feedback. Returns `false` if the
    /// controller has closed the connection or the socket has failed.
    ///
    /// # Errors
    /// If a controller that gives feedback sent such bytes over TCP: every later line would be taken for the feedback
    /// on another action. Datagrams are always discarded, because the network may have duplicated them.
    pub(super) fn discard_unsolicited(&mut self, has_feedback: bool) -> Result<bool, SocketError> {
        let mut buffer = [0; 4096];
        let mut discarded = self.received.len();
        while discarded <= MAX_DISCARDED_BYTES {
            match self.channel.try_read(&mut buffer) {
                Ok(0) if matches!(self.channel, Channel::Tcp(_)) => return Ok(false),
                Ok(read) if has_feedback && matches!(self.channel, Channel::Tcp(_)) => {
                    self.received.extend_from_slice(&buffer[..read]);
                    break;
                }
                // An empty datagram counts as one byte, so that a stream of empty datagrams ends the loop, too.
                Ok(read) => discarded += read.max(1),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return Ok(false),
            }
        }
        if self.received.is_empty() {
            return Ok(true);
        }
        Err(SocketError::Unsolicited { address: self.address.clone(), line: line::quote(&self.received) })
    }

    /// Sends a line.
    ///
    /// # Errors
    /// If the line cannot be sent before the deadline.
    pub(super) fn send(&mut self, line: &[u8], deadline: &Deadline) -> Result<(), SocketError> {
        let mut unsent = line;
        while !unsent.is_empty() {
            match self.channel.write(unsent, deadline) {
                Ok(0) => return Err(self.io_error(SENDING, ErrorKind::WriteZero.into(), deadline)),
                Ok(written) => unsent = &unsent[written..],
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(self.io_error(SENDING, error, deadline)),
            }
        }
        Ok(())
    }

    /// Receives the feedback on the action of an iteration. Ignores a line with the number of another iteration,
    /// because it may be a copy of an earlier datagram.
    ///
    /// # Errors
    /// If no line arrives before the deadline, or if the line is too long or is not feedback.
    pub(super) fn receive_feedback(
        &mut self,
        iteration: u64,
        deadline: &Deadline,
    ) -> Result<Feedback, SocketError> {
        let mut other_iteration = None;
        loop {
            let line = self.receive_line(deadline).map_err(|error| match (error, other_iteration) {
                (SocketError::TimedOut { address, timeout_ms, .. }, Some(other)) => {
                    SocketError::OtherIteration { address, other, iteration, timeout_ms }
                }
                (error, _) => error,
            })?;
            match line::decode(&line) {
                Ok((Some(other), _)) if other != iteration => other_iteration = Some(other),
                Ok((_, feedback)) => return Ok(feedback),
                Err(reason) => {
                    let (address, line) = (self.address.clone(), line::quote(&line));
                    return Err(SocketError::Feedback { address, line, reason });
                }
            }
        }
    }

    /// Receives a line, without its line feed. Each datagram is one line and may end with a line feed.
    fn receive_line(&mut self, deadline: &Deadline) -> Result<Vec<u8>, SocketError> {
        // The buffer has one byte more than the longest line, so that a longer datagram is not truncated to a valid
        // line.
        let mut buffer = vec![0; MAX_LINE_BYTES + 1];
        loop {
            if let Some(end) = self.received.iter().position(|byte| *byte == b'\n') {
                let after_line = self.received.split_off(end + 1);
                let mut line = std::mem::replace(&mut self.received, after_line);
                line.truncate(end);
                return Ok(line);
            }
            if self.received.len() >= MAX_LINE_BYTES {
                return Err(self.too_long_error());
            }
            match self.channel.read(&mut buffer, deadline) {
                Ok(0) if matches!(self.channel, Channel::Tcp(_)) => {
                    return Err(SocketError::Closed(self.address.clone()));
                }
                Ok(read) if matches!(self.channel, Channel::Udp(_)) => {
                    if read > MAX_LINE_BYTES {
                        return Err(self.too_long_error());
                    }
                    return Ok(buffer[..read].trim_ascii_end().to_vec());
                }
                Ok(read) => self.received.extend_from_slice(&buffer[..read]),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(self.receive_error(error, deadline)),
            }
        }
    }

    /// Returns the error of a failed read. If the controller sent a part of a line in time, the error quotes it.
    fn receive_error(&self, error: io::Error, deadline: &Deadline) -> SocketError {
        match self.io_error(RECEIVING, error, deadline) {
            SocketError::TimedOut { address, timeout_ms, .. } if !self.received.is_empty() => {
                SocketError::Unterminated { address, line: line::quote(&self.received), timeout_ms }
            }
            error => error,
        }
    }

    fn too_long_error(&self) -> SocketError {
        SocketError::FeedbackLength { address: self.address.clone(), limit: MAX_LINE_BYTES }
    }

    fn io_error(
        &self,
        (operation, waited_for): (&'static str, &'static str),
        error: io::Error,
        deadline: &Deadline,
    ) -> SocketError {
        let address = self.address.clone();
        match error.kind() {
            ErrorKind::TimedOut | ErrorKind::WouldBlock => {
                SocketError::TimedOut { address, waited_for, timeout_ms: deadline.timeout_ms }
            }
            _ => SocketError::Io { operation, address, error },
        }
    }
}

/// For the error texts of an operation: what PEERNet does with the controller, and what the controller should do.
const SENDING: (&str, &str) = ("send an answer to", "accept the answer");
/// See [`SENDING`].
const RECEIVING: (&str, &str) = ("receive feedback from", "send feedback");

fn open_channel(protocol: Protocol, address: SocketAddr, deadline: &Deadline) -> io::Result<Channel> {
    match protocol {
        Protocol::Udp => {
            let unspecified: SocketAddr = match address {
                SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
                SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
            };
            let socket = UdpSocket::bind(unspecified)?;
            // A connected socket receives datagrams of the controller only.
            socket.connect(address)?;
            Ok(Channel::Udp(socket))
        }
        Protocol::Tcp => {
            let stream = TcpStream::connect_timeout(&address, deadline.remaining()?)?;
            // Nagle's algorithm (RFC 896) would delay a short line until the previous line is acknowledged.
            stream.set_nodelay(true)?;
            Ok(Channel::Tcp(stream))
        }
    }
}

impl Channel {
    /// Reads bytes that have arrived. Fails with an error of the kind `WouldBlock` if no bytes have arrived.
    fn try_read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Udp(socket) => {
                socket.set_nonblocking(true)?;
                let read = socket.recv(buffer);
                socket.set_nonblocking(false)?;
                read
            }
            Self::Tcp(stream) => {
                stream.set_nonblocking(true)?;
                let read = stream.read(buffer);
                stream.set_nonblocking(false)?;
                read
            }
        }
    }

    fn read(&mut self, buffer: &mut [u8], deadline: &Deadline) -> io::Result<usize> {
        let timeout = Some(deadline.remaining()?);
        match self {
            Self::Udp(socket) => {
                socket.set_read_timeout(timeout)?;
                socket.recv(buffer)
            }
            Self::Tcp(stream) => {
                stream.set_read_timeout(timeout)?;
                stream.read(buffer)
            }
        }
    }

    fn write(&mut self, bytes: &[u8], deadline: &Deadline) -> io::Result<usize> {
        let timeout = Some(deadline.remaining()?);
        match self {
            Self::Udp(socket) => {
                socket.set_write_timeout(timeout)?;
                socket.send(bytes)
            }
            Self::Tcp(stream) => {
                stream.set_write_timeout(timeout)?;
                stream.write(bytes)
            }
        }
    }
}
