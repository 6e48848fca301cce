//! The current relation period of a link.

use peernet_stream::{ClockSample, NetworkName};
use uuid::Uuid;

/// The current relation period. Exchanges of different relation periods cannot be combined, because a clock was stepped
/// in between.
#[derive(Debug)]
pub(super) struct RelationPeriod {
    /// Random id of the relation period.
    id: u64,
    /// `true` if the relation was restarted. The next relation period starts when the current second is closed.
    is_void: bool,
    /// Samples of the last closed second, one for each network in use; empty if the relation period is void.
    last_samples: Vec<ClockSample>,
}

impl RelationPeriod {
    /// Creates a relation period without seconds.
    pub(super) fn new() -> Self {
        Self { id: Uuid::new_v4().as_u64_pair().0, is_void: false, last_samples: Vec::new() }
    }

    /// Returns the random id of the relation period.
    pub(super) const fn id(&self) -> u64 {
        self.id
    }

    /// Returns whether the relation period is void.
    pub(super) const fn is_void(&self) -> bool {
        self.is_void
    }

    /// Makes the relation period void. Its last second is not shown any more.
    pub(super) fn make_void(&mut self) {
        self.is_void = true;
        self.last_samples.clear();
    }

    /// Sets the samples of the last closed second, one for each network in use.
    pub(super) fn set_last_second(&mut self, samples: Vec<ClockSample>) {
        if !self.is_void {
            self.last_samples = samples;
        }
    }

    /// Returns the sample of the last second over a network.
    pub(super) fn last_second(&self, network: &NetworkName) -> Option<&ClockSample> {
        self.last_samples.iter().find(|sample| sample.network == *network)
    }
}
