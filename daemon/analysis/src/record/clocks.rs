//! Quality of a run's clocks, from its rows.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::Passage;
use crate::order::SortedValues;
use crate::rows::Rows;

/// Quality of the delays of a run, warm-up left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Clocks {
    /// Edge to cloud.
    pub upload: ClockCounts,
    /// Cloud to edge.
    pub download: ClockCounts,
}

/// The verdicts on one direction's delays.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ClockCounts {
    /// Number of delays by verdict.
    pub verdicts: BTreeMap<String, u64>,
    /// Number of delays by source of their clock relation.
    pub sources: BTreeMap<String, u64>,
    /// Median width of the bounds, seconds; `None` without bounds.
    pub median_width: Option<f64>,
    /// Offset of the receiver's wall clock ahead of the sender's at the first message for which it is known.
    pub first_offset: Option<Bounded>,
    /// Offset at the last such message.
    pub last_offset: Option<Bounded>,
    /// Average growth of that offset, seconds per second.
    pub skew: Option<Bounded>,
}

/// Value with the bounds that contain the true one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Bounded {
    /// The estimate.
    pub value: f64,
    /// The lower bound.
    pub lo: f64,
    /// The upper bound.
    pub hi: f64,
}

impl Clocks {
    /// Returns the quality of the delays in these rows.
    pub fn from_rows(rows: &Rows) -> Self {
        let counted = || rows.iter().filter(|row| row.is_counted());
        Self {
            upload: ClockCounts::from_passages(counted().filter_map(|row| Some((row.at(), row.upload()?)))),
            download: ClockCounts::from_passages(
                counted().filter_map(|row| Some((row.at(), row.download()?))),
            ),
        }
    }
}

impl ClockCounts {
    fn from_passages(passages: impl Iterator<Item = (f64, Passage)>) -> Self {
        let (mut verdicts, mut sources) = (BTreeMap::new(), BTreeMap::new());
        let mut widths: Vec<f64> = Vec::new();
        let (mut first, mut last) = (None, None);
        for (at, passage) in passages {
            let delay = &passage.delay;
            if let Some(offset) = offset(&passage) {
                first.get_or_insert((at, offset));
                last = Some((at, offset));
            }
            *verdicts.entry(delay.verdict.name()).or_default() += 1;
            *sources.entry(delay.source.name()).or_default() += 1;
            widths.extend(delay.bounds.map(|bounds| bounds.width().seconds()));
        }
        let named = |counts: BTreeMap<&str, u64>| {
            counts.into_iter().map(|(name, count)| (name.to_owned(), count)).collect()
        };
        Self {
            verdicts: named(verdicts),
            sources: named(sources),
            median_width: widths.into_iter().collect::<SortedValues>().median(),
            first_offset: first.map(|(_, offset)| offset),
            last_offset: last.map(|(_, offset)| offset),
            skew: first.zip(last).and_then(|(first, last)| skew(first, last)),
        }
    }
}

/// Returns the offset that was subtracted from the difference of the stamps, in seconds.
fn offset(passage: &Passage) -> Option<Bounded> {
    passage.seconds()?;
    let (delay, seconds) = (&passage.delay, |delay| (passage.delay.raw - delay).seconds());
    let bounds = delay.bounds?;
    Some(Bounded { value: seconds(delay.value?), lo: seconds(bounds.hi), hi: seconds(bounds.lo) })
}

fn skew((from, first): (f64, Bounded), (to, last): (f64, Bounded)) -> Option<Bounded> {
    let seconds = to - from;
    let over = |change: f64| change / seconds;
    // The start is 0 if it was not recorded.
    (from > 0.0 && seconds > 0.0).then(|| Bounded {
        value: over(last.value - first.value),
        lo: over(last.lo - first.hi),
        hi: over(last.hi - first.lo),
    })
}
