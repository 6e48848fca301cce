//! A distribution in five numbers, drawn horizontally; several share one scale.

use askama::Template;
use peernet_statistics::Summary;
use peernet_statistics::number::{SPACE, count, milliseconds};
use peernet_store::MIN_P95_SAMPLES;

use super::{Percent, Scale};

/// A box from the first to the third quartile with the median, whiskers from p5 to p95, and the mean as a ring.
#[derive(Clone, Debug, PartialEq, Template)]
#[template(path = "svg/boxes.html")]
pub(crate) struct BoxPlot {
    look: &'static str,
    label: String,
    grid: Vec<Percent>,
    /// Missing below [`MIN_P95_SAMPLES`] samples.
    whiskers: Option<(Percent, Percent)>,
    quartiles: (Percent, Percent),
    width: Percent,
    median: Percent,
    mean: Percent,
}

impl askama::filters::HtmlSafe for BoxPlot {}

/// The numbers of a box, in the unit of the samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BoxStatistics {
    pub count: u64,
    pub mean: f64,
    /// p25, p50 and p75.
    pub middle: [f64; 3],
    /// p5 and p95; `None` below [`MIN_P95_SAMPLES`] samples.
    pub tails: Option<(f64, f64)>,
}

impl BoxStatistics {
    /// Returns the numbers of a distribution; `None` without samples. Quantiles are within 1 % of the true ones.
    pub(crate) fn of(summary: &Summary) -> Option<Self> {
        let [p5, p25, p50, p75, p95] = [0.05, 0.25, 0.5, 0.75, 0.95].map(|q| summary.quantile(q));
        let tails = p5.zip(p95).filter(|_| summary.count() >= MIN_P95_SAMPLES);
        Some(Self { count: summary.count(), mean: summary.moments.mean, middle: [p25?, p50?, p75?], tails })
    }

    /// Returns the largest value that the plot draws.
    pub(crate) fn top(&self) -> f64 {
        self.tails.map_or(self.middle[2], |(_, p95)| p95).max(self.mean)
    }

    /// Describes the numbers in words; they are in seconds.
    fn words(&self) -> String {
        let [p25, p50, p75] = self.middle.map(milliseconds);
        let tails = self.tails.map_or_else(String::new, |(p5, p95)| {
            format!(", 5{SPACE}% below {}, 95{SPACE}% below {}", milliseconds(p5), milliseconds(p95))
        });
        let mean = milliseconds(self.mean);
        format!(
            "median {p50}{SPACE}ms, quartiles {p25} and {p75}{tails}, mean {mean}; {} samples",
            count(self.count)
        )
    }
}

impl BoxPlot {
    /// Draws a box of seconds on a scale of ms; `of` names the quantity in words.
    pub(crate) fn new(look: &'static str, of: &str, five: &BoxStatistics, scale: &Scale) -> Self {
        let at = |seconds: f64| scale.at(seconds * 1e3);
        let quartiles = (at(five.middle[0]), at(five.middle[2]));
        Self {
            look,
            label: format!("{of}: {}", five.words()),
            grid: scale.grid(),
            whiskers: five.tails.map(|(p5, p95)| (at(p5), at(p95))),
            width: Percent(quartiles.1.0 - quartiles.0.0),
            quartiles,
            median: at(five.middle[1]),
            mean: at(five.mean),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn summary(milliseconds: impl Iterator<Item = u32>) -> Summary {
        let mut summary = Summary::default();
        milliseconds.for_each(|value| summary.record(f64::from(value) / 1e3));
        summary
    }

    #[test]
    fn a_box_lies_where_its_quantiles_are() {
        let five = BoxStatistics::of(&summary(1..=101)).expect("samples");
        let plot = BoxPlot::new("total", "A", &five, &Scale::fit(100.0, 5));
        let (low, high) = plot.whiskers.expect("enough for whiskers");
        for (known, expected) in [
            (low, 6.0),
            (plot.quartiles.0, 26.0),
            (plot.median, 51.0),
            (plot.quartiles.1, 76.0),
            (high, 96.0),
        ] {
            assert!((known.0 - expected).abs() < 0.011 * expected, "{plot:?}");
        }
        assert!((plot.mean.0 - 51.0).abs() < 1e-9, "{plot:?}");
        assert!(plot.to_string().contains("aria-label=\"A: median 5"), "{plot}");
    }

    #[test]
    fn few_samples_have_no_whiskers_and_none_no_box() {
        let few = BoxStatistics::of(&summary(1..=59)).expect("samples");
        assert_eq!((few.tails, few.count), (None, 59));
        assert!(BoxStatistics::of(&summary(1..=60)).expect("samples").tails.is_some());
        assert_eq!(BoxStatistics::of(&Summary::default()), None);
    }
}
