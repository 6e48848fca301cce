//! The 1-2-5 rule of ticks.

/// Returns the smallest of 1, 2 and 5 times a power of ten such that a range contains at most `most` steps; 1 for a range that is not a
/// positive number.
pub fn round_step(range: f64, most: usize) -> f64 {
    if !range.is_finite() || range <= 0.0 {
        return 1.0;
    }
    let least = range / most.max(1) as f64;
    let power = 10_f64.powf(least.log10().floor());
    let steps = [1.0, 2.0, 5.0].map(|factor| factor * power);
    // The tolerance keeps a step that fits exactly although the division rounds.
    steps.into_iter().find(|step| *step >= least * (1.0 - 1e-9)).unwrap_or(10.0 * power)
}
