//! Figures of latency against the number of edges that use the cloud at the same time.

use peernet_statistics::number::counted;

use super::columns::{excluded_note, is_drawable};
use super::missing_data::MissingData;
use super::replayed::marked;
use super::written_figures::{AnyFigure, Drawing};
use crate::drawing::{MAX_CURVES, Sharing, SharingCurve, Unit};
use peernet_analysis::loaded::Loaded;
use peernet_analysis::users::{COUNTED_TIME, Curve, Users, UsersLine};

/// Maximum number of missing points that a note names. If more points are missing, the note gives their number.
const MAX_NAMED: usize = 3;

/// Returns whether some configuration was measured with different numbers of edges.
pub(super) fn have_curves(runs: &[Loaded]) -> bool {
    Users::from_runs(runs).is_some_and(|users| Curve::from_users(&users).iter().any(Curve::is_over_edges))
}

/// Returns figures with one curve for each configuration, at most [`MAX_CURVES`] in a figure.
pub(super) fn drawings(runs: &[Loaded]) -> Result<Vec<Drawing>, MissingData> {
    let users = Users::from_runs(runs).ok_or(MissingData::Users)?;
    if !users.lines.iter().any(has_total) {
        return Err(MissingData::CommonTotal);
    }
    // A reader must know that a total counts only if all edges of the repeat were measuring at the time of the total.
    let mut notes = vec![COUNTED_TIME.to_owned()];
    notes.extend(excluded_note(&runs.iter().flat_map(|run| &run.rows)));
    let curves = Curve::from_users(&users);
    let drawings = curves.chunks(MAX_CURVES).enumerate().map(|(index, curves)| {
        let suffix = if index == 0 { String::new() } else { format!("-{}", index + 1) };
        let left_out: Vec<String> = missing_points_note(curves).into_iter().collect();
        let sharing = Sharing {
            title: "Latency against the number of edges".to_owned(),
            unit: Unit::milliseconds("Total"),
            curves: curves.iter().map(curve).collect(),
            notes: notes.iter().chain(&left_out).cloned().collect(),
        };
        Drawing::new(format!("users{suffix}"), AnyFigure::Sharing(sharing)).with_left_out(left_out)
    });
    Ok(drawings.collect())
}

/// Returns the curve of a configuration. Its name is marked if latencies of its points are replayed.
fn curve(curve: &Curve<'_>) -> SharingCurve {
    let is_replayed = curve.points.iter().any(|line| line.replayed.is_some());
    // A single curve has no name in the legend, so the mark cannot follow a name.
    let is_named = !curve.name.is_empty();
    SharingCurve { name: marked(&curve.name, is_replayed && is_named), ..SharingCurve::new(curve) }
}

/// Returns a note on the points that these curves lack; `None` if no point is missing. The note names at most
/// [`MAX_NAMED`] points.
fn missing_points_note(curves: &[Curve<'_>]) -> Option<String> {
    let missing_points = |curve: &Curve<'_>| -> Vec<String> {
        let lines = curve.points.iter().filter(|line| !has_total(line));
        let edges = lines.map(|line| counted(line.edges as u64, "edge"));
        edges
            .map(|edges| if curve.name.is_empty() { edges } else { format!("{} with {edges}", curve.name) })
            .collect()
    };
    let names: Vec<String> = curves.iter().flat_map(missing_points).collect();
    let names_or_count =
        if names.len() <= MAX_NAMED { names.join("; ") } else { counted(names.len() as u64, "point") };
    (!names.is_empty())
        .then(|| format!("left out, because the edges measured at different times: {names_or_count}"))
}

/// Returns whether a line has a total that can be drawn.
fn has_total(line: &UsersLine) -> bool {
    line.totals.median.is_some_and(is_drawable)
}
