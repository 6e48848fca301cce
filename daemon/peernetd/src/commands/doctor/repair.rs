//! The option `peernetd doctor --repair`.

use std::io::IsTerminal;
use std::path::Path;

use chrono::{DateTime, Utc};
use peernet_analysis::table::text;
use peernet_cli::exit::{Exit, Failure};
use peernet_cli::output::print_to_stdout;
use peernet_clock::WallTime;
use peernet_statistics::number::fixed;
use peernet_store::maintenance::{RepairError, RepairResult, repair};

/// Repairs a database and prints the result for each table.
pub(super) async fn repair_database(database: &Path, now: WallTime) -> Result<Exit, Failure> {
    let timestamp =
        DateTime::<Utc>::from_timestamp_nanos(now.unix_nanos()).format("%Y%m%dT%H%M%SZ").to_string();
    // A log file needs no progress lines.
    let log_progress = |item: &str| {
        if std::io::stderr().is_terminal() {
            tracing::info!("salvaging {item}");
        }
    };
    let result = repair(database, now, &timestamp, log_progress).await;
    match result.map_err(|error| Failure::new(exit_code(&error), error))? {
        Some(repaired) => print(database, &repaired),
        None => print_to_stdout(format_args!(
            "database {}: not damaged, so it was not repaired",
            database.display()
        )),
    }
    Ok(Exit::Ok)
}

fn print(database: &Path, repaired: &RepairResult) {
    print_to_stdout(format_args!(
        "repaired {}\n  the damaged file was renamed to {}\n",
        database.display(),
        repaired.damaged.display()
    ));
    let iterations = fixed(repaired.lost_iterations as f64, 0);
    let rows: Vec<Vec<String>> = repaired
        .tables
        .iter()
        .filter(|table| table.rows > 0 || table.unreadable_ranges > 0)
        .map(|table| {
            // The counters of runs and the numbers of iterations show how many iterations are lost. Nothing shows this
            // for the other tables.
            let lost = match (table.table.as_str(), table.unreadable_ranges) {
                ("iteration", _) => iterations.clone(),
                (_, 0) => "0".to_owned(),
                (_, 1) => "unknown number, in 1 damaged place".to_owned(),
                (_, places) => format!("unknown number, in {places} damaged places"),
            };
            vec![table.table.clone(), fixed(table.rows as f64, 0), lost]
        })
        .collect();
    print_to_stdout(text(&["table", "rows salvaged", "rows lost"], &rows));
    if repaired.lost_iterations > 0 {
        print_to_stdout(format_args!(
            "\n{iterations} iterations are lost; a gap in each affected run reports them"
        ));
    }
    if repaired.without_log {
        print_to_stdout(
            "\nthe write-ahead log (-wal) could not be read: the latest transactions are missing",
        );
    }
}

fn exit_code(error: &RepairError) -> Exit {
    match error {
        RepairError::Unreadable { .. } | RepairError::NewerSchema { .. } | RepairError::Failing { .. } => {
            Exit::Data
        }
        RepairError::Missing(_)
        | RepairError::Lock(_)
        | RepairError::InUse(_)
        | RepairError::ForeignLog(_)
        | RepairError::NoRoom { .. }
        | RepairError::File { .. }
        | RepairError::Check { .. }
        | RepairError::Write { .. } => Exit::Unavailable,
    }
}
