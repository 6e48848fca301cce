//! The 95th percentile of `total` over the last minutes, in buckets that hold enough iterations for one.

use std::collections::{BTreeMap, BTreeSet};

use peernet_statistics::{Moments, Sketch, Summary};
use peernet_store::{Figures, P95_NEEDS};

use crate::picture::{PercentilePoint, PercentileSeries};

/// Lengths of buckets, seconds.
const BUCKETS_S: [u32; 9] = [1, 2, 5, 10, 30, 60, 120, 300, 600];
/// Iterations do not fall evenly into buckets, so a bucket must hold a tenth more than it needs.
const SPARE: f64 = 1.1;
/// A longer pause is an interruption and does not lower the rate. A pipeline that is slower than that has too few
/// iterations for a percentile even in the longest bucket.
const PAUSE_S: i64 = 10;

/// Summaries of `total`, one for each second, and the percentiles of the buckets that they fill.
#[derive(Debug, Default)]
pub(super) struct Percentiles {
    seconds: BTreeMap<i64, PackedSummary>,
    /// Length of the buckets; `None` while none holds enough iterations.
    bucket_s: Option<u32>,
    /// By the bucket's first second.
    points: BTreeMap<i64, PercentilePoint>,
    /// Seconds that changed since the last drawing.
    changed: BTreeSet<i64>,
    /// A second was added or removed since the last drawing, so that the rate is another.
    grown: bool,
}

/// A summary in a tenth of the memory: there are hundreds of them per pipeline.
#[derive(Debug)]
struct PackedSummary {
    moments: Moments,
    sketch: Box<[u8]>,
}

impl PackedSummary {
    fn pack(summary: &Summary) -> Self {
        Self { moments: summary.moments, sketch: summary.sketch.to_bytes().into() }
    }

    fn unpack(&self) -> Summary {
        let sketch = Sketch::from_bytes(&self.sketch).expect("it was packed by this very program");
        Summary { moments: self.moments, sketch }
    }
}

impl Percentiles {
    /// Replaces what is known of a second; `None` when nothing succeeded in it.
    pub(super) fn replace(&mut self, at: i64, total: Option<&Summary>) {
        let packed = total.map_or_else(|| PackedSummary::pack(&Summary::default()), PackedSummary::pack);
        self.grown |= self.seconds.insert(at, packed).is_none();
        self.changed.insert(at);
    }

    /// Forgets a second and all later ones: a clock that was set back will show them again.
    pub(super) fn forget_from(&mut self, second: i64) {
        self.changed.extend(self.seconds.split_off(&second).into_keys());
        self.grown = true;
    }

    /// Forgets the seconds before this one. A percentile stays as long as a second of its bucket does.
    pub(super) fn forget_before(&mut self, second: i64) {
        self.seconds = self.seconds.split_off(&second);
        self.changed = self.changed.split_off(&second);
        let length = i64::from(self.bucket_s.unwrap_or(0));
        self.points.retain(|from, _| from + length > second);
    }

    /// The percentiles, of the buckets alone that hold enough iterations.
    pub(super) fn series(&mut self) -> PercentileSeries {
        if std::mem::take(&mut self.grown) {
            let bucket_s = self.rate().and_then(bucket);
            if bucket_s != self.bucket_s {
                self.bucket_s = bucket_s;
                self.points.clear();
                self.changed = self.seconds.keys().copied().collect();
            }
        }
        let changed = std::mem::take(&mut self.changed);
        let Some(bucket_s) = self.bucket_s else { return PercentileSeries::default() };
        let length = i64::from(bucket_s);
        let buckets: BTreeSet<i64> = changed.into_iter().map(|at| at.div_euclid(length) * length).collect();
        for from in buckets {
            match self.merge(from, length) {
                Some(point) => self.points.insert(from, point),
                None => self.points.remove(&from),
            };
        }
        PercentileSeries { bucket_s: Some(bucket_s), points: self.points.values().copied().collect() }
    }

    /// The percentile of a bucket; `None` when it holds too few iterations.
    fn merge(&self, from: i64, length: i64) -> Option<PercentilePoint> {
        let mut sum = Summary::default();
        for second in self.seconds.range(from..from.saturating_add(length)).map(|(_, second)| second) {
            sum.merge(&second.unpack());
        }
        let figures = Figures::of(&sum)?;
        Some(PercentilePoint { at: from, count: figures.count, p95: figures.p95? })
    }

    /// Successful iterations per second while the pipeline ran; `None` before it ran for a second.
    fn rate(&self) -> Option<f64> {
        // The newest second is still under way.
        let newest = *self.seconds.last_key_value()?.0;
        let (mut count, mut covered, mut last) = (0, 0, None);
        for (at, second) in self.seconds.range(..newest) {
            count += second.moments.count;
            covered += last.map_or(1, |last: i64| (at - last).min(PAUSE_S));
            last = Some(*at);
        }
        (covered > 0).then(|| count as f64 / covered as f64)
    }
}

/// The shortest bucket that holds enough iterations for a 95th percentile at this rate.
fn bucket(rate_hz: f64) -> Option<u32> {
    let needed = P95_NEEDS as f64 * SPARE;
    BUCKETS_S.into_iter().find(|seconds| rate_hz * f64::from(*seconds) >= needed)
}
