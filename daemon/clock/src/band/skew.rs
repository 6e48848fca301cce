//! What exchanges prove of the skew, whatever the network did: not how fast the clocks most likely run apart, but how fast
//! they must have.
//!
//! With an upper bound U_a and a later lower one L_b, the offset grew by L_b − U_a at least: at some time in between its
//! rate was (L_b − U_a) / (b − a) or more. With L_a and U_b it was (U_b − L_a) / (b − a) or less. The window is too short for it: over a
//! path of 40 ms, 50 ppm too much show after a quarter of an hour. So the best point of every sixteen seconds is kept for half
//! an hour. They bound no delay.

use super::best_points::{BestPoints, Placement};
use super::hull;
use super::slots::Point;

const STRETCH: i64 = 16_000_000_000;
const MOST: usize = 128;

/// How fast the offset must have grown, by the exchanges of the last half hour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProvenSkew {
    /// At some time the skew was this or more, parts per million.
    pub least_ppm: f64,
    /// At some time the skew was this or less, parts per million. Below `least_ppm` only where the skew has changed.
    pub most_ppm: f64,
}

/// The points by which a skew is proven.
#[derive(Clone, Debug)]
pub(super) struct SkewProof {
    upper: BestPoints,
    /// With the sign turned.
    lower: BestPoints,
    proven: Option<ProvenSkew>,
}

impl Default for SkewProof {
    fn default() -> Self {
        let best = || BestPoints::new(STRETCH, MOST);
        Self { upper: best(), lower: best(), proven: None }
    }
}

impl SkewProof {
    /// Takes an exchange; `slope` is the skew as far as known.
    pub(super) fn insert(&mut self, upper: Point, lower: Point, slope: f64) {
        let placed = [self.upper.insert(upper, slope), self.lower.insert(lower, -slope)];
        if placed.contains(&Placement::First) {
            self.proven = self.prove();
        }
    }

    /// What is proven, as of the beginning of the last stretch.
    pub(super) fn proven(&self) -> Option<ProvenSkew> {
        self.proven
    }

    fn prove(&self) -> Option<ProvenSkew> {
        let (mut upper, mut lower) = (Vec::with_capacity(32), Vec::with_capacity(32));
        self.upper.iter().for_each(|point| hull::push(&mut upper, point, 0.0));
        self.lower.iter().for_each(|point| hull::push(&mut lower, point, 0.0));
        let most = lowest_rate(&lower, &upper)?;
        let least = -lowest_rate(&upper, &lower)?;
        Some(ProvenSkew { least_ppm: least * 1e6, most_ppm: most * 1e6 })
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.upper.memory_bytes() + self.lower.memory_bytes()
    }
}

/// The least by which a bound of one side and a later one of the other let the offset grow, seconds per second.
fn lowest_rate(earlier: &[Point], later: &[Point]) -> Option<f64> {
    let rates = later.iter().flat_map(|b| {
        let before = earlier.iter().take_while(|a| b.x.saturating_sub(a.x) > STRETCH / 8);
        before.map(|a| b.bound.saturating_add(a.bound) as f64 / (b.x - a.x) as f64)
    });
    rates.min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Span;
    use crate::band::Bounds;
    use crate::simulation::{Dice, Path, Wall, World};

    fn proven(ppm: f64, path: Path, seconds: f64) -> ProvenSkew {
        let world = World { edge: Wall::drifting(Span::ZERO, 0.0), cloud: Wall::drifting(Span::ZERO, ppm) };
        let mut proof = SkewProof::default();
        for trip in path.trips(&world, (0.0, seconds), 10.0, &mut Dice::new(7)) {
            let Bounds { upper, lower } = Bounds::from(&trip.exchange);
            proof.insert(upper, lower, 0.0);
        }
        proof.proven().expect("several stretches")
    }

    #[test]
    fn proven_skew_contains_the_truth_and_is_narrow_on_a_short_path() {
        for ppm in [-200.0, -3.0, 0.0, 100.0] {
            let proven = proven(ppm, Path::VETH, 100.0);
            assert!(proven.least_ppm <= ppm && ppm <= proven.most_ppm, "{proven:?}");
            assert!(proven.most_ppm - proven.least_ppm < 10.0, "{proven:?}");
        }
    }

    #[test]
    fn skew_beyond_the_limit_is_proven_over_a_long_path_in_time() {
        let path = Path { up: 5e6, down: 40e6, jitter: 1e6, loss: 0.02, burst: 0.0 };
        assert!(proven(100.0, path, 600.0).least_ppm < 50.0);
        let late = proven(100.0, path, 1_100.0);
        assert!(50.0 < late.least_ppm && late.least_ppm <= 100.0 && late.most_ppm >= 100.0, "{late:?}");
    }
}
