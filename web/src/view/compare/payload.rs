//! Latency against payload.

use peernet_analysis::compare::readable_name;
use peernet_analysis::fit::{Fit, MIN_SIZES, MeanAtSize, distinct_sizes, is_same_size, line_through_means};
use peernet_figures::drawing::{Scatter, ScatterLine, ScatterPoint, ScatterSeries};
use peernet_figures::plot::Axis;
use peernet_figures::scale::Scale;
use peernet_logger::stage;
use peernet_statistics::number::{SPACE, bytes, interval_ms, within_ms};
use peernet_store::QuantityStatistics;

use super::{Comparison, Configuration};
use crate::picture::Picture;

/// Maximum number of groups with separate lines; more lines would be hard to distinguish.
const MAX_GROUPS: usize = 3;

/// Returns the mean size of the payloads that a configuration sent; `None` if it sent none.
fn payload_size(one: &Configuration) -> Option<f64> {
    one.figures(&stage::UPLOAD_BYTES).map(|figures| figures.mean).filter(|size| *size > 0.0)
}

/// Returns a plot of latency against payload, and sentences about the lines through the points. `None` if the payloads have fewer than
/// three sizes.
pub(crate) fn payload(comparison: &Comparison) -> Option<(Picture, Vec<String>)> {
    let all: Vec<(&Configuration, f64)> =
        comparison.configurations.iter().filter_map(|one| Some((one, payload_size(one)?))).collect();
    let sizes = || all.iter().map(|(_, size)| *size);
    let (least, most) = sizes().fold((f64::INFINITY, 0.0_f64), |(lo, hi), size| (lo.min(size), hi.max(size)));
    (distinct_sizes(sizes()) >= MIN_SIZES).then_some(())?;
    let groups = groups(comparison, &all);
    let mut sentences = Vec::new();
    let series = ["total", "upload"].map(|name| {
        let points = all.iter().filter_map(|(one, size)| {
            let figures = one.figures(name)?;
            Some(ScatterPoint {
                x: size / 1e3,
                y: figures.mean * 1e3,
                ends: figures.std.map(|std| ((figures.mean - std) * 1e3, (figures.mean + std) * 1e3)),
                name: name_in(comparison, &groups, one),
            })
        });
        let mut lines = Vec::new();
        for group in &groups {
            let Some((fit, ends)) = line(group, name) else { continue };
            lines.push(ScatterLine {
                intercept: fit.intercept.value * 1e3,
                slope: fit.slope.value * 1e6,
                from: ends.0 / 1e3,
                to: ends.1 / 1e3,
            });
            sentences.push(sentence(name, group_name(comparison, group).as_deref(), &fit));
        }
        ScatterSeries {
            stage: peernet_figures::look::stage(name),
            name: name.to_owned(),
            points: points.collect(),
            lines,
        }
    });
    let x = Axis::new(Scale::of_sizes(sizes().map(|size| size / 1e3)), "", "kB sent");
    let points = || series.iter().flat_map(|one| &one.points);
    let up = Scale::up_to(points().map(ScatterPoint::top).fold(0.0, f64::max), 5);
    let label =
        format!("Mean latency against payload, {} to {}. {}", bytes(least), bytes(most), sentences.join(" "));
    let scatter = Scatter { x, y: Axis::new(up, "", "ms"), series: series.into() };
    Some((Picture::of_scatter(&scatter, &label), sentences))
}

pub(super) type Group<'a> = Vec<(&'a Configuration, f64)>;

