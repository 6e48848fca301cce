//! The task that reads the database's file repeatedly, at a low rate, to find damage.

use std::collections::HashSet;
use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, SqliteConnection};
use tokio::time::MissedTickBehavior;
use tokio_util::sync::CancellationToken;
use tokio_util::task::{AbortOnDropHandle, TaskTracker};

use super::{Integrity, PageCheck, log_path};
use crate::database_error::is_damage;
use crate::limits::BUSY_TIMEOUT;

/// Number of bytes that one step of a pass reads.
const READ_STEP_BYTES: u64 = 1 << 20;
/// Bytes per second of the first pass, and of passes that confirm malformed pages. The first pass is faster than later
/// passes, because the file may have been damaged while no aggregator ran.
const FAST_BYTES_PER_SECOND: u64 = 128 << 20;
/// Bytes per second of later passes: 1 GiB takes a minute, of which a processor core is busy for two seconds.
const BYTES_PER_SECOND: u64 = 16 << 20;
/// Instructions of SQLite's virtual machine between two checks whether the task is to stop.
const INSTRUCTIONS_PER_CHECK: i32 = 10_000;
/// Number of passes in which a page has to look malformed before SQLite checks the whole file. SQLite's check takes far
/// longer than a pass.
const MAX_PASSES: usize = 3;
/// Pause between two passes.
const PAUSE: Duration = Duration::from_secs(2);

/// The continuous check of one open database.
#[derive(Debug)]
pub(crate) struct IntegrityCheck {
    stop: CancellationToken,
    /// The task; dropping this handle aborts the task, which then releases the file.
    task: AbortOnDropHandle<()>,
    /// Reads in progress on other threads. They hold the file open, too.
    reads: TaskTracker,
}

impl IntegrityCheck {
    /// Starts the check. If damage was recorded earlier, the check first examines the whole database, and removes the
    /// record if the database is not damaged. When the check finds damage, it records the damage, which stops all
    /// writing, and ends.
    pub(crate) fn start(integrity: Integrity, file: Arc<File>) -> Self {
        integrity.attach_file(&file);
        let stop = CancellationToken::new();
        let reads = TaskTracker::new();
        let (task_stop, task_reads) = (stop.clone(), reads.clone());
        let task = AbortOnDropHandle::new(tokio::spawn(async move {
            let check = async {
                if integrity.damage().is_some() {
                    confirm_earlier_damage(&integrity, &task_stop).await;
                }
                tokio::select! {
                    () = integrity.wait_for_damage() => {}
                    () = check_repeatedly(&integrity, &file, &task_reads, &task_stop) => {}
                }
            };
            let _stopped = task_stop.run_until_cancelled(check).await;
        }));
        Self { stop, task, reads }
    }

    /// Stops the check. When this function returns, the check no longer holds the file open.
    pub(crate) async fn stop(self) {
        self.stop.cancel();
        if let Err(error) = self.task.await {
            tracing::error!(%error, "the task that checks the database panicked");
        }
        self.reads.close();
        self.reads.wait().await;
    }
}

/// Checks the whole database because an earlier process found it damaged.
async fn confirm_earlier_damage(integrity: &Integrity, stop: &CancellationToken) {
    tracing::warn!(database = %integrity.database.display(), "checking the whole database, in which damage was found earlier");
    loop {
        match find_damage_with_sqlite(&integrity.database, stop).await {
            Ok(Some(finding)) => {
                tracing::error!(
                    "{}; this check found: {finding}",
                    integrity.damage_message().unwrap_or_default()
                );
                return;
            }
            Ok(None) => match integrity.clear() {
                Ok(()) => {
                    tracing::info!(database = %integrity.database.display(), "the database is not damaged");
                    return;
                }
                Err(error) => tracing::error!(
                    %error, database = %integrity.database.display(),
                    "the database is not damaged, but the file that records damage cannot be removed"
                ),
            },
            Err(error) => tracing::warn!(%error, "cannot check the whole database; the check is retried"),
        }
        tokio::time::sleep(PAUSE).await;
    }
}

/// Looks for damage until the task is stopped.
async fn check_repeatedly(
    integrity: &Integrity,
    file: &Arc<File>,
    reads: &TaskTracker,
    stop: &CancellationToken,
) {
    let mut rate = FAST_BYTES_PER_SECOND;
    // Pages that look malformed but that SQLite does not use.
    let mut unused_pages = HashSet::new();
    // A failure is logged once, and again only after a check that succeeded.
    let mut has_failed = false;
    loop {
        match check_once(integrity, (file, reads), rate, &mut unused_pages, stop).await {
            Ok(()) => has_failed = false,
            Err(error) if !has_failed => {
                tracing::warn!(%error, database = %integrity.database.display(), "cannot check the database for damage; the check is retried");
                has_failed = true;
            }
            Err(_) => {}
        }
        rate = BYTES_PER_SECOND;
        tokio::time::sleep(PAUSE).await;
    }
}

