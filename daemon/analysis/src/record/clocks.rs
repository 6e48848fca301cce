//! Quality of a run's clocks, from its rows.

use std::collections::BTreeMap;

use peernet_clock::OneWayDelay;
use serde::{Deserialize, Serialize};

use crate::delays::{VerdictCounts, median_width};
use crate::rows::Rows;

/// Quality of the delays of a run, without warm-up and failed iterations.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Clocks {
    /// Delays from edge to cloud.
    pub upload: DelayQuality,
    /// Delays from cloud to edge.
    pub download: DelayQuality,
}

/// Quality of the delays in one direction.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct DelayQuality {
    /// Number of delays for each verdict that occurs.
    pub verdicts: BTreeMap<String, u64>,
    /// Number of delays for each source of the clock relation that corrected the delays.
    pub sources: BTreeMap<String, u64>,
    /// Median width of the bounds, seconds; `None` without bounds.
    pub median_width: Option<f64>,
    /// Clock offset, which is the receiver's wall clock minus the sender's, at the first message
    /// with a known offset; seconds.
    pub first_offset: Option<BoundedEstimate>,
    /// Offset at the last message with a known offset, seconds.
    pub last_offset: Option<BoundedEstimate>,
    /// Average growth of the offset from the first to the last message with a known offset, seconds per second.
    pub skew: Option<BoundedEstimate>,
}

/// Estimate with bounds that contain the true value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct BoundedEstimate {
    /// Estimate.
    pub value: f64,
    /// Lower bound.
    pub lo: f64,
    /// Upper bound.
    pub hi: f64,
}

impl Clocks {
    /// Returns the quality of the delays in these rows.
    pub fn from_rows(rows: &Rows) -> Self {
        let in_statistics = || rows.iter().filter(|row| row.is_in_statistics());
        Self {
            upload: DelayQuality::from_delays(
                in_statistics().filter_map(|row| Some((row.at(), row.upload()?))),
            ),
            download: DelayQuality::from_delays(
                in_statistics().filter_map(|row| Some((row.at(), row.download()?))),
            ),
        }
    }
}

impl DelayQuality {
    fn from_delays(delays: impl Iterator<Item = (f64, OneWayDelay)> + Clone) -> Self {
        // Delays without a value are counted, too: readers must know how many delays are unknown.
        let verdicts: VerdictCounts = delays.clone().map(|(_, delay)| delay.verdict).collect();
        let mut sources = BTreeMap::<&str, u64>::new();
        delays.clone().for_each(|(_, delay)| *sources.entry(delay.source.name()).or_default() += 1);
        let mut offsets = delays.clone().filter_map(|(at, delay)| Some((at, offset(&delay)?)));
        let first = offsets.next();
        let last = offsets.last().or(first);
        Self {
            verdicts: verdicts.counts().map(|(verdict, count)| (verdict.name().to_owned(), count)).collect(),
            sources: sources.into_iter().map(|(name, count)| (name.to_owned(), count)).collect(),
            median_width: median_width(delays.filter_map(|(_, delay)| delay.known_bounds())),
            first_offset: first.map(|(_, offset)| offset),
            last_offset: last.map(|(_, offset)| offset),
            skew: first.zip(last).and_then(|(first, last)| skew(first, last)),
        }
    }
}

/// Returns the clock offset of a delay with its bounds, seconds; `None` if the delay is not known. A longer delay means
/// a smaller offset, so the upper bound of the delay gives the lower bound of the offset.
fn offset(delay: &OneWayDelay) -> Option<BoundedEstimate> {
    let offset_for = |true_delay| (delay.raw - true_delay).seconds();
    let bounds = delay.bounds?;
    Some(BoundedEstimate {
        value: delay.clock_offset()?.seconds(),
        lo: offset_for(bounds.hi),
        hi: offset_for(bounds.lo),
    })
}

/// Returns the average growth of the offset between two times, which are in seconds. `None` if a
/// time was not recorded, or if the second time is not later than the first.
// The lower bound belongs to the highest possible offset at the first time and the lowest at the last time.
fn skew(
    (from, first): (f64, BoundedEstimate),
    (to, last): (f64, BoundedEstimate),
) -> Option<BoundedEstimate> {
    let seconds = to - from;
    // A time is 0 if it was not recorded.
    (from > 0.0 && seconds > 0.0).then(|| BoundedEstimate {
        value: (last.value - first.value) / seconds,
        lo: (last.lo - first.hi) / seconds,
        hi: (last.hi - first.lo) / seconds,
    })
}
