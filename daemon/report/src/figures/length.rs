//! Response length against latency.

use super::Columns;
use super::columns::{account, heading, is_drawable, titled, too_large, unit};
use super::written::{Drawing, Shown};
use crate::figure::Lengths;
use crate::results::{Loaded, RowRef, Rows};

/// Columns that hold the length of an answer, the best first. Those of a run's own end with `tokens`.
const ANSWER: &str = "download-bytes";
const TOKENS: &str = "tokens";
/// The longest answer is at least so much longer than the shortest, or its length is not what matters.
const VARIED: f64 = 1.5;

/// Length and latency of each answer.
pub(super) fn drawings(run: &Loaded, columns: &Columns) -> Result<Vec<Drawing>, String> {
    let x = columns.x.clone().unwrap_or_else(|| length(&run.rows));
    let y = columns.y.clone().unwrap_or_else(|| "inference".to_owned());
    let counted = run.rows.iter().filter(|row| row.counts());
    let point = |row: RowRef<'_>| Some((row.value(&x)?, row.value(&y)?));
    let points: Vec<(f64, f64)> =
        counted.filter_map(point).filter(|(x, y)| is_drawable(*x) && is_drawable(*y)).collect();
    if points.is_empty() {
        return Err(format!(
            "no iteration that counts has a number that can be drawn in both columns, {x} and {y}"
        ));
    }
    let (shortest, longest) = points
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), (length, _)| (lo.min(*length), hi.max(*length)));
    if longest <= shortest {
        return Err(format!(
            "all answers have the same length: {x} is {shortest} in every iteration; name another column with --x"
        ));
    }
    if columns.x.is_none() && longest < VARIED * shortest {
        return Err(format!("all answers have much the same length ({x}); name another column with --x"));
    }
    let lengths = Lengths {
        title: titled(&format!("{} against {}", heading(&y), x.replace(['-', '_'], " ")), &run.record.title),
        x: unit(&run.record.units, &x, &heading(&x)),
        y: unit(&run.record.units, &y, &heading(&y)),
        notes: std::iter::once(account(&run.rows.iter(), points.len()))
            .chain(too_large(run.rows.iter(), &[x.as_str(), y.as_str()]))
            .collect(),
        points,
    };
    Ok(vec![Drawing::new("length", Shown::Lengths(lengths))])
}

fn length(rows: &Rows) -> String {
    let is_there = |name: &str| rows.counted(name).next().is_some();
    let tokens = rows.names().iter().find(|name| name.ends_with(TOKENS) && is_there(name));
    tokens.map_or(ANSWER, |name| name.as_ref()).to_owned()
}
