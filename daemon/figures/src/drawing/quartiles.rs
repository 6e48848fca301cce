//! Horizontal box plot of a distribution; several box plots share one scale. Box plots are drawn only on web pages, not in files.

use peernet_statistics::Summary;
use peernet_statistics::number::{SPACE, count, milliseconds};

use super::stack::Orientation;
use crate::look::{Mark, Style, stage};
use crate::plot::{At, Item};
use crate::scale::Scale;

/// Half the width of a whisker's cap, points.
const CAP: f64 = 3.4;
/// Radius of the ring at the mean, points.
const RADIUS: f64 = 1.9;

/// Box from the first to the third quartile with the median, whiskers from p5 to p95, and the mean as a ring. Seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quartiles {
    /// Number of samples.
    pub count: u64,
    /// Mean of the samples.
    pub mean: f64,
    /// p25, p50 and p75.
    pub middle: [f64; 3],
    /// p5 and p95; `None` if there are too few samples for them.
    pub tails: Option<(f64, f64)>,
}

impl Quartiles {
    /// Returns the box plot of a distribution; `None` without samples. Quantiles are within 1 % of the true quantiles.
    pub fn of(summary: &Summary) -> Option<Self> {
        let [p25, p50, p75] = [0.25, 0.5, 0.75].map(|q| summary.quantile(q));
        let (count, mean) = (summary.count(), summary.moments.mean);
        Some(Self { count, mean, middle: [p25?, p50?, p75?], tails: summary.tails() })
    }

    /// Returns the largest value that is drawn, seconds.
    pub fn top(&self) -> f64 {
        self.tails.map_or(self.middle[2], |(_, p95)| p95).max(self.mean)
    }

    /// Returns the numbers as text, for screen readers.
    pub fn words(&self) -> String {
        let [p25, p50, p75] = self.middle.map(milliseconds);
        let tails = self.tails.map_or_else(String::new, |(p5, p95)| {
            format!(", 5{SPACE}% below {}, 95{SPACE}% below {}", milliseconds(p5), milliseconds(p95))
        });
        let (mean, count) = (milliseconds(self.mean), count(self.count));
        format!("median {p50}{SPACE}ms, quartiles {p25} and {p75}{tails}, mean {mean}; {count} samples")
    }

    /// Lays the box plot out in the colour of a stage, on a scale in ms.
    pub fn items(&self, stage_name: &str, scale: &Scale) -> Vec<Item> {
        let at = |seconds: f64, y: f64| At::new(scale.at(seconds * 1e3), y);
        let [p25, p50, p75] = self.middle;
        let mut items = Item::grid(scale);
        if let Some((p5, p95)) = self.tails {
            items.extend(Orientation::Horizontal.whisker(
                [at(p5, 0.5), at(p95, 0.5)],
                [true; 2],
                CAP,
                &Style::whisker(),
            ));
        }
        items.push(Item::rect(at(p25, 0.08), at(p75, 0.92), stage(stage_name).plain()));
        items.extend(
            [Style::halo(), Style::whisker()].map(|style| Item::line(at(p50, 0.0), at(p50, 1.0), style)),
        );
        // The page's style fills the disc with the colour of the background, so it looks like a ring.
        items.push(Item::mark(at(self.mean, 0.5), Mark::Disc, RADIUS, Style::of_page("mean")));
        items
    }
}
