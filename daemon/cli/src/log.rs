//! Form of the log's lines. Under journald each line begins with its priority.

use tracing::{Event, Level, Subscriber};
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::registry::LookupSpan;

/// Environment variable that sets the level of the log.
pub const LEVEL_VARIABLE: &str = "PEERNET_LOG";

/// Returns the level that the environment sets; `None` if the variable is empty or not set.
pub fn level_from_environment() -> Option<String> {
    std::env::var(LEVEL_VARIABLE).ok().filter(|level| !level.is_empty())
}

/// Formatter of lines such as `12:00:00 INFO agent: text key=value`, with a priority instead of the time under
/// journald.
#[derive(Debug)]
pub struct LineFormat {
    is_under_journald: bool,
}

impl Default for LineFormat {
    fn default() -> Self {
        // journald stamps each line itself and reads a leading <N> as the priority.
        Self { is_under_journald: is_under_journald() }
    }
}

/// Returns whether journald reads standard error. systemd sets `JOURNAL_STREAM` to the device and inode of the
/// journal's socket, and programs with another standard error, such as a terminal, inherit the variable.
fn is_under_journald() -> bool {
    let Ok(journal) = std::env::var("JOURNAL_STREAM") else { return false };
    rustix::fs::fstat(std::io::stderr())
        .is_ok_and(|stream| journal == format!("{}:{}", stream.st_dev, stream.st_ino))
}

impl<S, N> FormatEvent<S, N> for LineFormat
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
        let source = event.metadata().target().split("::").next().unwrap_or_default();
        let source = source.strip_prefix("peernet_").unwrap_or(source);
        // The store is a part of the aggregator, so its log lines have the aggregator's name.
        let source = if source == "store" { "aggregator" } else { source };
        if self.is_under_journald {
            write!(writer, "<{}>", priority(level))?;
        } else {
            use tracing_subscriber::fmt::time::FormatTime;
            tracing_subscriber::fmt::time::SystemTime.format_time(&mut writer)?;
            let (colour_start, colour_end) =
                if writer.has_ansi_escapes() { (colour(level), "\x1b[0m") } else { ("", "") };
            write!(writer, " {colour_start}{level:>5}{colour_end} ")?;
        }
        write!(writer, "{source}: ")?;
        context.format_fields(writer.by_ref(), event)?;
        writeln!(writer)
    }
}

/// Returns the priority that syslog(3) defines for a level.
fn priority(level: Level) -> u8 {
    match level {
        Level::ERROR => 3,
        Level::WARN => 4,
        Level::INFO => 6,
        _ => 7,
    }
}

/// Returns the escape sequence of the terminal for the colour of a level.
fn colour(level: Level) -> &'static str {
    match level {
        Level::ERROR => "\x1b[31m",
        Level::WARN => "\x1b[33m",
        Level::INFO => "\x1b[32m",
        _ => "\x1b[2m",
    }
}
