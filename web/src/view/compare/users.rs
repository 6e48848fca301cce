//! Latency against the number of users that measure at the same time, and the fairness between these users.

use peernet_analysis::users::{Curve, EdgeShare, Totals, Users, UsersLine};
use peernet_figures::drawing::{MOST_CURVES, Sharing, SharingCurve, Unit};
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
    let users = Users {
        axes: comparison.axes.clone(),
        lines: comparison.configurations.iter().map(|one| self::line(comparison, one)).collect(),
    };
    let curves = Curve::from_users(&users);
    let users_of_line = |line: Option<&&UsersLine>| line.map(|line| line.edges);
    let differ =
        |curve: &Curve<'_>| users_of_line(curve.points.first()) != users_of_line(curve.points.last());
    curves.iter().any(differ).then_some(())?;
    // Within an experiment the values identify a configuration.
    let configuration_of =
        |line: &UsersLine| comparison.configurations.iter().find(|one| one.values == line.labels);
    let points: Vec<Vec<(&UsersLine, &Configuration)>> = curves
        .iter()
        .map(|curve| curve.points.iter().filter_map(|line| Some((*line, configuration_of(line)?))).collect())
        .collect();
    let rows = points.iter().flatten().map(|(line, one)| row(comparison, line, one));
    Some((plot(&curves, &points), rows.collect()))
}

/// Returns the answers per second of each user of a configuration, and its totals.
fn line(comparison: &Comparison, one: &Configuration) -> UsersLine {
    let repeat = |run: &RunSummary| run.experiment.as_ref().map_or(0, |place| place.repeat);
    let runs: Vec<(u32, Option<EdgeShare>)> = one.runs.iter().map(|run| (repeat(run), share(run))).collect();
    let totals = comparison.total(one).map_or_else(Totals::default, |total| Totals {
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

/// Draws latency and fairness against the number of users, at most [`MOST_CURVES`] curves in a picture.
fn plot(curves: &[Curve<'_>], points: &[Vec<(&UsersLine, &Configuration)>]) -> Picture {
    let sentences = points.iter().flatten().filter_map(|(line, one)| {
        let median = line.totals.median?;
        Some(format!("{}: {} at {}", one.name, duration(median), users_of(line)))
    });
    let label =
        format!("Median latency against the number of users. {}", sentences.collect::<Vec<_>>().join(", "));
    let pictures = curves.chunks(MOST_CURVES).map(|curves| {
        let sharing = Sharing {
            title: String::new(),
            unit: Unit::milliseconds("Total"),
            curves: curves.iter().map(SharingCurve::new).collect(),
            notes: Vec::new(),
        };
        let figure = sharing.figure();
        let legend = Picture::of_legend(&figure.legend, "key plain points");
        // The first plot has the label of both.
        let plots = figure.plots.iter().zip([("histogram", label.as_str()), ("histogram low", "")]);
        plots.fold(legend, |picture, (plot, (class, label))| {
            picture.followed_by(&Picture::of_plot(plot, class, label))
        })
    });
    pictures.fold(Picture::default(), |all, one| all.followed_by(&one))
}

fn users_of(line: &UsersLine) -> String {
    crate::view::counted(line.edges, "user", "users")
}

fn row(comparison: &Comparison, line: &UsersLine, one: &Configuration) -> UsersRow {
    let or_dash = |value: Option<f64>, form: fn(f64) -> String| value.map_or_else(|| NONE.to_owned(), form);
    UsersRow {
        name: one.name.clone(),
        users: count(line.edges as u64),
        rate: or_dash(line.rate, rate),
        each: line
            .rate_range()
            .map_or_else(|| NONE.to_owned(), |(least, most)| format!("{} – {}", rate(least), rate(most))),
        fairness: or_dash(line.fairness, |index| measured(index, 3)),
        total: comparison
            .total(one)
            .map_or((NONE.to_owned(), None), |total| mean_std_ms(total.mean, total.std)),
    }
}
