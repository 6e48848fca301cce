//! A bucket of a clock series: several clock samples that become one point.

use peernet_analysis::clock_points::{ClockBucket, ClockPoint};

use super::{Row, wall};
use crate::error::StoreError;

/// A bucket, to which clock samples are added.
pub(super) struct Bucket {
    /// Number of the bucket since 1970.
    number: i64,
    sum: ClockBucket,
}

impl Bucket {
    pub(super) fn new(number: i64) -> Self {
        Self { number, sum: ClockBucket::default() }
    }

    pub(super) fn number(&self) -> i64 {
        self.number
    }

    pub(super) fn add(&mut self, row: &Row) -> Result<(), StoreError> {
        let width = row.bounds().map(|bounds| bounds.width());
        self.sum.add_with(&row.point_without_offset()?, width, || row.offset())
    }

    /// Returns the bucket as a point; `None` if the bucket is empty. `width_s` is the width of the
    /// bucket in seconds.
    pub(super) fn point(self, width_s: u32) -> Option<ClockPoint> {
        let end = self.number.saturating_add(1).saturating_mul(i64::from(width_s) * 1_000_000_000);
        let point = self.sum.into_point()?;
        // A point that is one clock sample keeps the stored time, to which its offset belongs.
        Some(ClockPoint { at: if width_s == 1 { point.at } else { wall(end) }, ..point })
    }
}
