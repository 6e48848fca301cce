//! Limits on the memory of messages that are being received.

use std::any::Any;
use std::fmt;
use std::sync::Arc;

/// A limit on the memory of messages that several subscribers receive.
pub trait MemoryLimit: fmt::Debug + Send + Sync {
    /// Reserves `bytes` bytes until the result is dropped. `None` if these bytes would exceed the limit.
    fn reserve(&self, bytes: usize) -> Option<Box<dyn Any + Send + Sync>>;
}

/// Limits on the messages of a topic.
#[derive(Clone, Debug, Default)]
pub(super) struct MessageLimits {
    /// Largest message, bytes.
    pub(super) max_bytes: usize,
    /// Limit on the memory of all messages together.
    pub(super) memory: Option<Arc<dyn MemoryLimit>>,
}

/// Memory that is reserved for one message. Dropping the value returns the memory.
#[derive(Default)]
pub struct MessageMemory {
    bytes: usize,
    reservations: Vec<Box<dyn Any + Send + Sync>>,
}

impl MessageMemory {
    /// Increases the reservation to `bytes` bytes. Returns `false` if the limit does not allow it.
    pub(super) fn grow(&mut self, bytes: usize, limit: Option<&Arc<dyn MemoryLimit>>) -> bool {
        let (Some(limit), Some(missing @ 1..)) = (limit, bytes.checked_sub(self.bytes)) else { return true };
        let Some(reservation) = limit.reserve(missing) else { return false };
        self.reservations.push(reservation);
        self.bytes = bytes;
        true
    }
}

impl fmt::Debug for MessageMemory {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("MessageMemory").field("bytes", &self.bytes).finish_non_exhaustive()
    }
}
