//! Rates, latency and fairness of users (edges that use the cloud at the same time).

use futures::{StreamExt, TryStreamExt};
use peernet_analysis::concurrent_edges::complete_groups;
use peernet_analysis::users::{
    COUNTED_TIME, Curve, EdgeMeasurements, FAIRNESS_MEANING, Repeat, Users, UsersLine, common_time,
};
use peernet_clock::WallTime;
use peernet_figures::drawing::{MAX_CURVES, Sharing, SharingCurve, Unit};
use peernet_logger::stage;
use peernet_statistics::Summary;
use peernet_statistics::number::{self, duration, long_duration};
use peernet_store::{MeasuredTime, RunSummary, Store};

use super::differences::CONCURRENT_READS;
use super::{Comparison, Configuration};
use crate::error::WebError;
use crate::picture::Picture;

/// Row of a configuration, for its number of users.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct UsersRow {
    pub name: String,
    pub users: String,
    /// Answers per second of all users together.
    pub rate: String,
    /// Answers per second of the user that got the fewest answers, and of the user that got the most.
    pub each: String,
    /// Jain's index.
    pub fairness: String,
    /// Mean of the totals, ms.
    pub total: String,
}

/// Measurements of the users of each configuration, from the time in which all users of a repeat measured.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct MeasuredUsers {
    /// Repeats of each configuration, without repeats that lack a user. Empty if no configuration has several users.
    pub repeats: Vec<Vec<Repeat<Summary>>>,
    /// Width of the buckets in which starts are counted, seconds; 0 if single iterations are counted.
    pub resolution_s: u32,
}

/// Results of the users of each configuration.
pub(crate) struct UsersTable {
    /// Latency and fairness against the number of users; `None` without different numbers of users.
    pub plot: Option<Picture>,
    pub rows: Vec<UsersRow>,
    /// Sentence about the iterations that are counted.
    pub method: String,
}

/// Reads the measurements of the users of each configuration, from the time in which all users of a repeat measured.
/// Reads nothing unless an experiment with several users is compared.
///
/// # Errors
/// Returns an error when the store cannot be read.
pub(crate) async fn measured_users(
    store: &Store,
    comparison: &Comparison,
) -> Result<MeasuredUsers, WebError> {
    let configurations: Vec<Vec<Vec<&RunSummary>>> =
        comparison.configurations.iter().map(complete_repeats).collect();
    let has_several_users = configurations.iter().flatten().any(|users| users.len() > 1);
    if comparison.experiment.is_none() || !has_several_users {
        return Ok(MeasuredUsers::default());
    }
    let read = |users: Vec<&RunSummary>| {
        let users: Vec<RunSummary> = users.into_iter().cloned().collect();
        async move { measured_repeat(store, &users).await }
    };
    let reads: Vec<_> = configurations.iter().flatten().cloned().map(read).collect();
    let measured: Vec<(Repeat<Summary>, u32)> =
        futures::stream::iter(reads).buffered(CONCURRENT_READS).try_collect().await?;
    let resolution_s = measured.iter().map(|(_, resolution_s)| *resolution_s).max().unwrap_or_default();
    let mut measured = measured.into_iter().map(|(repeat, _)| repeat);
    let repeats = configurations.iter().map(|repeats| measured.by_ref().take(repeats.len()).collect());
    Ok(MeasuredUsers { repeats: repeats.collect(), resolution_s })
}

/// Returns the runs of each repeat of a configuration. Repeats that lack a user are left out.
fn complete_repeats(configuration: &Configuration) -> Vec<Vec<&RunSummary>> {
    complete_groups(configuration.concurrent_runs(), |run| run.experiment.as_ref())
}

/// Reads the measurements of the users of a repeat, from the time in which all of them measured. Also returns the
/// resolution of this time, seconds.
async fn measured_repeat(store: &Store, users: &[RunSummary]) -> Result<(Repeat<Summary>, u32), WebError> {
    let mut times = Vec::with_capacity(users.len());
    for run in users {
        times.push(store.measured_time(run).await?);
    }
    let resolution_s = times.iter().flatten().map(|time| time.resolution_s).max().unwrap_or_default();
    let width_ns = i64::from(resolution_s) * 1_000_000_000;
    // If starts are counted in buckets, only buckets that lie completely within the time are counted: the beginning is
    // rounded up to a whole bucket, and the end is rounded down.
    let rounded = |time: MeasuredTime| {
        let (first, last) = (time.first.unix_nanos(), time.last.unix_nanos());
        if width_ns == 0 {
            return (first, last);
        }
        (-(-first).div_euclid(width_ns) * width_ns, last.div_euclid(width_ns) * width_ns)
    };
    let Some((from, to)) = common_time(times.into_iter().map(|time| time.map(rounded))) else {
        return Ok((Repeat { common_seconds: None, edges: Vec::new() }, resolution_s));
    };
    let (from, to) = (WallTime::from_unix_nanos(from), WallTime::from_unix_nanos(to));
    let mut edges = Vec::with_capacity(users.len());
    for run in users {
        let within = store.measured_within(run.number, from, to).await?;
        edges.push(EdgeMeasurements { starts: within.count, totals: within.totals });
    }
    Ok((Repeat { common_seconds: Some((to - from).seconds()), edges }, resolution_s))
}

