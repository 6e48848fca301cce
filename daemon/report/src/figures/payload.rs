//! Latency and throughput against payload, of runs with payloads of several sizes.

use std::collections::BTreeMap;

use super::written::{Drawing, Shown};
use crate::figure::{DOWNLOAD, Mark, Scaling, Series, UPLOAD, Unit, Value};
use crate::fit::{Fit, Point, Weighted, least_squares};
use crate::number::{megabytes_per_second, milliseconds_with};
use crate::order::Ordered;
use crate::results::{Loaded, Row, RunRecord};

/// More sizes than this are taken together, so that each has enough messages.
const MOST_SIZES: usize = 24;
/// No median is known better than a clock is read: a tenth of a microsecond.
const CLOCK_READ: f64 = 1e-7;

/// The messages of one size. Seconds, bytes.
struct Size {
    bytes: f64,
    delays: Ordered,
    bounds: Option<(f64, f64)>,
}

/// One direction.
struct Way {
    name: &'static str,
    sizes: Vec<Size>,
    fit: Option<Fit>,
}

/// Two figures for each pair of hosts and network.
pub(super) fn drawings(runs: &[Loaded]) -> Result<Vec<Drawing>, String> {
    let mut links: Vec<(String, Vec<&Row>)> = Vec::new();
    for run in runs {
        let link = link(&run.record);
        let rows = run.rows.iter().filter(|row| row.counts());
        match links.iter_mut().find(|(other, _)| *other == link) {
            Some((_, all)) => all.extend(rows),
            None => links.push((link, rows.collect())),
        }
    }
    let ways = |rows: &Vec<&Row>| -> Vec<Way> {
        let ways = ["upload", "download"].map(|name| Way::of(name, rows));
        ways.into_iter().filter(Way::is_varied).collect()
    };
    let studied: Vec<Vec<Way>> =
        links.iter().map(|(_, rows)| ways(rows)).filter(|ways| !ways.is_empty()).collect();
    if studied.is_empty() {
        return Err(
            "it needs messages over one network of which the largest has twice the size of the smallest at least; see \
                    peernet calibrate and the experiment payload-study"
                .to_owned(),
        );
    }
    let drawings = studied.iter().enumerate().flat_map(|(number, ways)| {
        let suffix = if number == 0 { String::new() } else { format!("-{}", number + 1) };
        let latency = Drawing::new(format!("payload-latency{suffix}"), Shown::Scaling(latency(ways)));
        let throughput =
            Drawing::new(format!("payload-throughput{suffix}"), Shown::Scaling(throughput(ways)));
        [latency, throughput]
    });
    Ok(drawings.collect())
}

/// What carries the messages: runs that share it are one study.
fn link(record: &RunRecord) -> String {
    let cloud = record.cloud.as_ref().map_or("", |cloud| &cloud.name);
    let network = record.placement.network.as_deref().unwrap_or_default();
    format!("{}, {cloud}, {network}", record.edge.name)
}

impl Way {
    /// Whether its sizes differ enough to study what they do.
    fn is_varied(&self) -> bool {
        let ends = self.sizes.first().zip(self.sizes.last());
        ends.is_some_and(|(smallest, largest)| largest.bytes >= 2.0 * smallest.bytes)
    }

    fn of(name: &'static str, rows: &[&Row]) -> Self {
        let bytes = |row: &Row| {
            let part = |of: &str| row.value(&format!("{name}-{of}"));
            Some(part("bytes")? + part("logger-bytes").unwrap_or_default())
        };
        let mut by_payload: BTreeMap<u64, Vec<&Row>> = BTreeMap::new();
        for row in rows.iter().filter(|row| row.value(name).is_some_and(f64::is_finite)) {
            if let Some(payload) = row.value(&format!("{name}-bytes")).filter(|bytes| *bytes > 0.0) {
                by_payload.entry(payload as u64).or_default().push(row);
            }
        }
        let sizes = together(by_payload.into_values().collect()).into_iter().filter_map(|rows| {
            let of = |value: &dyn Fn(&Row) -> Option<f64>| {
                rows.iter().filter_map(|row| value(row)).collect::<Ordered>()
            };
            let end = |end: &str| of(&|row: &Row| row.value(&format!("{name}-{end}"))).median();
            Some(Size {
                bytes: of(&bytes).median()?,
                delays: of(&|row| row.value(name)),
                bounds: end("lo").zip(end("hi")),
            })
        });
        let sizes: Vec<Size> = sizes.collect();
        Self { name, fit: fit(&sizes), sizes }
    }

