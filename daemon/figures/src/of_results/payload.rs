//! Latency and throughput against payload, of runs with payloads of several sizes.

use std::collections::BTreeMap;

use peernet_statistics::number::{bytes, counted, fixed, mean_std, throughput_with};

use super::columns::{excluded_note, is_drawable, too_large_note, with_run_name};
use super::missing_data::MissingData;
use super::written::{Drawing, Shown};
use crate::drawing::{Parts, Scaling, Series, Unit, Value};
use crate::look::Mark;
use peernet_analysis::compare::Configurations;
use peernet_analysis::fit::{Fit, Point, Weighted, least_squares, rate};
use peernet_analysis::loaded::Loaded;
use peernet_analysis::order::SortedValues;
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::RowRef;

/// Number of sizes above which neighbours are merged, so that each has enough messages.
const MAX_SIZES: usize = 24;
/// Columns that the figures are drawn from.
const PAYLOAD_COLUMNS: [&str; 6] =
    ["upload", "upload-bytes", "upload-logger-bytes", "download", "download-bytes", "download-logger-bytes"];
/// Resolution of a clock, a tenth of a microsecond: the minimum error of a median.
const CLOCK_RESOLUTION_S: f64 = 1e-7;

/// The messages of one size. Seconds, bytes.
struct Size {
    bytes: f64,
    delays: SortedValues,
    bounds: Option<(f64, f64)>,
}

/// Messages in one direction.
struct DirectionData {
    name: &'static str,
    sizes: Vec<Size>,
    fit: Option<Fit>,
    /// Number of its messages that have a size and no delay.
    unknown: u64,
}

/// The messages over one link.
struct Study {
    directions: Vec<DirectionData>,
    /// Name of the link, for the title.
    hosts: String,
    notes: Vec<String>,
    /// Notes on the directions that are not drawn.
    missing: Vec<String>,
}

/// Returns two figures for each pair of hosts and the network between them.
pub(super) fn drawings(runs: &[Loaded]) -> Result<Vec<Drawing>, MissingData> {
    // Indexes of the runs of each link.
    let mut links: Vec<(String, Vec<usize>)> = Vec::new();
    for (number, run) in runs.iter().enumerate() {
        let link = link(&run.record);
        match links.iter_mut().find(|(other, _)| *other == link) {
            Some((_, all)) => all.push(number),
            None => links.push((link, vec![number])),
        }
    }
    let directions = |runs_of: &[usize]| -> [DirectionData; 2] {
        let rows = runs_of.iter().flat_map(|number| &runs[*number].rows).filter(|row| row.is_counted());
        let rows: Vec<RowRef<'_>> = rows.collect();
        ["upload", "download"].map(|name| DirectionData::of(name, &rows))
    };
    let configurations = Configurations::from_runs(runs);
    let studied = links.into_iter().map(|(_, runs_of)| {
        let rows = runs_of.iter().flat_map(|number| &runs[*number].rows);
        let notes =
            [pooled(&configurations, &runs_of), excluded_note(&rows), too_large_note(rows, &PAYLOAD_COLUMNS)];
        let (directions, others): (Vec<DirectionData>, Vec<DirectionData>) =
            directions(&runs_of).into_iter().partition(DirectionData::is_varied);
        let undetermined = directions.iter().flat_map(DirectionData::undrawn_notes);
        Study {
            notes: notes.into_iter().flatten().chain(undetermined).collect(),
            hosts: host_names(&runs[runs_of[0]].record),
            missing: others.iter().filter_map(DirectionData::missing_reason).collect(),
            directions,
        }
    });
    let (mut studied, others): (Vec<Study>, Vec<Study>) =
        studied.partition(|study: &Study| !study.directions.is_empty());
    // The first figure has the notes on links that have no figure.
    let others = others.into_iter().flat_map(|study| {
        let hosts = study.hosts;
        study.missing.into_iter().map(move |missing| with_run_name(&missing, &hosts))
    });
    if let Some(first) = studied.first_mut() {
        first.missing.extend(others);
    }
    if studied.is_empty() {
        return Err(MissingData::MessageSizes);
    }
    let drawings = studied.iter().enumerate().flat_map(|(number, study)| {
        let suffix = if number == 0 { String::new() } else { format!("-{}", number + 1) };
        let latency = Drawing::new(format!("payload-latency{suffix}"), Shown::Scaling(latency(study)));
        let throughput =
            Drawing::new(format!("payload-throughput{suffix}"), Shown::Scaling(throughput(study)));
        // Both figures have these notes, so other texts need them only once.
        [latency.without(study.missing.clone()), throughput]
    });
    Ok(drawings.collect())
}

/// Returns the hosts and network that carry the messages: runs that share them are one study. One host has a different address in each
/// network.
fn link(record: &RunRecord) -> String {
    let cloud = record.cloud.as_ref().map_or("", |cloud| &cloud.name);
    let [network, address] = [&record.placement.network, &record.placement.address]
        .map(|text| text.as_deref().unwrap_or_default());
    format!("{}, {cloud}, {network}, {address}", record.edge.name)
}

