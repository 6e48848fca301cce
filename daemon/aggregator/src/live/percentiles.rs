//! The 95th percentile of the total latency over the last minutes, in buckets with enough iterations for it.

use std::collections::{BTreeMap, BTreeSet};

use peernet_statistics::{BUCKET_WIDTHS_S, Moments, Sketch, Summary, VALUES_PER_POINT};
use peernet_store::QuantityStatistics;

use crate::live_state::{PercentilePoint, PercentileSeries};

/// Maximum length of a bucket, seconds.
const MAX_BUCKET_S: u32 = 600;
/// Longest pause between two seconds with iterations that counts completely as running time. Of a longer pause only
/// this part counts, because the pause is an interruption, which must not lower the rate. A pipeline with longer
/// intervals between its iterations has too few iterations for a percentile even in the longest bucket.
const MAX_PAUSE_S: i64 = 10;

/// Summaries of the total latency, one per second, and the percentiles of the buckets.
#[derive(Debug, Default)]
pub(super) struct Percentiles {
    seconds: BTreeMap<i64, PackedSummary>,
    /// Length of the buckets, seconds; `None` while even the longest bucket has too few iterations.
    bucket_s: Option<u32>,
    /// Keyed by the first second of the bucket.
    points: BTreeMap<i64, PercentilePoint>,
    /// Seconds that changed since the last call of [`Self::series`].
    changed_seconds: BTreeSet<i64>,
    /// `true` if a second was added or removed since the last call of [`Self::series`], which changes the rate.
    has_new_rate: bool,
}

/// A serialised summary, which needs a tenth of the memory: each pipeline has hundreds of them.
#[derive(Debug)]
struct PackedSummary {
    moments: Moments,
    sketch: Box<[u8]>,
}

impl PackedSummary {
    /// Serialises a summary.
    fn pack(summary: &Summary) -> Self {
        Self { moments: summary.moments, sketch: summary.sketch.to_bytes().into() }
    }

    /// Restores the summary.
    fn unpack(&self) -> Summary {
        let sketch = Sketch::from_bytes(&self.sketch).expect("packed by this program");
        Summary { moments: self.moments, sketch }
    }
}

impl Percentiles {
    /// Replaces the summary of a second; `None` if no iteration succeeded in it.
    pub(super) fn replace(&mut self, second: i64, total: Option<&Summary>) {
        let packed = total.map_or_else(|| PackedSummary::pack(&Summary::default()), PackedSummary::pack);
        self.has_new_rate |= self.seconds.insert(second, packed).is_none();
        self.changed_seconds.insert(second);
    }

    /// Discards a second and all later seconds, because a clock that was set back repeats them.
    pub(super) fn remove_from(&mut self, second: i64) {
        // The buckets of the discarded seconds have to be computed again.
        self.changed_seconds.extend(self.seconds.split_off(&second).into_keys());
        self.has_new_rate = true;
    }

    /// Discards the seconds before `second`. A percentile remains while its bucket overlaps the remaining seconds.
    pub(super) fn forget_before(&mut self, second: i64) {
        self.seconds = self.seconds.split_off(&second);
        self.changed_seconds = self.changed_seconds.split_off(&second);
        let length = i64::from(self.bucket_s.unwrap_or(0));
        self.points.retain(|from, _| from + length > second);
    }

    /// Returns the percentiles of the buckets with enough iterations.
    pub(super) fn series(&mut self) -> PercentileSeries {
        if std::mem::take(&mut self.has_new_rate) {
            let bucket_s = self.rate().and_then(bucket_length);
            // Another rate may need another length, which changes all buckets.
            if bucket_s != self.bucket_s {
                self.bucket_s = bucket_s;
                self.points.clear();
                self.changed_seconds = self.seconds.keys().copied().collect();
            }
        }
        let changed_seconds = std::mem::take(&mut self.changed_seconds);
        let Some(bucket_s) = self.bucket_s else { return PercentileSeries::default() };
        let length = i64::from(bucket_s);
        // Only buckets with a changed second are merged, because merging sketches is the main cost of a snapshot.
        let buckets: BTreeSet<i64> =
            changed_seconds.into_iter().map(|at| at.div_euclid(length) * length).collect();
        for from in buckets {
            match self.bucket_percentile(from, length) {
                Some(point) => self.points.insert(from, point),
                None => self.points.remove(&from),
            };
        }
        PercentileSeries { bucket_s: Some(bucket_s), points: self.points.values().copied().collect() }
    }

    /// Returns the percentile of a bucket; `None` if it has too few iterations.
    fn bucket_percentile(&self, from: i64, length: i64) -> Option<PercentilePoint> {
        let mut sum = Summary::default();
        for second in self.seconds.range(from..from.saturating_add(length)).map(|(_, second)| second) {
            sum.merge(&second.unpack());
        }
        let statistics = QuantityStatistics::from_summary(&sum)?;
        Some(PercentilePoint { at: from, count: statistics.count, p95: statistics.p95? })
    }

    /// Returns the number of successful iterations per second of running time; `None` in the first second.
    fn rate(&self) -> Option<f64> {
        // The newest second is incomplete.
        let newest = *self.seconds.last_key_value()?.0;
        let (mut count, mut running_s, mut previous) = (0, 0, None);
        for (second, summary) in self.seconds.range(..newest) {
            count += summary.moments.count;
            running_s += previous.map_or(1, |previous: i64| (second - previous).min(MAX_PAUSE_S));
            previous = Some(*second);
        }
        (running_s > 0).then(|| count as f64 / running_s as f64)
    }
}

/// Returns the length of the shortest bucket with enough iterations for a 95th percentile at this rate, seconds.
fn bucket_length(rate_hz: f64) -> Option<u32> {
    let mut lengths = BUCKET_WIDTHS_S.into_iter().take_while(|seconds| *seconds <= MAX_BUCKET_S);
    lengths.find(|seconds| rate_hz * f64::from(*seconds) >= VALUES_PER_POINT as f64)
}
