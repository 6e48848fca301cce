//! The 1-2-5 rule for the distance between ticks.

/// Returns the smallest step that is 1, 2 or 5 times a power of ten and of which `range` contains at most `max_steps`.
/// Returns 1 if `range` is not a positive finite number.
pub fn round_step(range: f64, max_steps: usize) -> f64 {
    if !range.is_finite() || range <= 0.0 {
        return 1.0;
    }
    let min_step = range / max_steps.max(1) as f64;
    let power = 10_f64.powf(min_step.log10().floor());
    let steps = [1.0, 2.0, 5.0].map(|factor| factor * power);
    // The tolerance is needed if a step fits exactly, because the division rounds.
    steps.into_iter().find(|step| *step >= min_step * (1.0 - 1e-9)).unwrap_or(10.0 * power)
}