/// Looks for damage once.
async fn check_once(
    integrity: &Integrity,
    (file, reads): (&Arc<File>, &TaskTracker),
    rate: u64,
    unused_pages: &mut HashSet<u32>,
    stop: &CancellationToken,
) -> Result<(), sqlx::Error> {
    let malformed = malformed_pages(&integrity.database, file, reads, rate).await?;
    unused_pages.retain(|page| malformed.contains(page));
    let Some(first) = malformed.iter().find(|page| !unused_pages.contains(page)) else { return Ok(()) };
    let database = integrity.database.display();
    tracing::info!(
        %database, page = first, pages = malformed.len(),
        "pages of the database look malformed; SQLite checks the whole file"
    );
    match find_damage_with_sqlite(&integrity.database, stop).await? {
        Some(finding) => integrity.record_damage(format!("page {first} is malformed ({finding})")),
        // SQLite did not read the malformed pages, so no other page refers to them.
        None => {
            tracing::info!(%database, "the database is not damaged: SQLite found no error in the whole file");
            *unused_pages = malformed.into_iter().collect();
        }
    }
    Ok(())
}

/// Makes a pass over the whole file. If pages look malformed, makes further passes, up to [`MAX_PASSES`]. Returns the
/// pages that look malformed in every pass.
///
/// While events are stored, records move from page to page during a pass, so an overflow page may look as if no record
/// used it. Such pages differ from pass to pass, whereas a damaged page looks malformed in all passes.
pub(super) async fn malformed_pages(
    database: &Path,
    file: &Arc<File>,
    reads: &TaskTracker,
    rate: u64,
) -> Result<Vec<u32>, sqlx::Error> {
    let mut malformed = read_pages(database, file, reads, rate).await?;
    for _pass in 1..MAX_PASSES {
        if malformed.is_empty() {
            break;
        }
        let malformed_again = read_pages(database, file, reads, FAST_BYTES_PER_SECOND).await?;
        malformed.retain(|page| malformed_again.contains(page));
    }
    Ok(malformed)
}

/// Makes one pass over the file. Returns the pages that look malformed.
async fn read_pages(
    database: &Path,
    file: &Arc<File>,
    reads: &TaskTracker,
    rate: u64,
) -> Result<Vec<u32>, sqlx::Error> {
    let (file, log) = (Arc::clone(file), log_path(database));
    // If the file has no header of a database, page 1 is malformed, because this page has the header.
    let Some(mut check) = read_blocking(reads, move || PageCheck::start(file, log)).await? else {
        return Ok(vec![1]);
    };
    let mut ticks = tokio::time::interval(Duration::from_micros(1_000_000 * READ_STEP_BYTES / rate));
    // After a slow read, the missed ticks would otherwise follow in a burst, faster than the rate.
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut has_more = true;
    while has_more {
        ticks.tick().await;
        (check, has_more) = read_blocking(reads, move || {
            let has_more = check.step(READ_STEP_BYTES)?;
            Ok((check, has_more))
        })
        .await?;
    }
    read_blocking(reads, move || check.finish()).await
}

/// Executes `work` on a thread for blocking work, because reading a file blocks.
async fn read_blocking<T: Send + 'static>(
    reads: &TaskTracker,
    work: impl FnOnce() -> io::Result<T> + Send + 'static,
) -> Result<T, sqlx::Error> {
    let result = reads.spawn_blocking(work).await;
    Ok(result.map_err(|_| sqlx::Error::WorkerCrashed)??)
}

/// Returns the first error that SQLite finds in the whole file. SQLite reads the file over a separate connection.
///
/// # Errors
/// When the file cannot be checked now, or `stop` was cancelled.
pub(crate) async fn find_damage_with_sqlite(
    database: &Path,
    stop: &CancellationToken,
) -> Result<Option<String>, sqlx::Error> {
    let options = SqliteConnectOptions::new()
        .filename(database)
        .read_only(true)
        .busy_timeout(BUSY_TIMEOUT)
        .disable_statement_logging();
    let finding = match options.connect().await {
        Ok(mut connection) => {
            let finding = first_finding(&mut connection, stop.clone()).await;
            // The result is known, so an error while closing does not matter.
            let _closed = connection.close().await;
            finding
        }
        Err(error) => Err(error),
    };
    match finding {
        Err(error) if is_damage(&error) => Ok(Some(error.to_string())),
        finding => finding,
    }
}

/// Returns the first error that SQLite's checks report over this connection.
async fn first_finding(
    connection: &mut SqliteConnection,
    stop: CancellationToken,
) -> Result<Option<String>, sqlx::Error> {
    connection
        .lock_handle()
        .await?
        .set_progress_handler(INSTRUCTIONS_PER_CHECK, move || !stop.is_cancelled());
    // The quick check comes first: it finds most errors in a fraction of the time of the full check.
    for pragma in ["PRAGMA quick_check(1)", "PRAGMA integrity_check(1)"] {
        let problems: Vec<String> =
            sqlx::query_scalar(AssertSqlSafe(pragma)).fetch_all(&mut *connection).await?;
        if let Some(finding) = problems.into_iter().find(|line| line != "ok") {
            // If there are several lines, the first is a heading.
            return Ok(finding.lines().last().map(str::to_owned));
        }
    }
    Ok(None)
}
