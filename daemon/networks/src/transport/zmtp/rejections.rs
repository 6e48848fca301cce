//! Connections that were refused or closed because of a limit or a violation of the protocol: counted by reason, and
//! logged at a limited rate.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use tokio::time::Instant;

/// Shortest interval between two log lines with the same reason.
pub(super) const LOG_INTERVAL: Duration = Duration::from_secs(60);

/// Reason why the listener refused or closed a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rejection {
    /// The maximum number of connections was open.
    TooMany,
    /// The maximum number of connections of the peer's address was open.
    TooManyOfAddress,
    /// The connection was not admitted, and a newer connection replaced it because a limit was reached.
    Replaced,
    /// The connection ended before the ZMTP handshake was complete: the peer closed the connection, took
    /// too long or violated the protocol.
    Handshake,
    /// No hello of the connection was accepted in time.
    NoHello,
    /// The connection sent or announced more than is allowed before its hello was accepted.
    LargeBeforeHello,
    /// The connection sent or announced a message that is larger than allowed.
    TooLarge,
    /// There was no memory for the connection's unfinished message.
    NoMemory,
    /// The connection sent nothing for longer than the heartbeat timeout.
    Silent,
    /// The connection violated the protocol after the handshake.
    Protocol,
}

impl Rejection {
    /// Every reason, in the order of declaration.
    pub const ALL: [Self; 10] = [
        Self::TooMany,
        Self::TooManyOfAddress,
        Self::Replaced,
        Self::Handshake,
        Self::NoHello,
        Self::LargeBeforeHello,
        Self::TooLarge,
        Self::NoMemory,
        Self::Silent,
        Self::Protocol,
    ];

    /// Returns the name of the reason in metrics.
    pub const fn name(self) -> &'static str {
        match self {
            Self::TooMany => "too_many",
            Self::TooManyOfAddress => "too_many_of_address",
            Self::Replaced => "replaced",
            Self::Handshake => "handshake",
            Self::NoHello => "no_hello",
            Self::LargeBeforeHello => "large_before_hello",
            Self::TooLarge => "too_large",
            Self::NoMemory => "no_memory",
            Self::Silent => "silent",
            Self::Protocol => "protocol",
        }
    }
}

/// Number of occurrences of each reason at one listener.
#[derive(Debug)]
pub struct RejectionCounts {
    /// Address of the listener, for log lines.
    listener_address: String,
    occurrences: [AtomicU64; Rejection::ALL.len()],
    /// Time of the last log line of each reason, and the count at that time.
    last_lines: Mutex<[Option<(Instant, u64)>; Rejection::ALL.len()]>,
}

impl RejectionCounts {
    pub(super) fn new(listener_address: String) -> Self {
        Self {
            listener_address,
            occurrences: Default::default(),
            last_lines: Mutex::new([None; Rejection::ALL.len()]),
        }
    }

    /// Returns how often a reason has occurred since the listener was bound.
    pub fn count(&self, reason: Rejection) -> u64 {
        self.occurrences[reason as usize].load(Ordering::Relaxed)
    }

    /// Counts a rejected connection, and logs the rejection unless the same reason was logged in the last minute.
    pub(super) fn record(&self, reason: Rejection, from: Option<SocketAddr>, detail: &str) {
        let count = self.occurrences[reason as usize].fetch_add(1, Ordering::Relaxed) + 1;
        let now = Instant::now();
        let mut last_lines = self.last_lines.lock().unwrap_or_else(PoisonError::into_inner);
        let last_line = &mut last_lines[reason as usize];
        if last_line.is_some_and(|(logged_at, _)| now - logged_at < LOG_INTERVAL) {
            return;
        }
        let since_last_line = count - last_line.map_or(0, |(_, count)| count);
        *last_line = Some((now, count));
        drop(last_lines);
        let from = from.map_or_else(|| "an unknown address".to_owned(), |from| from.to_string());
        tracing::warn!(
            from,
            reason = reason.name(),
            connections = since_last_line,
            "closed a connection at {}: {detail}; further connections with the same reason are counted and logged once a minute",
            self.listener_address
        );
    }
}
