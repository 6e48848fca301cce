//! Response length against latency: which quantity is the length, and whether it varies.

use super::Columns;
use super::columns::{account, heading, is_drawable, titled, too_large, unit};
use super::missing_data::MissingData;
use super::written::{Drawing, Shown};
use crate::figure::Lengths;
use crate::loaded::Loaded;
use crate::rows::RowRef;

/// How long answers take.
pub const LATENCY: &str = "inference";
/// How long answers are, where no tokens are counted.
const ANSWER: &str = "download-bytes";
/// With this end the names of those that a run counts itself.
const TOKENS: &str = "tokens";
/// Names with one of these words count what was asked.
const ASKED: [&str; 2] = ["prompt", "input"];
/// The longest answer is at least so much longer than the shortest, or its length is not what matters.
const VARIED: f64 = 1.5;

/// Length and latency of each answer.
pub(super) fn drawings(run: &Loaded, columns: &Columns) -> Result<Vec<Drawing>, MissingData> {
    let there = run.rows.names().iter().filter(|name| run.rows.counted(name).next().is_some());
    let x = columns.x.clone().unwrap_or_else(|| answer_length(there.map(|name| &**name)).to_owned());
    let y = columns.y.clone().unwrap_or_else(|| LATENCY.to_owned());
    let counted = run.rows.iter().filter(|row| row.counts());
    let point = |row: RowRef<'_>| Some((row.value(&x)?, row.value(&y)?));
    let points: Vec<(f64, f64)> =
        counted.filter_map(point).filter(|(x, y)| is_drawable(*x) && is_drawable(*y)).collect();
    if points.is_empty() {
        return Err(MissingData::Columns { x, y });
    }
    let (shortest, longest) = points
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), (length, _)| (lo.min(*length), hi.max(*length)));
    if longest <= shortest {
        return Err(MissingData::SameLength { x, length: shortest });
    }
    if columns.x.is_none() && !varies(shortest, longest) {
        return Err(MissingData::SimilarLength { x });
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

/// Which of these names is the length of an answer: of those that count tokens the first by name, those of the answer
/// before those of the question; `download-bytes` where nobody counted.
pub fn answer_length<'a>(names: impl Iterator<Item = &'a str>) -> &'a str {
    let is_asked = |name: &str| ASKED.iter().any(|word| name.contains(word));
    names.filter(|name| is_tokens(name)).min_by_key(|name| (is_asked(name), *name)).unwrap_or(ANSWER)
}

/// Whether a length is counted in tokens, else in bytes.
pub fn is_tokens(name: &str) -> bool {
    name.ends_with(TOKENS)
}

/// Whether answers differ enough in length to be drawn against it.
pub fn varies(shortest: f64, longest: f64) -> bool {
    longest > shortest && longest >= VARIED * shortest
}
