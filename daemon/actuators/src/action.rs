//! The input of an actuator.

use peernet_sample::Sample;

/// Answer to act on, with the position of its sample in the run.
#[derive(Clone, Copy, Debug)]
pub struct Action<'a> {
    /// The answer.
    pub answer: &'a Sample,
    /// Origin of the sample, such as the name of a file; may be empty.
    pub source: &'a str,
    /// Number of the iteration, from 1.
    pub iteration: u64,
    /// Number of the episode, from 0.
    pub episode: u32,
    /// Step within the episode, from 0.
    pub step: u32,
}

#[cfg(test)]
impl<'a> Action<'a> {
    /// Returns the first action of a run.
    pub(crate) const fn first(answer: &'a Sample, source: &'a str) -> Self {
        Self { answer, source, iteration: 1, episode: 0, step: 0 }
    }
}
