//! Moments and quantiles of one quantity.

use serde::{Deserialize, Serialize};

use crate::{Moments, Sketch};

/// All that is kept of a quantity, whatever the number of samples.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Exact up to rounding.
    pub moments: Moments,
    /// Quantiles within [`Sketch::RELATIVE_ERROR`].
    pub sketch: Sketch,
}

impl Summary {
    /// Adds a number; what is not finite is left out.
    pub fn record(&mut self, value: f64) {
        if value.is_finite() {
            self.moments.record(value);
            self.sketch.record(value);
        }
    }

    /// Adds all numbers of another.
    pub fn merge(&mut self, other: &Self) {
        self.moments.merge(&other.moments);
        self.sketch.merge(&other.sketch);
    }

    /// How many numbers.
    pub fn count(&self) -> u64 {
        self.moments.count
    }

    /// The number below which a fraction `q` lies, never outside the observed extremes.
    pub fn quantile(&self, q: f64) -> Option<f64> {
        self.sketch.quantile(q).map(|value| value.clamp(self.moments.min, self.moments.max))
    }
}
