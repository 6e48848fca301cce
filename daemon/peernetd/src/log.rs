//! The log: standard error, one line per event.

use std::io::IsTerminal;

use peernet_cli::log::{LEVEL_VARIABLE, LineFormat, level_from_environment};
use serde::{Deserialize, Serialize};
use tracing::Subscriber;
use tracing_subscriber::filter::{EnvFilter, ParseError};
use tracing_subscriber::registry::LookupSpan;
use tracing_subscriber::util::SubscriberInitExt;

/// The table `[log]` of the configuration.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct LogConfig {
    /// Level: `error`, `warn`, `info`, `debug`, `trace`, or a filter such as `info,peernet_agent=debug`. The
    /// environment variable `PEERNET_LOG` takes precedence. Default: `info`.
    pub(crate) level: String,
}

impl Default for LogConfig {
    fn default() -> Self {
        Self { level: "info".to_owned() }
    }
}

/// Error of an invalid log level.
#[derive(Debug, thiserror::Error)]
#[error("{level:?}{} is not a log level: {source}; use error, warn, info, debug or trace", origin(*.from_environment))]
pub(crate) struct LevelError {
    level: String,
    /// `true` if the level comes from the environment and not from the configuration.
    from_environment: bool,
    source: ParseError,
}

fn origin(from_environment: bool) -> String {
    if from_environment { format!(" (from {LEVEL_VARIABLE})") } else { String::new() }
}

/// Installs a log for this thread, until the guard is dropped. The log is used until the configuration has been read.
pub(crate) fn install_temporary() -> tracing::subscriber::DefaultGuard {
    // An invalid level is reported later: `check` examines the same variable.
    let filter = level_from_environment().and_then(|level| EnvFilter::try_new(level).ok());
    let filter = filter.unwrap_or_else(|| EnvFilter::new("info"));
    subscriber(filter).set_default()
}

impl LogConfig {
    /// Checks the level.
    ///
    /// # Errors
    /// If the level is invalid; the error names the valid levels, and the environment variable if it sets the level.
    pub(crate) fn check(&self) -> Result<(), LevelError> {
        self.filter().map(|_| ())
    }

    fn filter(&self) -> Result<EnvFilter, LevelError> {
        let (level, from_environment) = match level_from_environment() {
            Some(level) => (level, true),
            None => (self.level.clone(), false),
        };
        EnvFilter::try_new(&level).map_err(|source| LevelError { level, from_environment, source })
    }
}

/// Installs the log for the rest of the process.
///
/// # Errors
/// If the level is invalid.
pub(crate) fn install(config: &LogConfig) -> anyhow::Result<()> {
    subscriber(config.filter()?).try_init()?;
    Ok(())
}

fn subscriber(filter: EnvFilter) -> impl Subscriber + Send + Sync + for<'a> LookupSpan<'a> {
    let is_terminal = std::io::stderr().is_terminal();
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(is_terminal)
        // The subscriber prints its own errors to standard error, too, and this printing panics if the reader of
        // standard error is gone.
        .log_internal_errors(false)
        .event_format(LineFormat::default())
        .finish()
}
