//! The clock window at hand.

use peernet_stream::{ClockSample, NetworkName};
use uuid::Uuid;

/// The clock window at hand: exchanges of different windows say nothing about each other.
#[derive(Debug)]
pub(super) struct ClockWindow {
    /// Random.
    id: u64,
    /// What was learnt is void: another window begins as soon as a time is known to close the second at.
    is_void: bool,
    /// The last second that was closed, for each network in use; empty where the window is void.
    last: Vec<ClockSample>,
}

impl ClockWindow {
    /// A window without seconds.
    pub(super) fn begin() -> Self {
        Self { id: Uuid::new_v4().as_u64_pair().0, is_void: false, last: Vec::new() }
    }

    /// Its random id.
    pub(super) const fn id(&self) -> u64 {
        self.id
    }

    /// Whether what was learnt is void.
    pub(super) const fn is_void(&self) -> bool {
        self.is_void
    }

    /// What was learnt is void from now on, and the last second is not to be shown any more.
    pub(super) fn make_void(&mut self) {
        self.is_void = true;
        self.last.clear();
    }

    /// Takes the second that was closed, a sample for each network in use.
    pub(super) fn keep(&mut self, samples: Vec<ClockSample>) {
        if !self.is_void {
            self.last = samples;
        }
    }

    /// The last second over a network.
    pub(super) fn last_second(&self, network: &NetworkName) -> Option<&ClockSample> {
        self.last.iter().find(|last| last.network == *network)
    }
}
