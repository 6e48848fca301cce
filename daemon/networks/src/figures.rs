//! What went over a session or a listener, in numbers.

use std::sync::atomic::{AtomicU64, Ordering};

use serde::{Deserialize, Serialize};

/// Counts since the session was opened or the listener bound. Bytes are those of the frames; what the
/// transport adds around them is not in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct NetworkFigures {
    /// Messages handed to the network.
    pub sent_messages: u64,
    /// Their bytes.
    pub sent_bytes: u64,
    /// Messages that arrived whole.
    pub received_messages: u64,
    /// Their bytes.
    pub received_bytes: u64,
    /// Messages that arrived and made no sense; dropped.
    pub malformed: u64,
    /// Answers that arrived after the request had been given up.
    pub late: u64,
    /// Edge: requests that will never be answered, as the connection is gone or one of the two messages was lost on
    /// the way. Cloud: answers that could not be handed to the network or were lost on the way.
    pub lost: u64,
    /// Messages of which only a part arrived.
    pub incomplete: u64,
}

/// The live form of [`NetworkFigures`], written from any thread.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    sent_messages: AtomicU64,
    sent_bytes: AtomicU64,
    received_messages: AtomicU64,
    received_bytes: AtomicU64,
    malformed: AtomicU64,
    late: AtomicU64,
    lost: AtomicU64,
    incomplete: AtomicU64,
}

impl Counters {
    pub(crate) fn sent(&self, bytes: u64) {
        self.sent_messages.fetch_add(1, Ordering::Relaxed);
        self.sent_bytes.fetch_add(bytes, Ordering::Relaxed);
    }

    pub(crate) fn received(&self, bytes: u64) {
        self.received_messages.fetch_add(1, Ordering::Relaxed);
        self.received_bytes.fetch_add(bytes, Ordering::Relaxed);
    }

    pub(crate) fn malformed(&self) {
        self.malformed.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn late(&self) {
        self.late.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn lost(&self, count: u64) {
        self.lost.fetch_add(count, Ordering::Relaxed);
    }

    pub(crate) fn incomplete(&self) {
        self.incomplete.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn figures(&self) -> NetworkFigures {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        NetworkFigures {
            sent_messages: read(&self.sent_messages),
            sent_bytes: read(&self.sent_bytes),
            received_messages: read(&self.received_messages),
            received_bytes: read(&self.received_bytes),
            malformed: read(&self.malformed),
            late: read(&self.late),
            lost: read(&self.lost),
            incomplete: read(&self.incomplete),
        }
    }
}
