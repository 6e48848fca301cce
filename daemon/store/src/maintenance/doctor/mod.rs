//! Examination of a database over a connection that changes nothing.

mod contents;
mod report;

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use peernet_clock::WallTime;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, SqliteConnection};

pub use self::report::{
    FileSizes, Finding, GapGroup, Integrity, OpenRun, QuarantineGroup, Report, RollupExtent, Schema,
    Severity, StreamState, TableRows,
};
use super::{FileKind, free_bytes, read_only_options};
use crate::column::count;
use crate::database::MIGRATIONS;
use crate::database_error::{DatabaseError, is_damage};
use crate::foreign_log::{ForeignLog, refuse_foreign_log_at};
use crate::integrity::{PageCheck, has_table_list, log_path, recorded_damage};

/// Minimum number of free bytes on the disk. If fewer bytes are free, the report has a problem.
const MIN_FREE_BYTES: u64 = 512 << 20;
/// Maximum size of the write-ahead log. If the log is larger, a program probably keeps SQLite from checkpointing the log
/// into the database, and the report has a notice.
const MAX_WAL_BYTES: u64 = 512 << 20;
/// Advice for a damaged file.
const REPAIR: &str = "stop the aggregator and run this again with --repair, which salvages all readable rows and keeps the \
                      damaged file; or restore the newest backup. Agents send the events in their spools again";
/// Advice for a damaged file in which no row can be found.
const RESTORE: &str = "stop the aggregator and replace the file by the newest backup: without the file's header and its list of tables \
                       no row can be found. Agents send the events in their spools again";

/// Reason why a database cannot be examined at all.
#[derive(Debug, thiserror::Error)]
pub enum DoctorError {
    /// The file does not exist.
    #[error("there is no database {}; give the file that the key `database` of [aggregator] names", .0.display())]
    Missing(PathBuf),
    /// The write-ahead log beside the database belongs to another database.
    #[error(transparent)]
    ForeignLog(#[from] ForeignLog),
    /// The file cannot be opened.
    #[error("cannot open the database {}: {source}; check that this user may read it and write in its folder", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// The error of SQLite or of the system.
        source: DatabaseError,
    },
}

/// Settings of an examination.
#[derive(Clone, Copy, Debug)]
pub struct Examination {
    /// `true` if indexes are also compared with their tables, and references between tables are checked. This takes
    /// several times as long.
    pub full: bool,
    /// Current time on this machine's wall clock.
    pub now: WallTime,
}

/// Examines a database. Reads the whole file. An aggregator may use the file at the same time.
///
/// # Errors
/// When there is no such file or it cannot be opened. Errors within the file are part of the report.
pub async fn examine(database: &Path, settings: Examination) -> Result<Report, DoctorError> {
    if !database.is_file() {
        return Err(DoctorError::Missing(database.to_owned()));
    }
    let cannot_open = |error: sqlx::Error| DoctorError::Open {
        path: database.to_owned(),
        source: DatabaseError::new(error),
    };
    let mut report = Report { database: database.to_owned(), ..Report::default() };
    // The file is read without SQLite before SQLite opens it: see `PageFile::open`. If the file cannot be opened,
    // `refuse_foreign_log_at` or SQLite reports the error.
    report.integrity.has_table_list =
        File::open(database).map_or(true, |file| has_table_list(Arc::new(file)));
    refuse_foreign_log_at(database)?;
    // The search for malformed pages, too, reads the file without SQLite and before SQLite opens it.
    report.find_malformed_pages(database);
    let opening = async {
        let mut connection = read_only_options(database).connect().await?;
        let kind = FileKind::detect(&mut connection).await?;
        Ok((connection, kind))
    };
    match opening.await {
        Ok((mut connection, FileKind::Database)) => {
            report.check_sizes(&mut connection, database).await;
            // SQLite's full check shows whether malformed pages are in use.
            report
                .check_integrity(&mut connection, settings.full || !report.malformed_pages.is_empty())
                .await;
            report.report_recorded_damage(database);
            if report.has_current_schema(&mut connection).await {
                contents::read(&mut report, &mut connection, settings.now).await;
            }
            // Everything was read, so an error while closing does not matter.
            let _ = connection.close().await;
        }
        Ok((mut connection, kind)) => {
            report.check_sizes(&mut connection, database).await;
            let what = kind.other_kind().unwrap_or_default();
            let advice = if kind == FileKind::Spool {
                "look at it with `peernetd doctor --spool FILE`"
            } else {
                "name the file of [aggregator] database"
            };
            report.problem(format!("it is {what} and not an aggregator's database"), advice);
            let _ = connection.close().await;
        }
        Err(error) if is_damage(&error) => {
            report.read_lengths(database);
            report.problem(format!("it is damaged, or not a database: {error}"), report.remedy());
        }
        Err(error) => return Err(cannot_open(error)),
    }
    Ok(report)
}