    fn series(&self, number: usize, name: String, value: &dyn Fn(&Size) -> Option<Value>) -> Series {
        let looks = [("upload", UPLOAD, Mark::Disc), ("download", DOWNLOAD, Mark::Triangle)];
        let look = looks.into_iter().find(|(name, ..)| *name == self.name).unwrap_or(looks[number % 2]);
        Series {
            name,
            colour: look.1,
            mark: look.2,
            values: self.sizes.iter().filter_map(value).collect(),
            line: None,
        }
    }
}

/// Neighbouring sizes as one where there are too many: files of a camera are all of different size.
fn together(sizes: Vec<Vec<&Row>>) -> Vec<Vec<&Row>> {
    if sizes.len() <= MOST_SIZES {
        return sizes;
    }
    let all: Vec<&Row> = sizes.into_iter().flatten().collect();
    all.chunks(all.len().div_ceil(MOST_SIZES)).map(<[&Row]>::to_vec).collect()
}

/// A line through the medians, each weighted by how well it is known, as in a calibration.
fn fit(sizes: &[Size]) -> Option<Fit> {
    let errors: Option<Vec<f64>> = sizes.iter().map(|size| size.delays.median_error()).collect();
    let points: Option<Vec<Weighted>> = sizes
        .iter()
        .enumerate()
        .map(|(number, size)| {
            let point = Point { x: size.bytes, y: size.delays.median()? };
            let weight = errors.as_ref().map_or(1.0, |errors| errors[number].max(CLOCK_READ).powi(-2));
            Some(Weighted { point, weight })
        })
        .collect();
    least_squares(&points?)
}

fn latency(ways: &[Way]) -> Scaling {
    let value = |size: &Size| {
        Some(Value {
            bytes: size.bytes,
            value: size.delays.median()?,
            spread: size.delays.tails(),
            bounds: size.bounds.map(|(lo, hi)| (lo, Some(hi))),
        })
    };
    let series = ways.iter().enumerate().map(|(number, way)| {
        let name = way.fit.map_or_else(
            || way.name.to_owned(),
            |fit| {
                let intercept = milliseconds_with(fit.intercept.value, fit.intercept.margin());
                let rate = (fit.slope.value > 0.0)
                    .then(|| format!(" + size ÷ {} MB/s", megabytes_per_second(8.0 / fit.slope.value)));
                format!("{}: {intercept} ms{}", way.name, rate.unwrap_or_default())
            },
        );
        let line = way.fit.map(|fit| (fit.intercept.value, fit.slope.value));
        Series { line, ..way.series(number, name, &value) }
    });
    Scaling {
        unit: Unit::milliseconds("One-way delay"),
        note: "point: median · bar: 5th to 95th percentile · whisker: clock bounds · line: best fit, intercept ± 95 %",
        series: series.collect(),
    }
}

fn throughput(ways: &[Way]) -> Scaling {
    let rate = |bytes: f64, seconds: f64| (seconds > 0.0).then(|| bytes * 8.0 / seconds);
    let value = |size: &Size| {
        let bounds = size.bounds.and_then(|(lo, hi)| Some((rate(size.bytes, hi)?, rate(size.bytes, lo))));
        Some(Value {
            bytes: size.bytes,
            value: rate(size.bytes, size.delays.median()?)?,
            spread: None,
            bounds,
        })
    };
    let series = ways.iter().enumerate().map(|(number, way)| {
        let slope = way.fit.filter(|fit| fit.slope.value > 0.0).map(|fit| 8.0 / fit.slope.value);
        let name = slope.map_or_else(
            || way.name.to_owned(),
            |rate| format!("{}: {} MB/s", way.name, megabytes_per_second(rate)),
        );
        Series { line: slope.map(|rate| (rate, 0.0)), ..way.series(number, name, &value) }
    });
    Scaling {
        unit: Unit::megabytes_per_second("Throughput"),
        note: "point: size ÷ median delay · whisker: by clock bounds · line: by slope",
        series: series.collect(),
    }
}
