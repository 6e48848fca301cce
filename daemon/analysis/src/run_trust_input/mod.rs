//! Input of the trust report, from the record and the rows of a run.

mod start_times;

use peernet_stream::Condition;
use serde::Deserialize;

use crate::record::{Counts, RunRecord};
use crate::rows::Rows;
use crate::trust::{EndedEarly, Limits, Load, MissingEvents, Progress, StartTimes, Starts, TrustInput};

impl TrustInput {
    /// Collects the input from the rows of a run and from its record, which has the conditions of both hosts, the end
    /// of the run and the number of missing measurements.
    pub fn from_run(record: &RunRecord, rows: &Rows) -> Self {
        let hosts = [Some(&record.edge), record.cloud.as_ref()].into_iter().flatten();
        let conditions: Vec<Condition> = hosts.flat_map(|host| host.conditions.iter().cloned()).collect();
        let unseen = MissingEvents {
            count: record.counts.unseen,
            reason: "measured, but this program was too busy to receive them".to_owned(),
        };
        let from_rows = Self::from_rows(rows, &conditions);
        let times = StartTimes::from_run(record, rows);
        Self {
            starts: Starts {
                hz: load(record).hz,
                missing: Some(record.counts.unseen),
                times,
                ..from_rows.starts
            },
            missing: if unseen.count > 0 { vec![unseen] } else { Vec::new() },
            ended_early: ended_early(record, rows, &times),
            ..from_rows
        }
        .with_end_reason(Some(&record.reason))
        .with_facts(&record.facts)
    }
}

/// Returns the configured limits of a run; no limits if another version wrote the record with limits of another form.
fn limits(record: &RunRecord) -> Limits {
    record.pipeline.get("limit").and_then(|limit| Limits::deserialize(limit).ok()).unwrap_or_default()
}

/// Returns the configured load of a run; no rate if another version wrote the record with a load of another form.
fn load(record: &RunRecord) -> Load {
    record.pipeline.get("load").and_then(|load| Load::deserialize(load).ok()).unwrap_or_default()
}

/// Returns the progress of the run at its end, if it ended before its limits; else `None`. The iterations of the run
/// are its rows and the iterations without a row, whose number is in the record.
fn ended_early(record: &RunRecord, rows: &Rows, times: &StartTimes) -> Option<EndedEarly> {
    let counts = Counts::from_rows(rows, record.counts.unseen);
    let progress = Progress {
        // The number of unseen iterations is from a file and can be any number.
        measured: counts.measured().saturating_add(counts.unseen),
        warm_up: counts.warm_up,
        episodes: rows.iter().filter_map(|row| row.value("episode")).reduce(f64::max).map(|last| last as u64),
        seconds: times.seconds(),
    };
    EndedEarly::from_progress(&limits(record), &progress, &record.reason)
}

/// Describes the end of a run that was interrupted or broke off: `was interrupted after 57 of 120 iterations`. `None`
/// if the run is complete, if the run had nothing more to measure, or if its end is not known.
pub(crate) fn early_end(record: &RunRecord, rows: &Rows) -> Option<String> {
    let times = StartTimes::from_run(record, rows);
    EndedEarly::end_text(record.reason.failure(), ended_early(record, rows, &times).as_ref())
}

#[cfg(test)]
mod tests;
