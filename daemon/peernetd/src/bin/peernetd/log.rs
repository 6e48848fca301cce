//! The log: standard error, one line an event, in the form that journald understands when it listens.

use std::io::IsTerminal;

use serde::{Deserialize, Serialize};
use tracing_subscriber::filter::EnvFilter;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::registry::LookupSpan;
use tracing_subscriber::util::SubscriberInitExt;

use tracing::{Event, Level, Subscriber};

/// `[log]`
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct LogConfig {
    /// `error`, `warn`, `info`, `debug`, `trace`, or a filter such as `info,peernet_agent=debug`.
    /// The environment variable `PEERNET_LOG` goes before it.
    pub(crate) level: String,
}

impl Default for LogConfig {
    fn default() -> Self {
        Self { level: "info".to_owned() }
    }
}

/// The variable that overrides the configured level.
const VARIABLE: &str = "PEERNET_LOG";

/// A log for the time until the configuration is read.
pub(crate) fn temporary() -> tracing::subscriber::DefaultGuard {
    let filter = EnvFilter::try_from_env(VARIABLE).unwrap_or_else(|_| EnvFilter::new("info"));
    subscriber(filter).set_default()
}

impl LogConfig {
    /// Whether the level is one.
    ///
    /// # Errors
    /// Which it is, where it comes from, and what is possible.
    pub(crate) fn check(&self) -> Result<(), String> {
        self.filter().map(|_| ())
    }

    fn filter(&self) -> Result<EnvFilter, String> {
        let (level, origin) = match std::env::var(VARIABLE) {
            Ok(level) => (level, format!(" (from {VARIABLE})")),
            Err(_) => (self.level.clone(), String::new()),
        };
        EnvFilter::try_new(&level).map_err(|error| {
            format!("{level:?}{origin} is not a log level: {error}; use error, warn, info, debug or trace")
        })
    }
}

/// The log for the rest of the process.
///
/// # Errors
/// When the level is none.
pub(crate) fn install(config: &LogConfig) -> anyhow::Result<()> {
    subscriber(config.filter().map_err(anyhow::Error::msg)?).try_init()?;
    Ok(())
}

fn subscriber(filter: EnvFilter) -> impl Subscriber + Send + Sync + for<'a> LookupSpan<'a> {
    // journald stamps each line itself and reads a leading <N> as the priority.
    let journald = std::env::var_os("JOURNAL_STREAM").is_some();
    let terminal = std::io::stderr().is_terminal();
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(terminal)
        // It would print them to the same standard error, and panic when nobody reads that any more.
        .log_internal_errors(false)
        .event_format(Line { journald })
        .finish()
}

/// `12:00:00 INFO agent: text key=value`, or with a priority instead of the time under journald.
struct Line {
    journald: bool,
}

impl<S, N> FormatEvent<S, N> for Line
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> std::fmt::Result {
        let level = *event.metadata().level();
        let room = event.metadata().target().split("::").next().unwrap_or_default();
        let room = room.strip_prefix("peernet_").unwrap_or(room);
        if self.journald {
            write!(writer, "<{}>", priority(level))?;
        } else {
            use tracing_subscriber::fmt::time::FormatTime;
            tracing_subscriber::fmt::time::SystemTime.format_time(&mut writer)?;
            let (on, off) = if writer.has_ansi_escapes() { (colour(level), "\x1b[0m") } else { ("", "") };
            write!(writer, " {on}{level:>5}{off} ")?;
        }
        write!(writer, "{room}: ")?;
        context.format_fields(writer.by_ref(), event)?;
        writeln!(writer)
    }
}

/// syslog(3) priorities.
fn priority(level: Level) -> u8 {
    match level {
        Level::ERROR => 3,
        Level::WARN => 4,
        Level::INFO => 6,
        _ => 7,
    }
}

fn colour(level: Level) -> &'static str {
    match level {
        Level::ERROR => "\x1b[31m",
        Level::WARN => "\x1b[33m",
        Level::INFO => "\x1b[32m",
        _ => "\x1b[2m",
    }
}
