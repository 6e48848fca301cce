//! Latency against the number of edges at once.

use super::columns::{is_drawable, left_out};
use super::written::{Drawing, Shown};
use crate::figure::{MOST_CURVES, Sharing, SharingCurve, SharingPoint, Unit};
use crate::results::Loaded;
use crate::users::{Curve, Users, UsersLine};

/// Whether some configuration was measured with different numbers of edges.
pub(super) fn have_curves(runs: &[Loaded]) -> bool {
    Users::of(runs).is_some_and(|users| users.curves().iter().any(|curve| curve.points.len() > 1))
}

/// One curve for each configuration; four to a picture.
pub(super) fn drawings(runs: &[Loaded]) -> Result<Vec<Drawing>, String> {
    let users = Users::of(runs)
        .ok_or("it needs runs of an experiment with several edges at once: set experiment.users")?;
    let (told, without): (Vec<&UsersLine>, Vec<&UsersLine>) =
        users.lines.iter().partition(|line| line.totals.median.is_some_and(is_drawable));
    if told.is_empty() {
        return Err(
            "no total that can be drawn was measured while all edges of a run were measuring".to_owned()
        );
    }
    let mut notes = vec!["counted while all edges of a run were measuring".to_owned()];
    notes.extend(left_out(&runs.iter().flat_map(|run| &run.rows)));
    if !without.is_empty() {
        notes.push(format!("left out: {} without such a time", without.len()));
    }
    let curves = users.curves();
    let pictures = curves.chunks(MOST_CURVES).enumerate().map(|(number, curves)| {
        let suffix = if number == 0 { String::new() } else { format!("-{}", number + 1) };
        let sharing = Sharing {
            title: "Latency against edges at once".to_owned(),
            unit: Unit::milliseconds("Total"),
            curves: curves.iter().map(curve).collect(),
            notes: notes.clone(),
        };
        Drawing::new(format!("users{suffix}"), Shown::Sharing(sharing))
    });
    Ok(pictures.collect())
}

fn curve(curve: &Curve<'_>) -> SharingCurve {
    let point = |line: &&UsersLine| {
        Some(SharingPoint {
            edges: line.edges,
            median: line.totals.median.filter(|median| is_drawable(*median))?,
            p95: line.totals.p95.filter(|p95| is_drawable(*p95)),
            each: line
                .shares
                .iter()
                .filter_map(|share| share.median)
                .filter(|median| is_drawable(*median))
                .collect(),
            fairness: line.fairness,
        })
    };
    SharingCurve { name: curve.name.clone(), points: curve.points.iter().filter_map(point).collect() }
}
