//! Figures of latency and throughput against payload, for runs with payloads of several sizes.

use std::collections::BTreeMap;

use peernet_statistics::number::{bytes, counted, fixed, mean_std, throughput_with};

use super::columns::{excluded_note, is_drawable, too_large_note, with_name};
use super::missing_data::MissingData;
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::{Parts, Scaling, Series, Unit, Value};
use crate::look::Mark;
use peernet_analysis::compare::Configurations;
use peernet_analysis::fit::{Fit, Point, Weighted, least_squares, rate};
use peernet_analysis::loaded::Loaded;
use peernet_analysis::order::SortedValues;
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::RowRef;

/// Maximum number of sizes. If there are more, neighbouring sizes are merged, so that each has enough messages.
const MAX_SIZES: usize = 24;
/// Columns that the figures are drawn from.
const PAYLOAD_COLUMNS: [&str; 6] =
    ["upload", "upload-bytes", "upload-logger-bytes", "download", "download-bytes", "download-logger-bytes"];
/// Resolution of a clock, a tenth of a microsecond: the minimum error of a median.
const CLOCK_RESOLUTION_S: f64 = 1e-7;

/// Messages of one size in one direction.
struct Size {
    /// Median of the payloads with their logger data, bytes.
    bytes: f64,
    /// Delays, seconds.
    delays: SortedValues,
    /// Medians of the lower and of the upper clock bounds of the delays, seconds.
    bounds: Option<(f64, f64)>,
}

/// Messages in one direction.
struct DirectionData {
    /// `upload` or `download`.
    name: &'static str,
    /// Sizes, the smallest first.
    sizes: Vec<Size>,
    fit: Option<Fit>,
    /// Number of messages that have a size but no delay.
    unknown_delays: u64,
}

/// Messages over one link.
struct Study {
    /// Directions that are drawn.
    directions: Vec<DirectionData>,
    /// Name of the link, for the title.
    link_name: String,
    notes: Vec<String>,
    /// Notes on the directions that are not drawn.
    missing: Vec<String>,
}

/// Returns two figures for each link: latency and throughput.
pub(super) fn drawings(runs: &[Loaded]) -> Result<Vec<Drawing>, MissingData> {
    // Indexes of the runs of each link.
    let mut links: Vec<(String, Vec<usize>)> = Vec::new();
    for (number, run) in runs.iter().enumerate() {
        let link = link_key(&run.record);
        match links.iter_mut().find(|(other, _)| *other == link) {
            Some((_, run_indexes)) => run_indexes.push(number),
            None => links.push((link, vec![number])),
        }
    }
    let both_directions = |run_indexes: &[usize]| -> [DirectionData; 2] {
        let rows = run_indexes.iter().flat_map(|index| &runs[*index].rows).filter(|row| row.is_counted());
        let rows: Vec<RowRef<'_>> = rows.collect();
        ["upload", "download"].map(|name| DirectionData::from_rows(name, &rows))
    };
    let configurations = Configurations::from_runs(runs);
    let studies = links.into_iter().map(|(_, run_indexes)| {
        let rows = run_indexes.iter().flat_map(|index| &runs[*index].rows);
        let notes = [
            pooled_note(&configurations, &run_indexes),
            excluded_note(&rows),
            too_large_note(rows, &PAYLOAD_COLUMNS),
        ];
        let (directions, others): (Vec<DirectionData>, Vec<DirectionData>) =
            both_directions(&run_indexes).into_iter().partition(DirectionData::is_varied);
        let undrawn_notes = directions.iter().flat_map(DirectionData::undrawn_notes);
        Study {
            notes: notes.into_iter().flatten().chain(undrawn_notes).collect(),
            link_name: link_name(&runs[run_indexes[0]].record),
            missing: others.iter().filter_map(DirectionData::missing_reason).collect(),
            directions,
        }
    });
    let (mut studies, others): (Vec<Study>, Vec<Study>) =
        studies.partition(|study: &Study| !study.directions.is_empty());
    // The first figure has the notes on links that have no figure.
    let others = others.into_iter().flat_map(|study| {
        let link_name = study.link_name;
        study.missing.into_iter().map(move |missing| with_name(&missing, &link_name))
    });
    if let Some(first) = studies.first_mut() {
        first.missing.extend(others);
    }
    if studies.is_empty() {
        return Err(MissingData::MessageSizes);
    }
    let drawings = studies.iter().enumerate().flat_map(|(number, study)| {
        let suffix = if number == 0 { String::new() } else { format!("-{}", number + 1) };
        let latency = Drawing::new(format!("payload-latency{suffix}"), AnyFigure::Scaling(latency(study)));
        let throughput =
            Drawing::new(format!("payload-throughput{suffix}"), AnyFigure::Scaling(throughput(study)));
        // The text files of both figures have these notes. Only one figure passes them on to the printed list, so that each is printed once.
        [latency.with_left_out(study.missing.clone()), throughput]
    });
    Ok(drawings.collect())
}

