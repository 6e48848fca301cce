//! Summary of several stored seconds as one point.

use peernet_analysis::clock_points::{ClockBucket, ClockPoint};

use super::{Row, wall};
use crate::error::StoreError;

/// The seconds of one bucket, summed up.
pub(super) struct Bucket {
    /// Number of the bucket since 1970.
    number: i64,
    seconds: ClockBucket,
}

impl Bucket {
    pub(super) fn new(number: i64) -> Self {
        Self { number, seconds: ClockBucket::default() }
    }

    pub(super) fn number(&self) -> i64 {
        self.number
    }

    pub(super) fn add(&mut self, row: &Row) -> Result<(), StoreError> {
        let width = row.bounds().map(|bounds| bounds.width());
        self.seconds.add_with(&row.point_without_offset()?, width, || row.offset())
    }

    /// Returns the bucket as a point; `None` if it is empty.
    pub(super) fn point(self, width: u32) -> Option<ClockPoint> {
        let end = self.number.saturating_add(1).saturating_mul(i64::from(width) * 1_000_000_000);
        let point = self.seconds.into_point()?;
        // A point of one second has the stored offset, and so the stored time.
        Some(ClockPoint { at: if width == 1 { point.at } else { wall(end) }, ..point })
    }
}
