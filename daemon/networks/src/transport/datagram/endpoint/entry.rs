//! A connection in the table of a port.

use std::net::{IpAddr, SocketAddr};

use peernet_clock::{MonoTime, Span};

use crate::transport::datagram::connection::Connection;

/// Rights of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Admission {
    /// The connection has no session and has not asked for one.
    Unadmitted { since: MonoTime },
    /// The connection has asked for a session and waits for the decision.
    Greeted,
    /// The connection has a session.
    Admitted,
}

/// A connection of a port, with the addresses of its other end.
#[derive(Debug)]
pub(super) struct Entry {
    pub(super) connection: Connection,
    /// Address from which the connection's datagrams come.
    pub(super) source: SocketAddr,
    /// Port to which answers are sent; 0 means the port of `source`.
    pub(super) reply_port: u16,
    /// Address of this machine at which the datagrams arrive.
    pub(super) local: Option<IpAddr>,
    /// Random number of the edge's hello.
    pub(super) nonce: u64,
    /// Longest datagram that is sent to the other end. Bytes.
    pub(super) max_datagram_bytes: u16,
    pub(super) admission: Admission,
    /// Time of the last path challenge; `None` if there was none.
    pub(super) path_challenged_at: Option<MonoTime>,
    /// `true` after the first message was handed to the layer above.
    pub(super) has_delivered: bool,
    /// `true` while the connection is in the queue of connections that may have something to send.
    pub(super) is_ready: bool,
}

impl Entry {
    /// Creates an entry for a connection whose datagrams come from `source` and are answered at `reply_port` of the
    /// same host.
    pub(super) const fn new(
        connection: Connection,
        (source, reply_port): (SocketAddr, u16),
        local: Option<IpAddr>,
        nonce: u64,
        max_datagram_bytes: u16,
        admission: Admission,
    ) -> Self {
        Self {
            connection,
            source,
            reply_port,
            local,
            nonce,
            max_datagram_bytes,
            admission,
            path_challenged_at: None,
            has_delivered: false,
            is_ready: false,
        }
    }

    /// Returns the address to which answers are sent.
    pub(super) fn reply_address(&self) -> SocketAddr {
        reply_address(self.source, self.reply_port)
    }

    /// Returns whether the hello timeout has passed since the connection last had a session or was opened, and the
    /// connection has not asked for a session.
    pub(super) fn has_missed_hello_timeout(&self, hello_timeout: Span, now: MonoTime) -> bool {
        matches!(self.admission, Admission::Unadmitted { since } if now - since >= hello_timeout)
    }

    /// Returns the time of the connection's next timer call.
    pub(super) fn next_timer(&self, hello_timeout: Span, now: MonoTime) -> MonoTime {
        let next = self.connection.next_timer(now);
        match self.admission {
            Admission::Unadmitted { since } => next.min(since + hello_timeout),
            _ => next,
        }
    }
}

/// Returns the address to which datagrams from `source` are answered. Its port is `reply_port` unless that is 0.
pub(super) fn reply_address(source: SocketAddr, reply_port: u16) -> SocketAddr {
    SocketAddr::new(source.ip(), if reply_port == 0 { source.port() } else { reply_port })
}
