//! A study as figures.

use peernet_statistics::number::{self, mean_std, throughput_between, throughput_with};

use super::Study;
use super::direction::{DirectionStudy, SizeSummary};
use crate::figure::{DOWNLOAD, Mark, Parts, Scaling, Series, UPLOAD, Unit, Value};
use crate::fit::rate;

/// Delay against size, with the lines that were fitted; `None` when no delay is known.
pub(super) fn latency(study: &Study) -> Option<Scaling> {
    let value = |size: &SizeSummary| {
        let bounds = size.bounds.map(|(lo, hi)| (lo, Some(hi)));
        Some(Value { bytes: size.wire_bytes, value: size.median, spread: size.tails, bounds })
    };
    let name = |direction: &DirectionStudy| {
        let fit = direction.main_fit()?;
        let intercept = mean_std(fit.intercept.value, fit.intercept.margin());
        Some(match rate(fit.slope) {
            Some((rate, margin)) => {
                let rate = throughput_with(rate, margin);
                format!("{}: {intercept} ms + size ÷ ({rate}) MB/s", direction.name())
            }
            None => format!("{}: intercept {intercept} ms", direction.name()),
        })
    };
    let line =
        |direction: &DirectionStudy| direction.main_fit().map(|fit| (fit.intercept.value, fit.slope.value));
    let unit = Unit::milliseconds("One-way delay");
    scaling(
        study,
        unit,
        Parts { point: "median", whisker: "clock bounds", line: "best fit" },
        &value,
        &name,
        &line,
    )
}

/// Throughput against size, with that of the slope; `None` when no delay is known.
pub(super) fn throughput(study: &Study) -> Option<Scaling> {
    let value = |size: &SizeSummary| {
        let bounds = size.throughput_bounds;
        Some(Value { bytes: size.wire_bytes, value: size.throughput?, spread: None, bounds })
    };
    let name = |direction: &DirectionStudy| {
        let throughput = direction.throughput?;
        let rate = number::throughput(throughput.value);
        let interval = throughput
            .interval
            .map_or_else(String::new, |interval| format!(" ({})", throughput_between(interval)));
        Some(format!("{}: {rate} MB/s{interval}", direction.name()))
    };
    let line = |direction: &DirectionStudy| direction.throughput.map(|throughput| (throughput.value, 0.0));
    let unit = Unit::megabytes_per_second("Throughput");
    scaling(
        study,
        unit,
        Parts { point: "size ÷ median delay", whisker: "by clock bounds", line: "by slope" },
        &value,
        &name,
        &line,
    )
}

fn scaling(
    study: &Study,
    unit: Unit,
    parts: Parts,
    value: &dyn Fn(&SizeSummary) -> Option<Value>,
    name: &dyn Fn(&DirectionStudy) -> Option<String>,
    line: &dyn Fn(&DirectionStudy) -> Option<(f64, f64)>,
) -> Option<Scaling> {
    let looks = [(UPLOAD, Mark::Disc), (DOWNLOAD, Mark::Triangle)];
    let title = format!("{} against size", unit.title.split(',').next().unwrap_or_default());
    let series = study.directions().into_iter().zip(looks).map(|(direction, (colour, mark))| Series {
        name: name(direction).unwrap_or_else(|| direction.name().to_owned()),
        colour,
        mark,
        values: direction.sizes.iter().filter_map(value).collect(),
        line: line(direction),
    });
    let scaling = Scaling { title, unit, parts, notes: Vec::new(), series: series.collect() };
    scaling.series.iter().any(|series| !series.values.is_empty()).then_some(scaling)
}
