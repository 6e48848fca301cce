//! Figures of delay and throughput against the size of messages, for a calibration and for the payload study of
//! recorded runs.

use peernet_statistics::number::{mean_std, throughput_with_margin};

use crate::drawing::{Explanations, Scaling, Series, Unit, Value};
use crate::look::Mark;
use peernet_analysis::fit::{Fit, rate};
use peernet_analysis::message_sizes::{SizeSummary, line_through_medians};
use peernet_analysis::payload_study::{DirectionMessages, PayloadStudy};

/// Messages of one direction.
#[derive(Clone, Debug)]
pub(crate) struct MessageSeries {
    /// `upload` or `download`.
    pub name: &'static str,
    /// Summaries of the sizes, in ascending order of size.
    pub sizes: Vec<SizeSummary>,
    /// Line through the median delays of the sizes; `None` with fewer than three sizes.
    fit: Option<Fit>,
}

/// Messages over one link, from which the figures of latency and of throughput are drawn.
#[derive(Clone, Debug)]
pub(crate) struct LinkMessages {
    /// Name of the link in the titles; empty if the titles need no name.
    pub link_name: String,
    /// Directions that are drawn.
    pub directions: Vec<MessageSeries>,
    /// Notes on the messages.
    pub notes: Vec<String>,
}

/// Returns the figures of latency and of throughput against payload.
pub fn payload_figures(study: &PayloadStudy) -> [Scaling; 2] {
    let series = |direction: &DirectionMessages| MessageSeries::new(direction.name, direction.sizes.clone());
    let messages = LinkMessages {
        link_name: study.link_name.clone(),
        directions: study.directions.iter().map(series).collect(),
        notes: study.all_notes(),
    };
    [messages.latency(), messages.throughput()]
}

impl MessageSeries {
    /// Returns the messages of a direction with the line through their medians.
    pub(crate) fn new(name: &'static str, sizes: Vec<SizeSummary>) -> Self {
        Self { name, fit: line_through_medians(&sizes), sizes }
    }

    /// Returns the fitted line if larger messages take longer; otherwise `None`. If the delay does not grow with the
    /// size, the intercept of the line has no meaning.
    fn increasing_fit(&self) -> Option<Fit> {
        self.fit.filter(|fit| fit.slope.value > 0.0)
    }

    /// Returns the rate that follows from the slope of the fitted line, and the margin of the rate; bits per second.
    /// `None` if the delays of these sizes do not determine a rate.
    fn rate(&self) -> Option<(f64, f64)> {
        self.increasing_fit().and_then(|fit| rate(fit.slope))
    }

    /// Returns the series of delays in the figure of latency. Its name in the legend contains the equation of the line.
    fn latency(&self) -> Series {
        let name = match (self.fit, self.increasing_fit()) {
            (_, Some(Fit { intercept, .. })) => {
                let intercept = mean_std(intercept.value, intercept.margin());
                match self.rate() {
                    Some((rate, margin)) => {
                        let rate = throughput_with_margin(rate, margin);
                        format!("{}: {intercept} ms + size ÷ ({rate}) MB/s", self.name)
                    }
                    None => format!("{}: intercept {intercept} ms", self.name),
                }
            }
            (Some(_), None) => format!("{}: does not grow with size", self.name),
            (None, None) => self.name.to_owned(),
        };
        let line = self.increasing_fit().map(|fit| (fit.intercept.value, fit.slope.value));
        self.series(name, line, |size| {
            let bounds = size.bounds.map(|(lo, hi)| (lo, Some(hi)));
            Some(Value { bytes: size.wire_bytes, value: size.median, p5_and_p95: size.tails, bounds })
        })
    }

    /// Returns the series of throughputs in the figure of throughput. Its horizontal line shows the rate.
    fn throughput(&self) -> Series {
        let name = self.rate().map_or_else(
            || self.name.to_owned(),
            |(rate, margin)| format!("{}: {} MB/s", self.name, throughput_with_margin(rate, margin)),
        );
        let line = self.rate().map(|(rate, _)| (rate, 0.0));
        self.series(name, line, |size| {
            let (value, bounds) = (size.throughput?, size.throughput_bounds);
            Some(Value { bytes: size.wire_bytes, value, p5_and_p95: None, bounds })
        })
    }

    fn series(
        &self,
        name: String,
        line: Option<(f64, f64)>,
        value: impl Fn(&SizeSummary) -> Option<Value>,
    ) -> Series {
        // Directions differ by mark as well as by colour.
        let mark = if self.name == "upload" { Mark::Disc } else { Mark::Triangle };
        Series { name, stage: self.name, mark, values: self.sizes.iter().filter_map(value).collect(), line }
    }
}

impl LinkMessages {
    /// Returns the figure of delay against size, with the fitted lines.
    pub(crate) fn latency(&self) -> Scaling {
        let explanations =
            Explanations { point: "median", whisker: "clock bounds", line: "best fit, ±\u{a0}95\u{a0}%" };
        self.scaling(
            Unit::milliseconds("One-way delay"),
            "One-way delay",
            explanations,
            MessageSeries::latency,
        )
    }

    /// Returns the figure of throughput against size, with a horizontal line at the rate that follows from the slope
    /// of the delays.
    pub(crate) fn throughput(&self) -> Scaling {
        let explanations = Explanations {
            point: "size ÷ median delay",
            whisker: "by clock bounds",
            line: "by slope, ±\u{a0}95\u{a0}%",
        };
        self.scaling(
            Unit::megabytes_per_second("Throughput"),
            "Throughput",
            explanations,
            MessageSeries::throughput,
        )
    }

    fn scaling(
        &self,
        unit: Unit,
        quantity: &str,
        explanations: Explanations,
        series: fn(&MessageSeries) -> Series,
    ) -> Scaling {
        let title = match self.link_name.as_str() {
            "" => format!("{quantity} against payload"),
            link => format!("{quantity} against payload · {link}"),
        };
        let notes = self.notes.iter().cloned().chain(self.undetermined_throughput_note()).collect();
        Scaling { title, unit, explanations, notes, series: self.directions.iter().map(series).collect() }
    }

    /// Returns a note on the directions whose throughput the delays do not determine.
    fn undetermined_throughput_note(&self) -> Option<String> {
        let is_undetermined =
            |series: &&MessageSeries| series.increasing_fit().is_some() && series.rate().is_none();
        let names: Vec<&str> =
            self.directions.iter().filter(is_undetermined).map(|series| series.name).collect();
        (!names.is_empty()).then(|| {
            format!("throughput of {}: too high to be determined from these sizes", names.join(" and of "))
        })
    }
}
