//! Bytes that were handed to the connection, and those that are known to have arrived.

use peernet_clock::MonoTime;

/// Counts the bytes of one connection. What is on the way is the difference between what was handed over and what arrived.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct InFlightBytes {
    /// Bytes handed over since the connection was opened.
    handed: u64,
    /// Of those, bytes known to have arrived; never more than `handed`.
    arrived: u64,
    /// Position behind the last byte of the durable lane.
    durable_end: u64,
    /// Time at which bytes of the durable lane last arrived.
    progress: MonoTime,
}

impl InFlightBytes {
    /// Bytes handed over since the connection was opened.
    pub(super) const fn handed(&self) -> u64 {
        self.handed
    }

    /// Bytes known to have arrived.
    pub(super) const fn arrived(&self) -> u64 {
        self.arrived
    }

    /// Bytes that were handed over and are not known to have arrived.
    pub(super) const fn len(&self) -> u64 {
        self.handed.saturating_sub(self.arrived)
    }

    /// Time at which bytes of the durable lane last arrived.
    pub(super) const fn progress(&self) -> MonoTime {
        self.progress
    }

    /// Counts bytes of the live lane or of an echo request; returns the position behind them.
    pub(super) const fn add(&mut self, bytes: u64) -> u64 {
        self.handed += bytes;
        self.handed
    }

    /// Counts bytes of the durable lane; returns the position behind them.
    pub(super) const fn add_durable(&mut self, bytes: u64) -> u64 {
        self.durable_end = self.add(bytes);
        self.durable_end
    }

    /// Records that everything up to the position `bytes` has arrived. A position that was not handed over is ignored.
    pub(super) const fn acknowledge(&mut self, bytes: u64, now: MonoTime) {
        if bytes > self.arrived && bytes <= self.handed {
            if self.arrived < self.durable_end {
                self.progress = now;
            }
            self.arrived = bytes;
        }
    }
}
