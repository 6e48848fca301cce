//! Connections that were turned away or closed for breaking a limit: counted by reason, logged once and then as counts.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use tokio::time::Instant;

/// How often a reason is logged at most.
const LOG_INTERVAL: Duration = Duration::from_secs(60);

/// Why a connection was turned away or closed by the listener.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rejection {
    /// As many connections were open as are allowed.
    TooMany,
    /// As many connections of its address were open as are allowed.
    TooManyOfAddress,
    /// It had not been admitted when a newer connection needed its place.
    Replaced,
    /// It did not complete the ZMTP handshake, or not in time.
    Handshake,
    /// It sent no hello that was accepted in time.
    NoHello,
    /// It sent or claimed more than is allowed before its hello was accepted.
    LargeBeforeHello,
    /// It sent or claimed a message larger than is allowed.
    TooLarge,
    /// There was no memory left for its unfinished message.
    NoMemory,
    /// It sent nothing for longer than the heartbeat allows.
    Silent,
    /// It broke the protocol after the handshake.
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

    /// Its name in metrics.
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

/// How often each reason occurred at one listener.
#[derive(Debug)]
pub struct RejectionCounts {
    /// The listener, for log lines.
    port: String,
    counts: [AtomicU64; Rejection::ALL.len()],
    /// When each reason was last logged, and the count then.
    logged: Mutex<[Option<(Instant, u64)>; Rejection::ALL.len()]>,
}

impl RejectionCounts {
    pub(super) fn new(port: String) -> Self {
        Self { port, counts: Default::default(), logged: Mutex::new([None; Rejection::ALL.len()]) }
    }

    /// How often a reason occurred since the listener was bound.
    pub fn count(&self, reason: Rejection) -> u64 {
        self.counts[reason as usize].load(Ordering::Relaxed)
    }

    /// Counts a connection and logs it, unless that reason was logged in the last minute.
    pub(super) fn record(&self, reason: Rejection, from: Option<SocketAddr>, detail: &str) {
        let count = self.counts[reason as usize].fetch_add(1, Ordering::Relaxed) + 1;
        let now = Instant::now();
        let mut logged = self.logged.lock().unwrap_or_else(PoisonError::into_inner);
        let last = &mut logged[reason as usize];
        if last.is_some_and(|(at, _)| now - at < LOG_INTERVAL) {
            return;
        }
        let since_last = count - last.map_or(0, |(_, count)| count);
        *last = Some((now, count));
        drop(logged);
        let from = from.map_or_else(|| "an unknown address".to_owned(), |from| from.to_string());
        tracing::warn!(
            from,
            reason = reason.name(),
            connections = since_last,
            "closed a connection at {}: {detail}; more of this kind are counted and logged once a minute",
            self.port
        );
    }
}