/// Returns the results of the users. `None` unless an experiment with several users is compared.
pub(crate) fn users(comparison: &Comparison, measured: &MeasuredUsers) -> Option<UsersTable> {
    comparison.experiment.as_ref()?;
    let lines = comparison.configurations.iter().zip(&measured.repeats);
    let lines = lines.map(|(one, repeats)| users_line(one, repeats));
    let users = Users { axes: comparison.axes.clone(), lines: lines.collect() };
    users.lines.iter().any(|line| line.edges > 1).then_some(())?;
    let curves = Curve::from_users(&users);
    // The configurations of an experiment differ in their values, so the values identify a configuration.
    let configuration_of =
        |line: &UsersLine| comparison.configurations.iter().find(|one| one.values == line.labels);
    let points: Vec<Vec<(&UsersLine, &Configuration)>> = curves
        .iter()
        .map(|curve| curve.points.iter().filter_map(|line| Some((*line, configuration_of(line)?))).collect())
        .collect();
    let rows = points.iter().flatten().map(|(line, one)| row(line, one)).collect();
    let method = match measured.resolution_s {
        0 => COUNTED_TIME.to_owned(),
        width_s => format!(
            "Only complete intervals of {} during which all edges of a repeat were measuring are counted: finer statistics were deleted.",
            long_duration(f64::from(width_s))
        ),
    };
    let plot = curves.iter().any(Curve::is_over_edges).then(|| plot(&curves, &points));
    Some(UsersTable { plot, rows, method: format!("{method} {FAIRNESS_MEANING}") })
}

/// Returns the answers per second of each user of a configuration, and the totals of all its users.
fn users_line(configuration: &Configuration, repeats: &[Repeat<Summary>]) -> UsersLine {
    let edges = complete_repeats(configuration).first().map_or(0, Vec::len);
    // The line of a single user has these totals. They are measured totals, as for several users, even if the other
    // tables of the page compare sums of stages.
    let all_totals = || configuration.summary(&stage::TOTAL).cloned().unwrap_or_default();
    UsersLine::new(configuration.values.clone(), edges, repeats, all_totals)
}

/// Draws latency and fairness against the number of users, at most [`MAX_CURVES`] curves in a picture.
fn plot(curves: &[Curve<'_>], points: &[Vec<(&UsersLine, &Configuration)>]) -> Picture {
    let sentences = points.iter().flatten().filter_map(|(line, one)| {
        let median = line.totals.median?;
        Some(format!("{}: {} at {}", one.name, duration(median), users_of(line)))
    });
    let label =
        format!("Median latency against the number of edges. {}", sentences.collect::<Vec<_>>().join(", "));
    let pictures = curves.chunks(MAX_CURVES).map(|curves| {
        let sharing = Sharing {
            title: String::new(),
            unit: Unit::milliseconds("Total"),
            curves: curves.iter().map(SharingCurve::new).collect(),
            notes: Vec::new(),
        };
        let figure = sharing.figure();
        let legend = Picture::of_legend(&figure.legend, "key plain points");
        // The first plot has the label of both.
        let plots = figure.plots.iter().zip([("plot-with-axes", label.as_str()), ("plot-with-axes low", "")]);
        plots.fold(legend, |picture, (plot, (class, label))| {
            picture.followed_by(&Picture::of_plot(plot, class, label))
        })
    });
    pictures.fold(Picture::default(), |all, one| all.followed_by(&one))
}

fn users_of(line: &UsersLine) -> String {
    number::counted(line.edges as u64, "edge")
}

fn row(line: &UsersLine, configuration: &Configuration) -> UsersRow {
    let [users, rate, each, fairness, total] = line.cell_texts();
    UsersRow { name: configuration.name.clone(), users, rate, each, fairness, total }
}

#[cfg(test)]
mod tests {
    use peernet_analysis::total_column::TotalColumn;
    use peernet_stream::{ExperimentPosition, PlacementKind};

    use peernet_statistics::number::milliseconds;

    use super::*;
    use crate::tests::samples;
    use crate::view::compare::tests::{comparison, configuration, measured_users, run};

    #[test]
    fn users_have_measured_totals_for_any_compared_latency() {
        let edge = |host_name: &str| RunSummary {
            host_name: samples::slug(host_name),
            experiment: Some(ExperimentPosition::default()),
            ..run(3, PlacementKind::Remote)
        };
        let one = |at: usize| Configuration {
            values: vec![at.to_string(), "cloud".to_owned()],
            runs: vec![edge("cam-1")],
            ..configuration(at, PlacementKind::Remote, 1.0, 1e3)
        };
        let mut several = one(2);
        several.runs.push(edge("cam-2"));
        let mut comparison = comparison(vec![one(1), several]);
        for column in [TotalColumn::Measured, TotalColumn::SumOfStages] {
            comparison.total_column = column;
            let measured = measured_users(&comparison);
            let users = users(&comparison, &measured).expect("two numbers of users");
            let total = comparison.configurations[0].summary(&stage::TOTAL).expect("totals");
            let mean = milliseconds(total.moments.mean);
            for row in &users.rows {
                assert_eq!(row.total, mean, "{} users, {column:?}", row.users);
            }
        }
    }
}
