//! The command `peernetd rebuild-rollups`.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use peernet_cli::exit::{Exit, Failure};
use peernet_cli::output::{print_to_stderr, print_to_stdout};
use peernet_statistics::number::fixed;
use peernet_store::OpenError;
use peernet_store::maintenance::{RebuildError, Rebuilt, rebuild_rollups};

use super::DatabaseArgument;
use crate::log;

/// Computes the roll-ups of one run from the stored nodes, or of all runs if `run` is `None`.
pub(crate) fn rebuild(database: DatabaseArgument, run: Option<i64>) -> Exit {
    let _log = log::install_temporary();
    let bar = progress_spinner();
    let result = database.path().and_then(|database| {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(|error| Failure::new(Exit::Unavailable, error))?;
        let show_progress = |rebuilt: &Rebuilt| {
            bar.set_message(format!(
                "{} runs, {} iterations",
                fixed(rebuilt.runs as f64, 0),
                fixed(rebuilt.iterations as f64, 0)
            ));
            bar.tick();
        };
        let result = runtime.block_on(rebuild_rollups(&database, run, show_progress));
        result.map_err(|error| Failure::new(exit_code(&error), error))
    });
    bar.finish_and_clear();
    match result {
        Ok(rebuilt) => {
            print_to_stdout(format_args!(
                "rebuilt the roll-ups of {} runs from {} iterations",
                fixed(rebuilt.runs as f64, 0),
                fixed(rebuilt.iterations as f64, 0)
            ));
            if rebuilt.partly_rebuilt_runs > 0 {
                print_to_stdout(format_args!(
                    "{} of these runs in part: the roll-ups of intervals whose nodes were deleted are unchanged",
                    fixed(rebuilt.partly_rebuilt_runs as f64, 0)
                ));
            }
            Exit::Ok
        }
        Err(failure) => {
            print_to_stderr(&failure);
            failure.exit
        }
    }
}

fn exit_code(error: &RebuildError) -> Exit {
    match error {
        RebuildError::NoRun { .. } => Exit::Usage,
        RebuildError::Open(OpenError::NotADatabase { .. }) => Exit::Data,
        RebuildError::Missing(_)
        | RebuildError::Lock(_)
        | RebuildError::Open(_)
        | RebuildError::Database { .. } => Exit::Unavailable,
    }
}

/// Returns the progress display, which indicatif hides if standard error is not a terminal.
fn progress_spinner() -> ProgressBar {
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
    let style = ProgressStyle::with_template("{spinner} {msg}, {elapsed}");
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()))
}