impl Report {
    /// Returns whether no problem was found.
    pub fn is_healthy(&self) -> bool {
        self.findings.iter().all(|finding| finding.severity != Severity::Problem)
    }

    /// Returns the advice for damage.
    const fn remedy(&self) -> &'static str {
        if self.integrity.has_table_list { REPAIR } else { RESTORE }
    }

    fn problem(&mut self, what: String, advice: &str) {
        self.findings.push(Finding { severity: Severity::Problem, what, advice: advice.to_owned() });
    }

    fn notice(&mut self, what: String, advice: &str) {
        self.findings.push(Finding { severity: Severity::Notice, what, advice: advice.to_owned() });
    }

    /// Returns the value that a query selected. If the query failed, adds a problem and returns the default value.
    fn value_or_problem<T: Default>(&mut self, what: &str, answer: Result<T, sqlx::Error>) -> T {
        answer.unwrap_or_else(|error| {
            if is_damage(&error) {
                self.problem(format!("it is damaged: cannot read {what}: {error}"), self.remedy());
            } else {
                self.problem(
                    format!("cannot read {what}: {error}"),
                    "run this again; if the error persists, restore a backup",
                );
            }
            T::default()
        })
    }

    /// Reads the sizes of the file and its log, and the free space of its disk. Adds findings for problematic sizes.
    async fn check_sizes(&mut self, connection: &mut SqliteConnection, database: &Path) {
        let answer = sqlx::query_scalar(
            "SELECT freelist_count * page_size FROM pragma_freelist_count, pragma_page_size",
        );
        let answer: Result<i64, _> = answer.fetch_one(connection).await;
        let free = self.value_or_problem("the file's size", answer);
        self.file.free_bytes = count(free);
        self.read_lengths(database);
        if self.file.disk_free_bytes < MIN_FREE_BYTES {
            let megabytes = self.file.disk_free_bytes >> 20;
            self.problem(
                format!("its disk has only {megabytes} MiB free"),
                "free some space: nothing is stored while the disk is full, and agents keep their events. Shorter \
                 periods in [aggregator.retention] keep the file small",
            );
        }
        if self.file.wal_bytes > MAX_WAL_BYTES {
            let megabytes = self.file.wal_bytes >> 20;
            self.notice(
                format!("its write-ahead log has {megabytes} MiB"),
                "a program has been reading the file for a long time, such as a backup or a shell: stop it, and the write-ahead log is reused",
            );
        }
    }

    /// Reads the lengths of the files and the free space from the file system.
    fn read_lengths(&mut self, database: &Path) {
        let length = |path: &Path| std::fs::metadata(path).map_or(0, |file| file.len());
        (self.file.bytes, self.file.wal_bytes) = (length(database), length(&log_path(database)));
        match free_bytes(database) {
            Ok(bytes) => self.file.disk_free_bytes = bytes,
            Err(error) => self.problem(
                format!("cannot read the free space of its disk: {error}"),
                "check the disk with `df`",
            ),
        }
    }

    /// Looks for malformed pages without SQLite. Only SQLite's own check can tell whether such a page is in use.
    fn find_malformed_pages(&mut self, database: &Path) {
        match PageCheck::find_malformed(database) {
            Ok(pages) => self.malformed_pages = pages,
            Err(error) => self.problem(format!("its pages cannot be read: {error}"), self.remedy()),
        }
    }

    /// Reports damage that an aggregator has recorded beside the file.
    fn report_recorded_damage(&mut self, database: &Path) {
        match recorded_damage(database) {
            Ok(Some(what)) if self.is_healthy() => self.notice(
                format!("the aggregator recorded that it is damaged ({what}), but it is not damaged now"),
                "start the aggregator: it checks the whole file and then continues to store",
            ),
            Ok(_) => {}
            Err(error) => {
                let what = format!("cannot read whether the aggregator found it damaged: {error}");
                self.problem(what, "check that this user may read the file that ends in -damaged beside it");
            }
        }
    }

    /// Runs SQLite's own checks: the quick check, and the full check if `full` is `true` and the quick check found
    /// nothing.
    async fn check_integrity(&mut self, connection: &mut SqliteConnection, full: bool) {
        // If the quick check finds damage, the full check is skipped: it would take several times as long and find
        // nothing more in damaged trees.
        let earlier_findings = self.findings.len();
        let pragmas = [(false, "PRAGMA quick_check(100)"), (true, "PRAGMA integrity_check(100)")];
        for (is_full, pragma) in pragmas.into_iter().filter(|(is_full, _)| full || !is_full) {
            let is_undamaged = self.integrity.problems.is_empty() && self.findings.len() == earlier_findings;
            if !is_undamaged {
                continue;
            }
            self.integrity.full = is_full;
            let answer: Result<Vec<String>, _> =
                sqlx::query_scalar(AssertSqlSafe(pragma)).fetch_all(&mut *connection).await;
            let lines = self.value_or_problem("the whole file", answer);
            self.integrity.problems = lines.into_iter().filter(|line| line != "ok").collect();
        }
        if full && self.findings.len() == earlier_findings {
            let answer = sqlx::query_as(
                "SELECT \"table\", parent, count(*) FROM pragma_foreign_key_check GROUP BY 1, 2",
            );
            let answer: Result<Vec<(String, String, i64)>, _> = answer.fetch_all(connection).await;
            let broken_references = self.value_or_problem("references between tables", answer);
            let lines = broken_references.into_iter().map(|(table, parent, rows)| {
                format!("{rows} rows of {table} refer to rows of {parent} that do not exist")
            });
            self.integrity.problems.extend(lines);
        }
        if let Some(first) = self.integrity.problems.first() {
            let what = match self.integrity.problems.len() {
                1 => format!("it is damaged: {first}"),
                n => format!("it is damaged in {n} places, the first: {first}"),
            };
            self.problem(what, self.remedy());
        }
        // Malformed pages are reported only if SQLite found damage: otherwise the pages are not in use.
        if self.findings.len() > earlier_findings
            && let Some(first) = self.malformed_pages.first()
        {
            let what =
                format!("{} of its pages are malformed, the first is {first}", self.malformed_pages.len());
            self.problem(what, self.remedy());
        }
    }

    /// Compares the version of the file's schema with the version that this program supports. Returns whether both are
    /// equal, and the schema is complete.
    async fn has_current_schema(&mut self, connection: &mut SqliteConnection) -> bool {
        let supported = MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or(0);
        let answer = sqlx::query_as("SELECT max(version), min(success) FROM _sqlx_migrations");
        let answer: Result<(Option<i64>, Option<bool>), _> = answer.fetch_one(connection).await;
        let (found, is_complete) = match answer {
            Ok((Some(found), success)) => (found, success != Some(false)),
            Err(error) if is_damage(&error) => {
                self.problem(
                    format!("it is damaged: cannot read which version wrote it: {error}"),
                    self.remedy(),
                );
                return false;
            }
            _ => {
                self.problem(
                    "it is not an aggregator's database".to_owned(),
                    "name the file of [aggregator] database",
                );
                return false;
            }
        };
        self.schema = Some(Schema { found, known: supported });
        if !is_complete {
            let what = format!("bringing its schema up to {found} was interrupted");
            self.problem(what, "restore the backup from before the update");
        } else if found > supported {
            let what = format!(
                "a newer version wrote it (its schema is {found}, this program supports {supported})"
            );
            self.problem(what, "update this program");
        } else if found < supported {
            let what =
                format!("an older version wrote it (its schema is {found}, this program's is {supported})");
            self.notice(what, "make a backup; the aggregator updates the schema at its next start, and the content can be examined after that");
        }
        is_complete && found == supported
    }
}