/// Returns the two hosts of a link, as far as they have names, and the address of the cloud.
fn host_names(record: &RunRecord) -> String {
    let hosts =
        [Some(&record.edge), record.cloud.as_ref()].into_iter().flatten().map(|host| host.name.as_str());
    let hosts = hosts.filter(|name| !name.is_empty()).collect::<Vec<_>>().join(" → ");
    match record.placement.address.as_deref().map(|address| address.trim_start_matches("tcp://")) {
        Some(address) if !hosts.is_empty() => format!("{hosts} ({address})"),
        _ => hosts,
    }
}

/// Returns a note that one line is fitted to the messages of several runs, and in what these differ; `None` for a single run.
fn pooled(configurations: &Configurations, runs: &[usize]) -> Option<String> {
    (runs.len() > 1).then_some(())?;
    let label = |run: usize, axis: usize| &configurations.labels[run][axis];
    let differing = configurations.axes.iter().enumerate().filter(|(axis, name)| {
        *name != "run" && runs.iter().any(|run| label(*run, *axis) != label(runs[0], *axis))
    });
    let differing: Vec<&str> = differing.map(|(_, name)| name.as_str()).collect();
    let count = runs.len();
    Some(match differing.as_slice() {
        [] => format!("messages of {count} runs, pooled"),
        axes => format!("messages of {count} runs, pooled, that differ in {}", axes.join(", ")),
    })
}

impl DirectionData {
    /// Returns whether its sizes differ enough to show their effect.
    fn is_varied(&self) -> bool {
        let ends = self.sizes.first().zip(self.sizes.last());
        ends.is_some_and(|(smallest, largest)| largest.bytes >= 2.0 * smallest.bytes)
    }

    /// Returns the reason why it is not drawn; `None` if nothing was sent.
    fn missing_reason(&self) -> Option<String> {
        let (smallest, largest) = self.sizes.first().zip(self.sizes.last())?;
        let ends = [smallest, largest].map(|size| bytes(size.bytes).plain());
        let sizes = if ends[0] == ends[1] { ends[0].clone() } else { ends.join(" to ") };
        Some(format!("not drawn: {}, {sizes}: the largest must be twice the smallest", self.name))
    }

    /// Returns notes on its messages that are in no figure.
    fn undrawn_notes(&self) -> Vec<String> {
        let below = |size: &&Size| size.delays.median().is_some_and(|median| median <= 0.0);
        let below = self.sizes.iter().filter(below).count();
        let unknown = (self.unknown > 0).then(|| {
            format!("left out: {} of {} without a known delay", counted(self.unknown, "message"), self.name)
        });
        let below = (below > 0).then(|| {
            let sizes = counted(below as u64, "size");
            format!("not drawn: {sizes} of {} whose median delay is not above zero", self.name)
        });
        unknown.into_iter().chain(below).collect()
    }

    /// Returns its line if larger messages take longer. Otherwise the delay does not depend on size, and the intercept of such a line has
    /// no meaning.
    fn increasing_fit(&self) -> Option<Fit> {
        self.fit.filter(|fit| fit.slope.value > 0.0)
    }

    /// Returns the rate by its slope, with its margin, bits per second; `None` if the sizes do not determine it.
    fn rate(&self) -> Option<(f64, f64)> {
        self.increasing_fit().and_then(|fit| rate(fit.slope))
    }

    fn of(name: &'static str, rows: &[RowRef<'_>]) -> Self {
        let bytes = |row: &RowRef<'_>| {
            let part = |of: &str| row.value(&format!("{name}-{of}")).filter(|bytes| is_drawable(*bytes));
            Some(part("bytes")? + part("logger-bytes").unwrap_or_default())
        };
        let mut by_payload: BTreeMap<u64, Vec<RowRef<'_>>> = BTreeMap::new();
        for row in rows.iter().filter(|row| row.value(name).is_some_and(is_drawable)) {
            if let Some(payload) =
                row.value(&format!("{name}-bytes")).filter(|bytes| *bytes > 0.0 && is_drawable(*bytes))
            {
                by_payload.entry(payload as u64).or_default().push(*row);
            }
        }
        let sizes = merge_sizes(by_payload.into_values().collect()).into_iter().filter_map(|rows| {
            let of = |value: &dyn Fn(&RowRef<'_>) -> Option<f64>| {
                rows.iter().filter_map(value).collect::<SortedValues>()
            };
            let end = |end: &str| of(&|row: &RowRef<'_>| row.value(&format!("{name}-{end}"))).median();
            Some(Size {
                bytes: of(&bytes).median()?,
                delays: of(&|row| row.value(name)),
                bounds: end("lo").zip(end("hi")),
            })
        });
        let sizes: Vec<Size> = sizes.collect();
        let is_unknown = |row: &&RowRef<'_>| {
            row.value(&format!("{name}-bytes")).is_some_and(|bytes| bytes > 0.0) && row.value(name).is_none()
        };
        let unknown = rows.iter().filter(is_unknown).count() as u64;
        Self { name, fit: fit(&sizes), sizes, unknown }
    }

    fn series(&self, name: String, value: &dyn Fn(&Size) -> Option<Value>) -> Series {
        let mark = if self.name == "upload" { Mark::Disc } else { Mark::Triangle };
        Series {
            name,
            stage: self.name,
            mark,
            values: self.sizes.iter().filter_map(value).collect(),
            line: None,
        }
    }
}

