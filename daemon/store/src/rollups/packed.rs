//! Summaries in their stored form.

use peernet_statistics::{Moments, Sketch, Summary};

use super::SeriesKey;

/// A summary in its stored form, which takes far less memory than [`Summary`].
#[derive(Clone, Debug)]
pub(super) struct PackedSummary {
    pub(super) moments: Moments,
    pub(super) sketch: Vec<u8>,
}

impl PackedSummary {
    pub(super) fn pack(summary: &Summary) -> Self {
        Self { moments: summary.moments, sketch: summary.sketch.to_bytes() }
    }

    /// Adds the values of a summary.
    pub(super) fn add(&mut self, summary: &Summary) -> Result<(), sqlx::Error> {
        let mut sketch =
            Sketch::from_bytes(&self.sketch).map_err(|error| sqlx::Error::Decode(error.into()))?;
        sketch.merge(&summary.sketch);
        self.moments.merge(&summary.moments);
        self.sketch = sketch.to_bytes();
        Ok(())
    }

    /// Returns the approximate memory of the summary in a bucket, bytes.
    pub(super) fn bytes(&self) -> usize {
        size_of::<(SeriesKey, Self)>() + self.sketch.capacity()
    }
}