/// Returns a text that identifies the link of a run: edge, cloud, network and address. Runs over the same link are one study. The address is
/// part of the text, because a host has a different address in each network.
fn link_key(record: &RunRecord) -> String {
    let cloud = record.cloud.as_ref().map_or("", |cloud| &cloud.name);
    let [network, address] = [&record.placement.network, &record.placement.address]
        .map(|text| text.as_deref().unwrap_or_default());
    format!("{}, {cloud}, {network}, {address}", record.edge.name)
}

/// Returns the name of a run's link: the names of its two hosts, as far as they are known, and the address of the cloud.
fn link_name(record: &RunRecord) -> String {
    let hosts =
        [Some(&record.edge), record.cloud.as_ref()].into_iter().flatten().map(|host| host.name.as_str());
    let hosts = hosts.filter(|name| !name.is_empty()).collect::<Vec<_>>().join(" → ");
    match record.placement.address.as_deref().map(|address| address.trim_start_matches("tcp://")) {
        Some(address) if !hosts.is_empty() => format!("{hosts} ({address})"),
        _ => hosts,
    }
}

/// Returns a note that the messages of several runs are pooled, with the names of the labels in which the runs differ. `None` for a single
/// run.
fn pooled_note(configurations: &Configurations, runs: &[usize]) -> Option<String> {
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
    /// Returns whether the sizes differ enough to show their effect.
    fn is_varied(&self) -> bool {
        let ends = self.sizes.first().zip(self.sizes.last());
        ends.is_some_and(|(smallest, largest)| largest.bytes >= 2.0 * smallest.bytes)
    }

    /// Returns the reason why the direction is not drawn; `None` if nothing was sent.
    fn missing_reason(&self) -> Option<String> {
        let (smallest, largest) = self.sizes.first().zip(self.sizes.last())?;
        let ends = [smallest, largest].map(|size| bytes(size.bytes).plain());
        let sizes = if ends[0] == ends[1] { ends[0].clone() } else { ends.join(" to ") };
        Some(format!("not drawn: {}, {sizes}: the largest must be twice the smallest", self.name))
    }

    /// Returns notes on the messages that are in neither figure.
    fn undrawn_notes(&self) -> Vec<String> {
        let is_negative = |size: &&Size| size.delays.median().is_some_and(|median| median <= 0.0);
        let negative_sizes = self.sizes.iter().filter(is_negative).count();
        let unknown_delays_note = (self.unknown_delays > 0).then(|| {
            let messages = counted(self.unknown_delays, "message");
            format!("left out: {messages} of {} without a known delay", self.name)
        });
        let negative_delays_note = (negative_sizes > 0).then(|| {
            let sizes = counted(negative_sizes as u64, "size");
            format!("not drawn: {sizes} of {} whose median delay is not above zero", self.name)
        });
        unknown_delays_note.into_iter().chain(negative_delays_note).collect()
    }

    /// Returns the fitted line if larger messages take longer. Otherwise the delay does not grow with the size, and the intercept of the line
    /// has no meaning.
    fn increasing_fit(&self) -> Option<Fit> {
        self.fit.filter(|fit| fit.slope.value > 0.0)
    }

    /// Returns the rate by the slope of the fitted line, with its margin, bits per second. `None` if the sizes do not determine the rate.
    fn rate(&self) -> Option<(f64, f64)> {
        self.increasing_fit().and_then(|fit| rate(fit.slope))
    }

    fn from_rows(name: &'static str, rows: &[RowRef<'_>]) -> Self {
        let message_bytes = |row: &RowRef<'_>| {
            let part =
                |suffix: &str| row.value(&format!("{name}-{suffix}")).filter(|bytes| is_drawable(*bytes));
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
            let sorted = |value: &dyn Fn(&RowRef<'_>) -> Option<f64>| {
                rows.iter().filter_map(value).collect::<SortedValues>()
            };
            let median_bound =
                |suffix: &str| sorted(&|row: &RowRef<'_>| row.value(&format!("{name}-{suffix}"))).median();
            Some(Size {
                bytes: sorted(&message_bytes).median()?,
                delays: sorted(&|row| row.value(name)),
                bounds: median_bound("lo").zip(median_bound("hi")),
            })
        });
        let sizes: Vec<Size> = sizes.collect();
        let is_unknown = |row: &&RowRef<'_>| {
            row.value(&format!("{name}-bytes")).is_some_and(|bytes| bytes > 0.0) && row.value(name).is_none()
        };
        let unknown_delays = rows.iter().filter(is_unknown).count() as u64;
        Self { name, fit: fit(&sizes), sizes, unknown_delays }
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

    /// Returns the notes of the study, including a note on the directions whose rate is not determined.
    fn notes(&self) -> Vec<String> {
        let undetermined_rates: Vec<&str> = self
            .directions
            .iter()
            .filter(|direction| direction.increasing_fit().is_some() && direction.rate().is_none())
            .map(|direction| direction.name)
            .collect();
        let rate_note = (!undetermined_rates.is_empty()).then(|| {
            format!(
                "throughput of {}: too fast to tell from these sizes",
                undetermined_rates.join(" and of ")
            )
        });
        self.missing.iter().chain(&self.notes).cloned().chain(self.count_note()).chain(rate_note).collect()
    }
}

