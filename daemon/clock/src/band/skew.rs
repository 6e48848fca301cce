//! Bounds of the skew that the exchanges prove. The bounds hold whatever the delays of the exchanges were.
//!
//! Let U_a be an upper bound at the time a, and L_b a lower bound at the later time b. Between the two times, the
//! offset grew by at least L_b − U_a: at some time its rate was (L_b − U_a) / (b − a) or more. In the same way, a lower
//! bound L_a and a later upper bound U_b prove that the rate was (U_b − L_a) / (b − a) or less at some time. The window
//! of the band is too short for these proofs: over a path of 40 ms, a skew that exceeds the limit of drift by 50 ppm
//! shows only after a quarter of an hour. The lowest point of every sixteen seconds is therefore kept for half an hour.
//! These points serve only the bounds of the skew, not the bounds of delays.

use super::best_points::{BestPoints, InsertResult};
use super::hull;
use super::slots::Point;

/// Length of the intervals of which the lowest point is kept.
const INTERVAL_NANOS: i64 = 16_000_000_000;
/// Maximum number of intervals, which together last half an hour.
const MAX_INTERVALS: usize = 128;

/// Range of the skew that the exchanges of the last half hour prove.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProvenSkew {
    /// At some time the skew was at least this, parts per million.
    pub min_ppm: f64,
    /// At some time the skew was at most this, parts per million. The value is below `min_ppm` only if the skew
    /// changed.
    pub max_ppm: f64,
}

impl ProvenSkew {
    /// Returns the smaller and the larger of the two values.
    pub fn ordered_ppm(self) -> (f64, f64) {
        (self.min_ppm.min(self.max_ppm), self.max_ppm.max(self.min_ppm))
    }
}

/// Points of the last half hour from which bounds of the skew follow. The bounds hold for any delays.
#[derive(Clone, Debug)]
pub(super) struct SkewBounds {
    upper: BestPoints,
    /// Lower bounds with the opposite sign.
    lower: BestPoints,
    proven_skew: Option<ProvenSkew>,
}

impl Default for SkewBounds {
    fn default() -> Self {
        let no_points = || BestPoints::new(INTERVAL_NANOS, MAX_INTERVALS);
        Self { upper: no_points(), lower: no_points(), proven_skew: None }
    }
}

impl SkewBounds {
    /// Inserts an exchange; `slope` is the estimated skew in seconds per second.
    pub(super) fn insert(&mut self, upper: Point, lower: Point, slope: f64) {
        let results = [self.upper.insert(upper, slope), self.lower.insert(lower, -slope)];
        // The bounds are computed only once per interval of time, because the computation compares all pairs of points
        // of the hulls.
        if results.contains(&InsertResult::First) {
            self.proven_skew = self.prove();
        }
    }

    /// Returns the proven skew as of the start of the newest interval.
    pub(super) fn proven_skew(&self) -> Option<ProvenSkew> {
        self.proven_skew
    }

    /// Computes the proven skew; `None` without enough points.
    fn prove(&self) -> Option<ProvenSkew> {
        let (mut upper, mut lower) = (Vec::with_capacity(32), Vec::with_capacity(32));
        self.upper.iter().for_each(|point| hull::push(&mut upper, point, 0.0));
        self.lower.iter().for_each(|point| hull::push(&mut lower, point, 0.0));
        let max = lowest_rate(&lower, &upper)?;
        // A later lower point has the opposite sign, and so has its rate: the lowest rate is the negated highest rate.
        let min = -lowest_rate(&upper, &lower)?;
        Some(ProvenSkew { min_ppm: min * 1e6, max_ppm: max * 1e6 })
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.upper.memory_bytes() + self.lower.memory_bytes()
    }
}

/// Returns the lowest rate of the offset, in seconds per second, that an earlier point of one side and a later point of
/// the other side allow.
fn lowest_rate(earlier: &[Point], later: &[Point]) -> Option<f64> {
    let rates = later.iter().flat_map(|b| {
        // Points too close in time prove no useful rate, because the delays dominate.
        let earlier_points = earlier.iter().take_while(|a| b.x.saturating_sub(a.x) > INTERVAL_NANOS / 8);
        earlier_points.map(|a| b.bound.saturating_add(a.bound) as f64 / (b.x - a.x) as f64)
    });
    rates.min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Span;
    use crate::band::Bounds;
    use crate::simulation::{HostClocks, Path, RandomSource, SimulatedClock};

    fn prove_skew(ppm: f64, path: Path, seconds: f64) -> ProvenSkew {
        let host_clocks = HostClocks {
            edge: SimulatedClock::drifting(Span::ZERO, 0.0),
            cloud: SimulatedClock::drifting(Span::ZERO, ppm),
        };
        let mut skew_bounds = SkewBounds::default();
        for trip in path.trips(&host_clocks, (0.0, seconds), 10.0, &mut RandomSource::new(7)) {
            let Bounds { upper, lower } = Bounds::from(&trip.exchange);
            skew_bounds.insert(upper, lower, 0.0);
        }
        skew_bounds.proven_skew().expect("several intervals")
    }

    #[test]
    fn proven_skew_is_true_and_narrow_on_short_path() {
        for ppm in [-200.0, -3.0, 0.0, 100.0] {
            let proven = prove_skew(ppm, Path::VETH, 100.0);
            assert!(proven.min_ppm <= ppm && ppm <= proven.max_ppm, "{proven:?}");
            assert!(proven.max_ppm - proven.min_ppm < 10.0, "{proven:?}");
        }
    }

    #[test]
    fn excess_skew_is_proven_over_long_path() {
        let path = Path { up: 5e6, down: 40e6, jitter: 1e6, loss: 0.02, burst: 0.0 };
        // The delays add up to 45 ms. A proof over 600 s therefore leaves 75 ppm open, and a proof over 1,100 s 41 ppm.
        // With a skew of 100 ppm, only the second proof shows that the skew is above 50 ppm.
        assert!(prove_skew(100.0, path, 600.0).min_ppm < 50.0);
        let later_proof = prove_skew(100.0, path, 1_100.0);
        assert!(
            50.0 < later_proof.min_ppm && later_proof.min_ppm <= 100.0 && later_proof.max_ppm >= 100.0,
            "{later_proof:?}"
        );
    }
}
