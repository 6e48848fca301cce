//! Memory budgets of unfinished messages, for connections with and without a session.

use std::sync::Arc;

use crate::transport::datagram::partial_message::PEAK_MEMORY_FACTOR;
use crate::transport::datagram::reassembly::ReassemblyLimits;
use crate::transport::memory::MemoryBudget;

/// Largest message of a connection without a session. Bytes.
const MAX_UNADMITTED_BYTES: u32 = 64 * 1024;

/// Maximum number of unfinished messages of a connection without a session.
const MAX_UNADMITTED_MESSAGES: usize = 2;

/// Memory for the unfinished messages of all connections without a session. Bytes.
const MAX_ALL_UNADMITTED_BYTES: u64 = 16 * 1024 * 1024;

/// Limits of each connection, and budgets that connections share. Connections without a session have a separate budget,
/// so that they cannot exhaust the memory of connections with a session.
#[derive(Debug)]
pub(super) struct ReassemblyBudgets {
    /// Limits of connections with a session.
    limits: ReassemblyLimits,
    unadmitted_budget: Arc<MemoryBudget>,
    admitted_budget: Arc<MemoryBudget>,
}

impl ReassemblyBudgets {
    /// Creates the budgets. `limits` applies to each connection with a session, `max_bytes` to all of them together.
    pub(super) fn new(limits: ReassemblyLimits, max_bytes: u64) -> Self {
        // A single message of the largest length always fits, in whatever order its fragments arrive.
        let largest_message_memory = u64::from(limits.max_message_bytes) * PEAK_MEMORY_FACTOR;
        Self {
            limits,
            unadmitted_budget: MemoryBudget::new(MAX_ALL_UNADMITTED_BYTES),
            admitted_budget: MemoryBudget::new(max_bytes.max(largest_message_memory)),
        }
    }

    /// Returns the limits and the budget of a connection with a session.
    pub(super) fn admitted_limits(&self) -> (ReassemblyLimits, Arc<MemoryBudget>) {
        (self.limits, Arc::clone(&self.admitted_budget))
    }

    /// Returns the limits and the budget of a connection without a session.
    pub(super) fn unadmitted_limits(&self) -> (ReassemblyLimits, Arc<MemoryBudget>) {
        let limits = ReassemblyLimits {
            max_message_bytes: MAX_UNADMITTED_BYTES.min(self.limits.max_message_bytes),
            max_unfinished_messages: MAX_UNADMITTED_MESSAGES,
            ..self.limits
        };
        (limits, Arc::clone(&self.unadmitted_budget))
    }

    /// Returns the memory of unfinished messages, and of messages that wait for the layer above. Bytes.
    pub(super) fn reserved_bytes(&self) -> u64 {
        self.admitted_budget.reserved_bytes() + self.unadmitted_budget.reserved_bytes()
    }
}
