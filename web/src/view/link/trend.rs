//! What a steady drift makes of an offset, so that it can be taken out of a picture.

use std::collections::BTreeMap;

use peernet_clock::WallTime;
use peernet_store::ClockPoint;

use super::known;

/// A straight line per window between steps, through the estimates.
#[derive(Clone, Debug, Default)]
pub(crate) struct Trend {
    lines: BTreeMap<u64, Line>,
}

#[derive(Clone, Copy, Debug)]
struct Line {
    middle: WallTime,
    level: f64,
    slope: f64,
}

impl Trend {
    /// The trend of some points.
    pub(crate) fn of(points: &[ClockPoint]) -> Self {
        let mut windows: BTreeMap<u64, Vec<(WallTime, f64)>> = BTreeMap::new();
        for point in points {
            if let Some(offset) = point.offset.as_ref().filter(|offset| known(offset).is_some()) {
                windows.entry(point.window).or_default().push((offset.at, offset.estimate.seconds()));
            }
        }
        let lines = windows.into_iter().filter_map(|(window, known)| Some((window, Line::through(&known)?)));
        Self { lines: lines.collect() }
    }

    /// What the trend says of a moment, seconds; zero where there is none.
    pub(crate) fn at(&self, window: u64, at: WallTime) -> f64 {
        self.lines.get(&window).map_or(0.0, |line| line.level + line.slope * (at - line.middle).seconds())
    }
}

impl Line {
    /// Slopes and levels in the middle of many (after Theil 1950 and Sen 1968): a few points that belong elsewhere do not
    /// tilt it.
    fn through(known: &[(WallTime, f64)]) -> Option<Self> {
        let middle = known.get(known.len() / 2)?.0;
        let at = |time: WallTime| (time - middle).seconds();
        let half = known.len() / 2;
        let apart = known.iter().zip(&known[half..]).filter(|((from, _), (to, _))| to > from);
        let slope = median(apart.map(|(from, to)| (to.1 - from.1) / (at(to.0) - at(from.0)))).unwrap_or(0.0);
        let level = median(known.iter().map(|(time, value)| value - slope * at(*time)))?;
        Some(Self { middle, level, slope })
    }
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}
