//! Table of the runs.

use peernet_analysis::duration_estimates::DurationEstimates;
use peernet_analysis::table::Table;
use peernet_statistics::number::{count, counted};

use super::plan::Run;
use super::state::Record;
use crate::experiment::RunStatus;
use crate::foreground::{estimated_duration, long_duration};
use crate::short::shorten_label;

/// Text of cells without a known value.
const UNKNOWN: &str = "unknown";

/// Returns the table of all runs in their order: configuration, state and duration.
pub(super) fn runs(record: &Record, estimates: &DurationEstimates) -> String {
    let plan = &record.plan;
    let axes = plan.configurations.first().map(|configuration| &configuration.labels);
    let mut header = vec!["run".to_owned()];
    header.extend(axes.into_iter().flatten().map(|(axis, _)| shorten_label(axis)));
    // If an axis shows the number of users, the table has no column `users`.
    let axis_shows_users = (0..header.len() - 1).any(|axis_index| {
        plan.configurations.iter().all(|configuration| {
            configuration
                .labels
                .get(axis_index)
                .is_some_and(|(_, label)| *label == configuration.users.to_string())
        })
    });
    let has_repeats = plan.repeats > 1;
    header.extend(has_repeats.then(|| "repeat".to_owned()));
    let has_users_column =
        !axis_shows_users && plan.configurations.iter().any(|configuration| configuration.users > 1);
    header.extend(has_users_column.then(|| "users".to_owned()));
    header.push("state".to_owned());
    let label_columns = header.len();
    header.push("time".to_owned());
    let rows = record.runs().map(|(run, state)| {
        let configuration = plan.configuration(run);
        let mut cells = vec![run.number.to_string()];
        cells.extend(configuration.labels.iter().map(|(_, label)| shorten_label(label)));
        cells.extend(has_repeats.then(|| (run.repeat + 1).to_string()));
        cells.extend(has_users_column.then(|| configuration.users.to_string()));
        cells.push(state.status.name().to_owned());
        // A run that is not finished has its estimated duration.
        let measured_s = state.seconds.filter(|_| state.status == RunStatus::Finished);
        let time_s = measured_s.or_else(|| estimates.duration_s(run.configuration));
        cells.push(time_s.map_or_else(|| UNKNOWN.to_owned(), long_duration));
        cells
    });
    Table { header, label_columns, rows: rows.collect(), marked: None }.text()
}

/// Describes the number of runs to do and their duration.
pub(super) fn describe_plan(to_do: &[Run], record: &Record, estimates: &DurationEstimates) -> String {
    let known_durations: Vec<f64> =
        to_do.iter().filter_map(|run| estimates.duration_s(run.configuration)).collect();
    let sum = estimated_duration(known_durations.iter().sum());
    let time = match to_do.len() - known_durations.len() {
        0 => format!("about {sum}"),
        1 if to_do.len() == 1 => "how long it takes is not known".to_owned(),
        unknown if unknown == to_do.len() => "how long they take is not known".to_owned(),
        1 => format!("about {sum} and one of unknown length"),
        unknown => format!("about {sum} and {unknown} of unknown length"),
    };
    let all = counted(record.plan.runs.len() as u64, "run");
    match to_do.len() {
        0 => "nothing to do: all runs are finished".to_owned(),
        some if some == record.plan.runs.len() => format!("{all}, {time}"),
        some => format!("{} of {all} to do, {time}", count(some as u64)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::tests::record;

    #[test]
    fn unknown_durations_are_readable() {
        let folder = tempfile::tempdir().expect("a folder");
        let record = record(folder.path());
        let describe_all = |expected: [Option<f64>; 4]| {
            describe_plan(&record.plan.runs, &record, &DurationEstimates::new(expected.to_vec()))
        };
        assert_eq!(describe_all([Some(3.0), Some(0.2), Some(5.0), Some(1.0)]), "4 runs, about 10 s");
        assert_eq!(describe_all([None; 4]), "4 runs, how long they take is not known");
        assert_eq!(
            describe_all([Some(3.0), None, Some(5.0), Some(1.0)]),
            "4 runs, about 10 s and one of unknown length"
        );
        let nothing = DurationEstimates::new(vec![None; 4]);
        let one = describe_plan(&record.plan.runs[..1], &record, &nothing);
        assert_eq!(one, "1 of 4 runs to do, how long it takes is not known");
        let message = runs(&record, &DurationEstimates::new(vec![Some(0.23), None, Some(5.0), None]));
        let times: Vec<_> = message.lines().skip(1).filter_map(|line| line.split("to do").nth(1)).collect();
        assert_eq!(
            times.iter().map(|time| time.trim()).collect::<Vec<_>>(),
            ["0.2 s", "unknown", "5.0 s", "unknown"]
        );
    }
}
