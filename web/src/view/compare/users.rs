//! Latency against the number of users that measure at the same time, and the fairness between these users.

use peernet_analysis::users::{Curve, EdgeShare, Totals, Users, UsersLine};
use peernet_figures::drawing::{Scatter, ScatterLine, ScatterPoint, ScatterSeries};
use peernet_figures::look;
use peernet_figures::plot::Axis;
use peernet_figures::scale::Scale;
use peernet_statistics::number::{NONE, count, duration, mean_std_ms, measured, rate};
use peernet_store::RunSummary;

use super::{Comparison, Configuration};
use crate::picture::Picture;
use crate::view::runs;

/// Row of a configuration with a number of users.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct UsersRow {
    pub name: String,
    pub users: String,
    /// Answers per second of all users together.
    pub rate: String,
    /// Answers per second of the users that got the fewest and the most.
    pub each: String,
    /// Jain's index.
    pub fairness: String,
    /// Mean and standard deviation of the total, ms.
    pub total: (String, Option<String>),
}

/// Returns the plot and its numbers. `None` unless an experiment is compared and its configurations have different numbers of users.
pub(crate) fn users(comparison: &Comparison) -> Option<(Picture, Vec<UsersRow>)> {
    comparison.experiment.as_ref()?;
    let users =
        Users { axes: comparison.axes.clone(), lines: comparison.configurations.iter().map(line).collect() };
    let curves = Curve::from_users(&users);
    let users_of_line = |line: Option<&&UsersLine>| line.map(|line| line.edges);
    let differ =
        |curve: &Curve<'_>| users_of_line(curve.points.first()) != users_of_line(curve.points.last());
    curves.iter().any(differ).then_some(())?;
    // Within an experiment the values identify a configuration.
    let configuration_of =
        |line: &UsersLine| comparison.configurations.iter().find(|one| one.values == line.labels);
    let curves: Vec<Vec<(&UsersLine, &Configuration)>> = curves
        .iter()
        .map(|curve| curve.points.iter().filter_map(|line| Some((*line, configuration_of(line)?))).collect())
        .collect();
    let rows = curves.iter().flatten().map(|(line, one)| row(line, one));
    Some((plot(&curves), rows.collect()))
}

/// Returns the answers per second of each user of a configuration, and its totals.
fn line(one: &Configuration) -> UsersLine {
    let repeat = |run: &RunSummary| run.experiment.as_ref().map_or(0, |place| place.repeat);
    let runs: Vec<(u32, Option<EdgeShare>)> = one.runs.iter().map(|run| (repeat(run), share(run))).collect();
    let totals = one.total().map_or_else(Totals::default, |total| Totals {
        count: usize::try_from(total.count).unwrap_or(usize::MAX),
        mean: Some(total.mean),
        median: Some(total.p50),
        p95: total.p95,
        p99: total.p99,
    });
    UsersLine::from_whole_runs(one.values.clone(), &runs, totals)
}

fn share(run: &RunSummary) -> Option<EdgeShare> {
    let seconds = (runs::end(run)? - run.started).seconds();
    EdgeShare::from_run(run.counts.ok + run.warm_up, seconds, run.total.map(|total| total.p50))
}

fn plot(curves: &[Vec<(&UsersLine, &Configuration)>]) -> Picture {
    // Users of one cloud wait for each other in its queue, so the time in the queue is drawn as well.
    let series = ["total", "queue"].map(|name| {
        let point = |(line, one): &(&UsersLine, &Configuration)| {
            let figures = one.figures(name)?;
            Some(ScatterPoint {
                x: line.edges as f64,
                y: figures.mean * 1e3,
                ends: figures.std.map(|std| ((figures.mean - std) * 1e3, (figures.mean + std) * 1e3)),
                name: if curves.len() > 1 { one.name.clone() } else { String::new() },
            })
        };
        let points: Vec<Vec<ScatterPoint>> =
            curves.iter().map(|curve| curve.iter().filter_map(point).collect()).collect();
        let lines =
            points.iter().flat_map(|curve| curve.windows(2)).filter_map(|pair| between(&pair[0], &pair[1]));
        ScatterSeries {
            stage: look::stage(name),
            name: name.to_owned(),
            lines: lines.collect(),
            points: points.concat(),
        }
    });
    let series: Vec<ScatterSeries> = series.into_iter().filter(|one| !one.points.is_empty()).collect();
    let points = || series.iter().flat_map(|one| &one.points);
    let up = Scale::up_to(points().map(ScatterPoint::top).fold(0.0, f64::max), 5);
    let x = Axis::new(whole_number_scale(points().map(|point| point.x)), "", "users at once");
    let sentences = curves.iter().flatten().filter_map(|(line, one)| {
        let total = one.total()?;
        Some(format!("{}: {} at {}", one.name, duration(total.mean), users_of(line)))
    });
    let label =
        format!("Mean latency against the number of users. {}", sentences.collect::<Vec<_>>().join(", "));
    Picture::of_scatter(&Scatter { x, y: Axis::new(up, "", "ms"), series }, &label)
}

/// Returns a scale of whole numbers that extends beyond the largest value.
fn whole_number_scale(values: impl Iterator<Item = f64> + Clone) -> Scale {
    let most = values.clone().fold(0.0, f64::max);
    let scale = Scale::of_sizes(values);
    if scale.is_logarithmic() { scale } else { Scale::up_to(most + 0.5, (most as usize + 1).min(6)) }
}

fn users_of(line: &UsersLine) -> String {
    crate::view::counted(line.edges, "user", "users")
}

/// Returns the line from one number of users to the next.
fn between(a: &ScatterPoint, b: &ScatterPoint) -> Option<ScatterLine> {
    let slope = (b.y - a.y) / (b.x - a.x);
    slope.is_finite().then_some(ScatterLine { intercept: a.y - slope * a.x, slope, from: a.x, to: b.x })
}

fn row(line: &UsersLine, one: &Configuration) -> UsersRow {
    let or_dash = |value: Option<f64>, form: fn(f64) -> String| value.map_or_else(|| NONE.to_owned(), form);
    UsersRow {
        name: one.name.clone(),
        users: count(line.edges as u64),
        rate: or_dash(line.rate, rate),
        each: line
            .rate_range()
            .map_or_else(|| NONE.to_owned(), |(least, most)| format!("{} – {}", rate(least), rate(most))),
        fairness: or_dash(line.fairness, |index| measured(index, 3)),
        total: one.total().map_or((NONE.to_owned(), None), |total| mean_std_ms(total.mean, total.std)),
    }
}
