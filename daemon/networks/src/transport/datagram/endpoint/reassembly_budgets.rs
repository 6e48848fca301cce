//! Memory of unfinished messages, for connections with a session and without.

use std::sync::Arc;

use crate::transport::datagram::partial_message::PEAK_COST;
use crate::transport::datagram::reassembly::ReassemblyLimits;
use crate::transport::memory::MemoryBudget;

/// Largest message of a connection without a session.
const MAX_UNADMITTED_BYTES: u32 = 64 * 1024;

/// Unfinished messages of a connection without a session.
const MAX_UNADMITTED_MESSAGES: usize = 2;

/// Memory for the unfinished messages of all connections without a session.
const MAX_ALL_UNADMITTED_BYTES: u64 = 16 * 1024 * 1024;

/// Limits of each connection, and memory that connections share: those without a session cannot take that of the others.
#[derive(Debug)]
pub(super) struct ReassemblyBudgets {
    /// Limits of connections that have a session.
    limits: ReassemblyLimits,
    unadmitted: Arc<MemoryBudget>,
    admitted: Arc<MemoryBudget>,
}

impl ReassemblyBudgets {
    /// `limits` and `max_bytes`, for all of them, are those of connections that have a session.
    pub(super) fn new(limits: ReassemblyLimits, max_bytes: u64) -> Self {
        // One largest message alone always fits, in whatever order its fragments come.
        let largest = u64::from(limits.max_message_bytes) * PEAK_COST;
        Self {
            limits,
            unadmitted: MemoryBudget::new(MAX_ALL_UNADMITTED_BYTES),
            admitted: MemoryBudget::new(max_bytes.max(largest)),
        }
    }

    /// Returns the limits and the budget of a connection with a session.
    pub(super) fn admitted(&self) -> (ReassemblyLimits, Arc<MemoryBudget>) {
        (self.limits, Arc::clone(&self.admitted))
    }

    /// Returns the limits and the budget of a connection without a session.
    pub(super) fn unadmitted(&self) -> (ReassemblyLimits, Arc<MemoryBudget>) {
        let limits = ReassemblyLimits {
            max_message_bytes: MAX_UNADMITTED_BYTES.min(self.limits.max_message_bytes),
            max_unfinished_messages: MAX_UNADMITTED_MESSAGES,
            ..self.limits
        };
        (limits, Arc::clone(&self.unadmitted))
    }

    /// Memory that unfinished messages, and messages that were not handed on, take.
    pub(super) fn held(&self) -> u64 {
        self.admitted.held() + self.unadmitted.held()
    }
}