/// Merges neighbouring sizes if there are more than [`MAX_SIZES`]. For example, the compressed images of a camera all have different sizes.
fn merge_sizes(sizes: Vec<Vec<RowRef<'_>>>) -> Vec<Vec<RowRef<'_>>> {
    if sizes.len() <= MAX_SIZES {
        return sizes;
    }
    let rows: Vec<RowRef<'_>> = sizes.into_iter().flatten().collect();
    rows.chunks(rows.len().div_ceil(MAX_SIZES)).map(<[RowRef<'_>]>::to_vec).collect()
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
                let intercept = mean_std(intercept.value, intercept.margin());
                match direction.rate() {
                    Some((rate, margin)) => {
                        let rate = throughput_with(rate, margin);
                        format!("{}: {intercept} ms + size ÷ ({rate}) MB/s", direction.name)
                    }
                    None => format!("{}: intercept {intercept} ms", direction.name),
                }
            }
            (Some(_), None) => format!("{}: does not grow with size", direction.name),
            (None, None) => direction.name.to_owned(),
        };
        let line = direction.increasing_fit().map(|fit| (fit.intercept.value, fit.slope.value));
        Series { line, ..direction.series(name, &value) }
    });
    Scaling {
        title: with_name("One-way delay against payload", &study.link_name),
        unit: Unit::milliseconds("One-way delay"),
        parts: Parts { point: "median", whisker: "clock bounds", line: "best fit, ±\u{a0}95\u{a0}%" },
        notes: study.notes(),
        series: series.collect(),
    }
}

fn throughput(study: &Study) -> Scaling {
    let bits_per_second = |bytes: f64, seconds: f64| (seconds > 0.0).then(|| bytes * 8.0 / seconds);
    let value = |size: &Size| {
        // The longest delay gives the lowest throughput. If the shortest is zero or less, the throughput has no upper bound.
        let bounds = size
            .bounds
            .and_then(|(lo, hi)| Some((bits_per_second(size.bytes, hi)?, bits_per_second(size.bytes, lo))));
        Some(Value {
            bytes: size.bytes,
            value: bits_per_second(size.bytes, size.delays.median()?)?,
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
        title: with_name("Throughput against payload", &study.link_name),
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
