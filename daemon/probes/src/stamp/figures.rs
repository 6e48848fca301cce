//! What a reflector counts.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Why a request was not answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// Shorter than a request can be.
    Short,
    /// Not authenticated by the reflector's key.
    Unauthenticated,
    /// A reply, not a request: answering it would let two reflectors play ping-pong.
    Reply,
    /// Comes from port 0, to which nothing can be sent.
    NoPort,
    /// Its source asked too often.
    TooOften,
    /// All sources without a session together asked too often.
    TooMany,
    /// The answer could not be sent.
    NotSent,
}

impl Refusal {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Short,
        Self::Unauthenticated,
        Self::Reply,
        Self::NoPort,
        Self::TooOften,
        Self::TooMany,
        Self::NotSent,
    ];

    /// In a few words, for people and for labels.
    pub const fn in_words(self) -> &'static str {
        match self {
            Self::Short => "shorter than a request",
            Self::Unauthenticated => "not authenticated by the key",
            Self::Reply => "a reply, not a request",
            Self::NoPort => "from port 0",
            Self::TooOften => "more than its source may ask",
            Self::TooMany => "more than all sources without a session may ask together",
            Self::NotSent => "the answer could not be sent",
        }
    }
}

/// What a reflector did since it was bound. A handle: clones show the same figures.
#[derive(Clone, Debug, Default)]
pub struct ReflectorFigures(Arc<Counters>);

#[derive(Debug, Default)]
struct Counters {
    answered: AtomicU64,
    refused: [AtomicU64; Refusal::ALL.len()],
}

/// [`ReflectorFigures`] at one moment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReflectorCounts {
    /// Requests that were answered.
    pub answered: u64,
    /// Requests that were not, for each reason.
    pub refused: [(Refusal, u64); Refusal::ALL.len()],
}

impl ReflectorFigures {
    /// The figures now.
    pub fn read(&self) -> ReflectorCounts {
        let refused = |why: Refusal| (why, self.0.refused[why as usize].load(Ordering::Relaxed));
        ReflectorCounts {
            answered: self.0.answered.load(Ordering::Relaxed),
            refused: Refusal::ALL.map(refused),
        }
    }

    pub(crate) fn count_answered(&self) {
        self.0.answered.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn count_refused(&self, why: Refusal) {
        self.0.refused[why as usize].fetch_add(1, Ordering::Relaxed);
    }
}

impl ReflectorCounts {
    /// Requests refused for this reason.
    pub fn refused(&self, why: Refusal) -> u64 {
        self.refused[why as usize].1
    }
}
