//! What a steady drift makes of an offset, so that it can be taken out of a picture.

use std::collections::BTreeMap;

use peernet_aggregator::ClockPoint;
use peernet_clock::WallTime;

/// A straight line per window between steps, by least squares over the estimates.
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
            if let Some(offset) = &point.offset {
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
    fn through(known: &[(WallTime, f64)]) -> Option<Self> {
        let middle = known.get(known.len() / 2)?.0;
        let count = known.len() as f64;
        let at = |time: WallTime| (time - middle).seconds();
        let mean_t = known.iter().map(|(time, _)| at(*time)).sum::<f64>() / count;
        let mean = known.iter().map(|(_, value)| value).sum::<f64>() / count;
        let spread: f64 = known.iter().map(|(time, _)| (at(*time) - mean_t).powi(2)).sum();
        let common: f64 = known.iter().map(|(time, value)| (at(*time) - mean_t) * (value - mean)).sum();
        let slope = if spread > 0.0 { common / spread } else { 0.0 };
        Some(Self { middle, level: mean - slope * mean_t, slope })
    }
}
