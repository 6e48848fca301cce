//! What the stages of each configuration add up to.

use peernet_logger::stage;
use peernet_statistics::Moments;

use super::columns::{is_drawable, too_large};
use super::configured::{Configured, counted};
use super::written::{Drawing, Shown};
use crate::figure::{Bar, Stacked, UNATTRIBUTED, Unit};
use crate::number::fixed;
use crate::results::Loaded;

/// Most bars that one picture has.
const MOST: usize = 100;

/// One bar for each configuration; repeats are taken together.
pub(super) fn drawings(runs: &[Loaded]) -> Result<Vec<Drawing>, String> {
    let Configured { axes, groups: lines } = Configured::of(runs);
    let all = || lines.iter().flat_map(|(_, runs)| counted(runs));
    if all().next().is_none() {
        return Err("no iteration counts: all are warm-up or without an answer".to_owned());
    }
    // Where one configuration has no measured total, all are the sums of their stages.
    let total = if all().all(|row| row.value("total").is_some()) { "total" } else { "stages-total" };
    let beyond = (total == "total").then_some(UNATTRIBUTED);
    let order = stage::ORDER;
    let candidates = order.iter().map(peernet_logger::Name::as_str).chain(beyond);
    let stages: Vec<String> = candidates
        .filter(|stage| all().any(|row| row.value(stage).is_some_and(is_drawable)))
        .map(str::to_owned)
        .collect();
    let lines_of = lines.len();
    let bars = lines.iter().filter_map(|(label, runs)| bar(label, runs, &stages, total)).take(MOST).collect();
    let mut notes = vec![format!(
        "configurations: {} · parts: means · whisker and figures: mean ± standard deviation of the {}",
        axes.join(", "),
        if total == "total" { "measured total" } else { "sum of stages" }
    )];
    let columns: Vec<&str> =
        order.iter().map(peernet_logger::Name::as_str).chain(beyond).chain([total]).collect();
    notes.extend(too_large(all(), &columns));
    if lines_of > MOST {
        notes.push(format!("the first {MOST} of {} configurations", fixed(lines_of as f64, 0)));
    }
    let stacked = Stacked {
        title: "Latency by configuration".to_owned(),
        unit: Unit::milliseconds("Latency"),
        stages,
        bars,
        notes,
    };
    Ok(vec![Drawing::new("stacked", Shown::Stacked(stacked))])
}

/// `None` for a configuration without an iteration that counts.
fn bar(label: &str, runs: &[&Loaded], stages: &[String], total: &str) -> Option<Bar> {
    let mut sums = vec![0.0; stages.len()];
    let mut totals = Moments::default();
    let mut count = 0_u64;
    for row in counted(runs) {
        count += 1;
        for (sum, stage) in sums.iter_mut().zip(stages) {
            // A stage that did not take place took no time.
            *sum += row.value(stage).filter(|value| is_drawable(*value)).unwrap_or_default();
        }
        if let Some(value) = row.value(total).filter(|value| is_drawable(*value)) {
            totals.record(value);
        }
    }
    let means = sums.into_iter().map(|sum| sum / count as f64).collect();
    (count > 0).then(|| Bar { label: label.to_owned(), means, std: totals.std() })
}