/// Groups configurations that differ only in the size of the payload. On the axis that sets the size, equal labels mean equal
/// sizes. Returns a single group of all configurations if there is no such axis or there would be too many groups.
pub(super) fn groups<'a>(comparison: &Comparison, all: &[(&'a Configuration, f64)]) -> Vec<Group<'a>> {
    let sets_the_size = |axis: &usize| {
        let label = |one: &Configuration| one.values.get(*axis).cloned();
        all.iter().all(|(one, size)| {
            let with_same_label = all.iter().filter(|(other, _)| label(other) == label(one));
            with_same_label.into_iter().all(|(_, other)| is_same_size(*size, *other))
        })
    };
    let Some(axis) = (0..comparison.axes.len()).find(sets_the_size) else { return vec![all.to_vec()] };
    let others = |one: &Configuration| {
        let labels = one.values.iter().enumerate().filter(|(index, _)| *index != axis);
        labels.map(|(_, label)| label.clone()).collect::<Vec<String>>()
    };
    let mut groups: Vec<Group<'a>> = Vec::new();
    for (one, size) in all {
        match groups.iter_mut().find(|group| others(group[0].0) == others(one)) {
            Some(group) => group.push((one, *size)),
            None => groups.push(vec![(one, *size)]),
        }
    }
    if groups.len() > MAX_GROUPS { vec![all.to_vec()] } else { groups }
}

/// Returns in words the values that all configurations of a group have in common and some other configuration lacks; `None` if there are
/// no such values.
pub(super) fn group_name(comparison: &Comparison, group: &Group<'_>) -> Option<String> {
    let value = |one: &Configuration, axis: usize| one.values.get(axis).cloned();
    let first = group.first()?.0;
    let is_common = |axis: &usize| group.iter().all(|(one, _)| value(one, *axis) == value(first, *axis));
    let is_distinctive =
        |axis: &usize| comparison.configurations.iter().any(|one| value(one, *axis) != value(first, *axis));
    let axes: Vec<usize> = (0..comparison.axes.len()).filter(is_common).filter(is_distinctive).collect();
    let names: Vec<String> = axes.iter().map(|axis| comparison.axes[*axis].clone()).collect();
    let values: Vec<String> = axes.iter().filter_map(|axis| value(first, *axis)).collect();
    Some(readable_name(&names, &values)).filter(|words| !words.is_empty())
}

/// Returns the name of a point on an axis of sizes. It is the name of the group, because the axis already shows the size.
pub(super) fn name_in(comparison: &Comparison, groups: &[Group<'_>], one: &Configuration) -> String {
    let group = groups.iter().find(|group| group.iter().any(|(other, _)| other.name == one.name));
    group.and_then(|group| group_name(comparison, group)).unwrap_or_default()
}

/// Fits a line of seconds over bytes through the means of a group. Each mean is weighted by its precision. Returns the line, and the
/// smallest and the largest size. `None` if there are too few sizes.
pub(super) fn line(group: &Group<'_>, name: &str) -> Option<(Fit, (f64, f64))> {
    let means = group.iter().filter_map(|(one, size)| {
        let QuantityStatistics { count, mean, std, .. } = *one.figures(name)?;
        Some(MeanAtSize { size: *size, count, mean, std })
    });
    let means: Vec<MeanAtSize> = means.collect();
    let fit = line_through_means(&means)?;
    let ends =
        means.iter().fold((f64::INFINITY, 0.0_f64), |(lo, hi), mean| (lo.min(mean.size), hi.max(mean.size)));
    Some((fit, ends))
}

/// Returns `total (50 Hz): 0.12 ms (95 %: 0.10 – 0.14) and 0.84 ms (0.80 – 0.88) more per MB.`
fn sentence(name: &str, group: Option<&str>, fit: &Fit) -> String {
    let group_text = group.map_or_else(String::new, |group| format!(" ({group})"));
    let (base, slope) = (fit.intercept.span(), fit.slope.span());
    let per_megabyte = (slope.0 * 1e6, slope.1 * 1e6);
    format!(
        "{name}{group_text}: {}{SPACE}ms (95{SPACE}%: {}) and {}{SPACE}ms ({}) more per MB sent. Line through {} means, \
         each weighted by how well it is known.",
        within_ms(fit.intercept.value, base),
        interval_ms(base.0, base.1),
        within_ms(fit.slope.value * 1e6, per_megabyte),
        interval_ms(per_megabyte.0, per_megabyte.1),
        fit.points
    )
}
