//! Horizontal box plot of a distribution. Several box plots share a scale. Box plots are drawn only on web pages, not
//! in files.

use peernet_statistics::Summary;
use peernet_statistics::number::{SPACE, count, milliseconds};

use super::stack::Orientation;
use crate::look::{Mark, Style, stage};
use crate::plot::{At, Item};
use crate::scale::Scale;

/// Half the width of a whisker's cap, points.
const CAP_HALF_WIDTH: f64 = 3.4;
/// Radius of the ring at the mean, points.
const RADIUS: f64 = 1.9;

/// Box plot: a box from the first to the third quartile with a line at the median, whiskers from the 5th to the 95th
/// percentile, and a ring at the mean. Values are in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quartiles {
    /// Number of samples.
    pub count: u64,
    /// Mean of the samples.
    pub mean: f64,
    /// The 25th, 50th and 75th percentile.
    pub values: [f64; 3],
    /// The 5th and the 95th percentile; `None` if there are too few samples for these percentiles.
    pub tails: Option<(f64, f64)>,
}

impl Quartiles {
    /// Returns the box plot of a distribution; `None` without samples. The percentiles are within 1 % of the exact
    /// percentiles, because a summary contains a sketch.
    pub fn of(summary: &Summary) -> Option<Self> {
        let [p25, p50, p75] = [0.25, 0.5, 0.75].map(|q| summary.quantile(q));
        let (count, mean) = (summary.count(), summary.moments.mean);
        Some(Self { count, mean, values: [p25?, p50?, p75?], tails: summary.tails() })
    }

    /// Returns the largest value that is drawn, seconds.
    pub fn largest_drawn(&self) -> f64 {
        self.tails.map_or(self.values[2], |(_, p95)| p95).max(self.mean)
    }

    /// Returns the values as text, for screen readers.
    pub fn description(&self) -> String {
        let [p25, p50, p75] = self.values.map(milliseconds);
        let tails = self.tails.map_or_else(String::new, |(p5, p95)| {
            format!(", 5{SPACE}% below {}, 95{SPACE}% below {}", milliseconds(p5), milliseconds(p95))
        });
        let (mean, count) = (milliseconds(self.mean), count(self.count));
        format!("median {p50}{SPACE}ms, quartiles {p25} and {p75}{tails}, mean {mean}; {count} samples")
    }

    /// Lays the box plot out in the colour of a stage, on a scale in ms.
    pub fn items(&self, stage_name: &str, scale: &Scale) -> Vec<Item> {
        let at = |seconds: f64, y: f64| At::new(scale.at(seconds * 1e3), y);
        let [p25, p50, p75] = self.values;
        let mut items = Item::grid(scale);
        if let Some((p5, p95)) = self.tails {
            items.extend(Orientation::Horizontal.whisker(
                [at(p5, 0.5), at(p95, 0.5)],
                [true; 2],
                CAP_HALF_WIDTH,
                &Style::whisker(),
            ));
        }
        items.push(Item::rect(at(p25, 0.08), at(p75, 0.92), stage(stage_name).plain()));
        items.extend(
            [Style::halo(), Style::whisker()].map(|style| Item::line(at(p50, 0.0), at(p50, 1.0), style)),
        );
        // The style sheet fills the disc with the colour of the background, so the disc looks like a ring.
        items.push(Item::mark(at(self.mean, 0.5), Mark::Disc, RADIUS, Style::of_page("mean")));
        items
    }
}
