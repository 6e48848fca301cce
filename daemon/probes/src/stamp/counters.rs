//! Counters of a reflector.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Reason why a request was not answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The packet is shorter than a request.
    Short,
    /// The request is not authenticated by the reflector's key.
    Unauthenticated,
    /// The packet is a reply. Answering it would let two reflectors form a loop.
    Reply,
    /// The request comes from port 0, to which no answer can be sent.
    NoPort,
    /// The source exceeded its rate.
    TooOften,
    /// All sources without a session together exceeded their rate.
    TooMany,
    /// The answer could not be sent.
    NotSent,
}

impl Refusal {
    /// Every reason, in the order of declaration.
    pub const ALL: [Self; 7] = [
        Self::Short,
        Self::Unauthenticated,
        Self::Reply,
        Self::NoPort,
        Self::TooOften,
        Self::TooMany,
        Self::NotSent,
    ];

    /// Returns the reason in a few words, for the log.
    pub const fn description(self) -> &'static str {
        match self {
            Self::Short => "shorter than a request",
            Self::Unauthenticated => "not authenticated by the key",
            Self::Reply => "a reply, not a request",
            Self::NoPort => "from port 0",
            Self::TooOften => "above the rate limit of its source",
            Self::TooMany => "above the common rate limit of sources without a session",
            Self::NotSent => "the answer could not be sent",
        }
    }
}

/// Handle to the counters of a reflector since it was bound. Clones show the same counters.
#[derive(Clone, Debug, Default)]
pub struct ReflectorCounters(Arc<Counters>);

// Relaxed accesses are enough, because nobody derives the state of other memory from a counter.
#[derive(Debug, Default)]
struct Counters {
    answered: AtomicU64,
    refused: [AtomicU64; Refusal::ALL.len()],
}

/// Values of [`ReflectorCounters`] at one time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReflectorCounts {
    /// Number of answered requests.
    pub answered: u64,
    /// Number of refused requests, by reason.
    pub refused: [(Refusal, u64); Refusal::ALL.len()],
}

impl ReflectorCounters {
    /// Returns the present values.
    pub fn read(&self) -> ReflectorCounts {
        let refused = |reason: Refusal| (reason, self.0.refused[reason as usize].load(Ordering::Relaxed));
        ReflectorCounts {
            answered: self.0.answered.load(Ordering::Relaxed),
            refused: Refusal::ALL.map(refused),
        }
    }

    pub(crate) fn count_answered(&self) {
        self.0.answered.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn count_refused(&self, reason: Refusal) {
        self.0.refused[reason as usize].fetch_add(1, Ordering::Relaxed);
    }
}

impl ReflectorCounts {
    /// Returns the number of requests refused for this reason.
    pub fn refused(&self, reason: Refusal) -> u64 {
        self.refused[reason as usize].1
    }
}
