//! One connection among all those of a port.

use std::net::{IpAddr, SocketAddr};

use peernet_clock::{MonoTime, Span};

use crate::transport::datagram::connection::Connection;

/// What a connection may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Standing {
    Unadmitted { since: MonoTime },
    Greeted,
    Admitted,
}

/// A connection of a port, and where its other end is.
#[derive(Debug)]
pub(super) struct Entry {
    pub(super) connection: Connection,
    /// Where its datagrams come from.
    pub(super) source: SocketAddr,
    /// Where it is answered, if not there.
    pub(super) reply_port: u16,
    pub(super) local: Option<IpAddr>,
    pub(super) nonce: u64,
    pub(super) datagram: u16,
    pub(super) standing: Standing,
    pub(super) path_asked: Option<MonoTime>,
    pub(super) has_delivered: bool,
    pub(super) is_ready: bool,
}

impl Entry {
    /// A connection whose datagrams come from an address, and which is answered at a port there.
    pub(super) const fn new(
        connection: Connection,
        (source, reply_port): (SocketAddr, u16),
        local: Option<IpAddr>,
        nonce: u64,
        datagram: u16,
        standing: Standing,
    ) -> Self {
        Self {
            connection,
            source,
            reply_port,
            local,
            nonce,
            datagram,
            standing,
            path_asked: None,
            has_delivered: false,
            is_ready: false,
        }
    }

    /// Where it is answered.
    pub(super) fn reply_address(&self) -> SocketAddr {
        reply_address(self.source, self.reply_port)
    }

    /// Whether it has gone without a hello for too long.
    pub(super) fn is_late(&self, hello_timeout: Span, now: MonoTime) -> bool {
        matches!(self.standing, Standing::Unadmitted { since } if now - since >= hello_timeout)
    }

    /// When it is to be looked at.
    pub(super) fn next_timer(&self, hello_timeout: Span, now: MonoTime) -> MonoTime {
        let next = self.connection.next_timer(now);
        match self.standing {
            Standing::Unadmitted { since } => next.min(since + hello_timeout),
            _ => next,
        }
    }
}

/// Where datagrams from an address are answered to; the port is the one that its hello named, if not 0.
pub(super) fn reply_address(source: SocketAddr, reply_port: u16) -> SocketAddr {
    SocketAddr::new(source.ip(), if reply_port == 0 { source.port() } else { reply_port })
}