impl Study {
    /// Returns a note on the number of messages behind each point.
    fn count_note(&self) -> Option<String> {
        let counts =
            || self.directions.iter().flat_map(|direction| &direction.sizes).map(|size| size.delays.len());
        let [fewest, most] = [counts().min()?, counts().max()?].map(|count| fixed(count as f64, 0));
        let each = if fewest == most { most } else { format!("{fewest} to {most}") };
        Some(format!("messages of each size: {each}"))
    }

    /// Returns its notes, including a note on a rate that is not given.
    fn notes(&self) -> Vec<String> {
        let undetermined: Vec<&str> = self
            .directions
            .iter()
            .filter(|direction| direction.increasing_fit().is_some() && direction.rate().is_none())
            .map(|direction| direction.name)
            .collect();
        let fast = (!undetermined.is_empty()).then(|| {
            format!("throughput of {}: too fast to tell from these sizes", undetermined.join(" and of "))
        });
        self.missing.iter().chain(&self.notes).cloned().chain(self.count_note()).chain(fast).collect()
    }
}

/// Merges neighbouring sizes if there are too many: files of a camera all have different sizes.
fn merge_sizes(sizes: Vec<Vec<RowRef<'_>>>) -> Vec<Vec<RowRef<'_>>> {
    if sizes.len() <= MAX_SIZES {
        return sizes;
    }
    let all: Vec<RowRef<'_>> = sizes.into_iter().flatten().collect();
    all.chunks(all.len().div_ceil(MAX_SIZES)).map(<[RowRef<'_>]>::to_vec).collect()
}

/// Fits a line through the medians, each weighted by its precision, as in a calibration.
fn fit(sizes: &[Size]) -> Option<Fit> {
    let errors: Option<Vec<f64>> = sizes.iter().map(|size| size.delays.median_error()).collect();
    let points: Option<Vec<Weighted>> = sizes
        .iter()
        .enumerate()
        .map(|(number, size)| {
            let point = Point { x: size.bytes, y: size.delays.median()? };
            let weight =
                errors.as_ref().map_or(1.0, |errors| errors[number].max(CLOCK_RESOLUTION_S).powi(-2));
            Some(Weighted { point, weight })
        })
        .collect();
    least_squares(&points?)
}

fn latency(study: &Study) -> Scaling {
    let value = |size: &Size| {
        Some(Value {
            bytes: size.bytes,
            value: size.delays.median()?,
            spread: size.delays.tails(),
            bounds: size.bounds.map(|(lo, hi)| (lo, Some(hi))),
        })
    };
    let series = study.directions.iter().map(|direction| {
        let name = match (direction.fit, direction.increasing_fit()) {
            (_, Some(Fit { intercept, .. })) => {
                let least = mean_std(intercept.value, intercept.margin());
                match direction.rate() {
                    Some((rate, margin)) => {
                        let rate = throughput_with(rate, margin);
                        format!("{}: {least} ms + size ÷ ({rate}) MB/s", direction.name)
                    }
                    None => format!("{}: intercept {least} ms", direction.name),
                }
            }
            (Some(_), None) => format!("{}: does not grow with size", direction.name),
            (None, None) => direction.name.to_owned(),
        };
        let line = direction.increasing_fit().map(|fit| (fit.intercept.value, fit.slope.value));
        Series { line, ..direction.series(name, &value) }
    });
    Scaling {
        title: with_run_name("One-way delay against payload", &study.hosts),
        unit: Unit::milliseconds("One-way delay"),
        parts: Parts { point: "median", whisker: "clock bounds", line: "best fit, ±\u{a0}95\u{a0}%" },
        notes: study.notes(),
        series: series.collect(),
    }
}

fn throughput(study: &Study) -> Scaling {
    let over = |bytes: f64, seconds: f64| (seconds > 0.0).then(|| bytes * 8.0 / seconds);
    let value = |size: &Size| {
        let bounds = size.bounds.and_then(|(lo, hi)| Some((over(size.bytes, hi)?, over(size.bytes, lo))));
        Some(Value {
            bytes: size.bytes,
            value: over(size.bytes, size.delays.median()?)?,
            spread: None,
            bounds,
        })
    };
    let series = study.directions.iter().map(|direction| {
        let name = direction.rate().map_or_else(
            || direction.name.to_owned(),
            |(rate, margin)| format!("{}: {} MB/s", direction.name, throughput_with(rate, margin)),
        );
        Series { line: direction.rate().map(|(rate, _)| (rate, 0.0)), ..direction.series(name, &value) }
    });
    Scaling {
        title: with_run_name("Throughput against payload", &study.hosts),
        unit: Unit::megabytes_per_second("Throughput"),
        parts: Parts {
            point: "size ÷ median delay",
            whisker: "by clock bounds",
            line: "by slope, ±\u{a0}95\u{a0}%",
        },
        notes: study.notes(),
        series: series.collect(),
    }
}
