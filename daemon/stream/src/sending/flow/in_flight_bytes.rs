//! Counts of the bytes handed to the connection and of the bytes known to have arrived.

use peernet_clock::MonoTime;

/// Byte counts of one connection. The difference between the bytes handed over and the bytes that arrived is in flight.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct InFlightBytes {
    /// Bytes handed over since the connection was opened.
    handed_over: u64,
    /// Bytes known to have arrived; at most `handed_over`.
    arrived: u64,
    /// Position after the last byte of the durable lane.
    durable_end: u64,
    /// Time at which bytes of the durable lane last arrived.
    last_arrival_at: MonoTime,
}

impl InFlightBytes {
    /// Returns the bytes handed over since the connection was opened.
    pub(super) const fn handed_over(&self) -> u64 {
        self.handed_over
    }

    /// Returns the bytes known to have arrived.
    pub(super) const fn arrived(&self) -> u64 {
        self.arrived
    }

    /// Returns the bytes in flight: handed over and not known to have arrived.
    pub(super) const fn len(&self) -> u64 {
        self.handed_over.saturating_sub(self.arrived)
    }

    /// Returns the time at which bytes of the durable lane last arrived.
    pub(super) const fn last_arrival_at(&self) -> MonoTime {
        self.last_arrival_at
    }

    /// Counts bytes of the live lane or of an echo request. Returns the position after them.
    pub(super) const fn add(&mut self, bytes: u64) -> u64 {
        self.handed_over += bytes;
        self.handed_over
    }

    /// Counts bytes of the durable lane. Returns the position after them.
    pub(super) const fn add_durable(&mut self, bytes: u64) -> u64 {
        self.durable_end = self.add(bytes);
        self.durable_end
    }

    /// Records that all bytes up to a position have arrived. A position that was not handed over is ignored.
    pub(super) const fn acknowledge(&mut self, position: u64, now: MonoTime) {
        if position > self.arrived && position <= self.handed_over {
            // If all bytes of the durable lane had arrived before, only live updates and echo requests arrived now.
            if self.arrived < self.durable_end {
                self.last_arrival_at = now;
            }
            self.arrived = position;
        }
    }
}
