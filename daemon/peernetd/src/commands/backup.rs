//! The command `peernetd backup`.

use std::path::Path;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use peernet_cli::exit::{Exit, Failure};
use peernet_cli::output::{print_to_stderr, print_to_stdout};
use peernet_statistics::number::bytes;
use peernet_store::maintenance::{Backup, BackupError, FinishedCopy};
use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;

use super::DatabaseArgument;
use crate::log;

/// Interval at which the progress bar reads the size of the growing copy.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(200);

/// Copies the database to a file that does not exist yet.
pub(crate) fn backup(database: DatabaseArgument, target: &Path) -> Exit {
    let _log = log::install_temporary();
    let result = database.path().and_then(|database| {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(|error| Failure::new(Exit::Unavailable, error))?;
        runtime.block_on(copy(&database, target))
    });
    match result {
        Ok(copy) => {
            print_to_stdout(format_args!("{} ({})", copy.path.display(), bytes(copy.bytes as f64).plain()));
            Exit::Ok
        }
        Err(failure) => {
            print_to_stderr(&failure);
            failure.exit
        }
    }
}

async fn copy(database: &Path, target: &Path) -> Result<FinishedCopy, Failure> {
    let failure = |error: BackupError| {
        let exit = match error {
            BackupError::Stopped => Exit::Interrupted,
            BackupError::NotADatabase { .. } => Exit::Data,
            _ => Exit::Unavailable,
        };
        Failure::new(exit, error)
    };
    // The signal handlers are installed before the copy starts, because an unhandled signal would leave a partial file
    // behind.
    let install_handler = |kind| signal(kind).map_err(|error| Failure::new(Exit::Unavailable, error));
    let (mut interrupts, mut terminations) =
        (install_handler(SignalKind::interrupt())?, install_handler(SignalKind::terminate())?);
    let backup = Backup::prepare(database, target).await.map_err(failure)?;
    let bar = progress_bar(backup.expected_bytes());
    let partial_file = backup.partial().to_owned();
    let stop = CancellationToken::new();
    let copy = backup.run(stop.clone());
    tokio::pin!(copy);
    let mut progress_timer = tokio::time::interval(PROGRESS_INTERVAL);
    loop {
        tokio::select! {
            result = &mut copy => {
                bar.finish_and_clear();
                return result.map_err(failure);
            }
            // After a signal, the loop continues until the copy has removed its partial file.
            _ = interrupts.recv() => stop.cancel(),
            _ = terminations.recv() => stop.cancel(),
            _ = progress_timer.tick() => {
                if let Ok(file) = std::fs::metadata(&partial_file) {
                    bar.set_position(file.len());
                }
            }
        }
    }
}

/// Returns the progress bar of the copy, which indicatif hides if standard error is not a terminal.
fn progress_bar(expected_bytes: u64) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(expected_bytes), ProgressDrawTarget::stderr());
    let style = ProgressStyle::with_template("{wide_bar} {bytes} of about {total_bytes}, {eta} left");
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}
