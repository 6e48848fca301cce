//! The command `peernetd doctor`.

mod print;
mod repair;
mod spool;

use std::path::PathBuf;

use clap::ArgGroup;
use peernet_cli::clock;
use peernet_cli::exit::{Exit, Failure, error_line};
use peernet_cli::output::{print_to_stderr, print_to_stdout};
use peernet_clock::{ClockIdentity, WallTime};
use peernet_store::maintenance::{Examination, Finding, Report, Severity, examine};
use serde::Serialize;

use self::spool::SpoolReport;
use super::database_argument::configuration_failure;
use crate::configuration::{DataFiles, data_files};
use crate::log;

/// Arguments of `peernetd doctor`.
#[derive(Debug, clap::Args)]
#[group(skip)]
#[command(group = ArgGroup::new("files").required(true).multiple(true).args(["config", "database", "spool"]))]
pub(crate) struct Arguments {
    /// The configuration file whose database ([aggregator]) and spool ([agent] aggregator) are examined.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["database", "spool"])]
    config: Option<PathBuf>,
    /// An aggregator's database.
    #[arg(long, value_name = "FILE")]
    database: Option<PathBuf>,
    /// An agent's spool.
    #[arg(long, value_name = "FILE")]
    spool: Option<PathBuf>,
    /// Also compare indexes with their tables and check references, which takes several times as long.
    #[arg(long)]
    full: bool,
    /// Repair a damaged database while the aggregator is stopped: all readable rows are copied to a new file, which
    /// replaces the damaged one; the damaged file is renamed.
    #[arg(long, conflicts_with_all = ["spool", "full", "json"])]
    repair: bool,
    /// Print one JSON object; fields named _ns are nanoseconds since 1970 UTC.
    #[arg(long)]
    json: bool,
}

/// Results of the examination of a database, a spool or both.
#[derive(Debug, Default, Serialize)]
struct ExaminationResult {
    healthy: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    database: Option<Report>,
    #[serde(skip_serializing_if = "Option::is_none")]
    spool: Option<SpoolReport>,
    /// Error texts about the files that could not be examined.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    unavailable: Vec<String>,
}

/// Examines a database, a spool or both, or repairs a database. The worst finding determines the exit code.
pub(crate) fn doctor(arguments: Arguments) -> Exit {
    let _log = log::install_temporary();
    let (full, json, repair) = (arguments.full, arguments.json, arguments.repair);
    let exit = arguments.data_files().and_then(|data_files| {
        let unavailable = |error: std::io::Error| Failure::new(Exit::Unavailable, error);
        let now = clock::system(ClockIdentity::SYSTEM).map_err(unavailable)?.wall();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(unavailable)?;
        if repair {
            let database = data_files.database.ok_or_else(no_database)?;
            return runtime.block_on(repair::repair_database(&database, now));
        }
        let result =
            runtime.block_on(ExaminationResult::examine_files(data_files, Examination { full, now }));
        print_result(&result, now, json)?;
        Ok(result.exit_code())
    });
    exit.unwrap_or_else(|failure| {
        print_to_stderr(&failure);
        failure.exit
    })
}

impl Arguments {
    fn data_files(self) -> Result<DataFiles, Failure> {
        let Some(config) = self.config else {
            return Ok(DataFiles { database: self.database, spool: self.spool });
        };
        let data_files = data_files(&config).map_err(|problems| configuration_failure(&problems))?;
        if data_files.database.is_none() && data_files.spool.is_none() {
            let error = anyhow::anyhow!(
                "{} names neither a database nor a spool: it has no table [aggregator], and no [agent] aggregator",
                config.display()
            );
            return Err(Failure::new(Exit::Configuration, error));
        }
        Ok(data_files)
    }
}

/// Returns the failure of a repair whose configuration names no database.
fn no_database() -> Failure {
    let error =
        anyhow::anyhow!("the configuration names no database to repair: it has no table [aggregator]");
    Failure::new(Exit::Configuration, error)
}

fn print_result(result: &ExaminationResult, now: WallTime, json: bool) -> Result<(), Failure> {
    if json {
        let text = serde_json::to_string_pretty(result);
        print_to_stdout(text.map_err(|error| Failure::new(Exit::Software, error))?);
    } else {
        print::print(result, now);
    }
    result.unavailable.iter().for_each(print_to_stderr);
    Ok(())
}

impl ExaminationResult {
    async fn examine_files(data_files: DataFiles, examination: Examination) -> Self {
        let mut result = Self::default();
        if let Some(path) = &data_files.database {
            match examine(path, examination).await {
                Ok(report) => result.database = Some(report),
                Err(error) => result.unavailable.push(error.to_string()),
            }
        }
        if let Some(path) = &data_files.spool {
            match spool::examine(path).await {
                Ok(report) => result.spool = Some(report),
                Err(error) => result.unavailable.push(error_line(&error)),
            }
        }
        result.healthy = result.exit_code() == Exit::Ok;
        result
    }

    fn findings(&self) -> impl Iterator<Item = &Finding> {
        let database = self.database.iter().flat_map(|report| &report.findings);
        database.chain(self.spool.iter().flat_map(|report| &report.findings))
    }

    fn exit_code(&self) -> Exit {
        if self.findings().any(|finding| finding.severity == Severity::Problem) {
            Exit::Data
        } else if !self.unavailable.is_empty() {
            Exit::Unavailable
        } else {
            Exit::Ok
        }
    }
}
