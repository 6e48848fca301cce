//! Log of a foreground run: output of custom code, remarks on connections, and with `PEERNET_LOG` all other lines.
//!
//! On a terminal, the lines are printed above the progress. A run of an experiment passes the lines to the program
//! that shows the progress: on standard output, each line as a JSON string.

use std::fmt::{self, Write as _};
use std::io::{self, Write};

use crate::exit::{Exit, Failure};
use crate::log::{LEVEL_VARIABLE, LineFormat, level_from_environment};
use crate::output::print_to_stdout;
use peernet_agent::REMARK_LOG_TARGET;
use peernet_inference::bank::LOAD_LOG_TARGET;
use tracing::field::{Field, Visit};
use tracing::{Event, Subscriber};
use tracing_subscriber::filter::EnvFilter;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::registry::LookupSpan;
use tracing_subscriber::util::SubscriberInitExt;

use super::progress::without_progress_bar;

/// Log targets of the lines of custom code.
const CUSTOM_CODE_TARGETS: [&str; 2] = ["peernet_external::python", "peernet_external::exec"];

/// The process that shows the lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum LogDestination {
    /// This process, on standard error.
    StandardError,
    /// The parent process, which reads the standard output of this process.
    Parent,
}

/// Log targets of warnings that every user sees.
const WARNING_TARGETS: [&str; 2] = [REMARK_LOG_TARGET, LOAD_LOG_TARGET];

/// Installs the log. Unless `PEERNET_LOG` sets another level, the log contains only output of custom code, remarks on
/// connections, and warnings about models that take long to load.
///
/// # Errors
/// When the variable does not contain a valid level (exit code 78).
pub(crate) fn start_log(destination: LogDestination) -> Result<(), Failure> {
    let configuration_failure = |error: anyhow::Error| Failure::new(Exit::Configuration, error);
    let level = level_from_environment().unwrap_or_else(default_level);
    let filter = EnvFilter::try_new(&level).map_err(|error| {
        configuration_failure(anyhow::anyhow!(
            "{level:?} (from {LEVEL_VARIABLE}) is not a log level: {error}; use error, warn, info, debug or trace"
        ))
    })?;
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(move || LogWriter(destination))
        .with_ansi(false);
    // The log would print its internal errors to standard error without hiding the progress bar, so they are dropped.
    let log = log
        .log_internal_errors(false)
        .event_format(LogFormat { line_format: LineFormat::default() })
        .finish();
    log.try_init().map_err(|error| configuration_failure(error.into()))
}

/// Returns the level of the log that the user sees without `PEERNET_LOG`.
fn default_level() -> String {
    let custom_code = CUSTOM_CODE_TARGETS.map(|target| format!(",{target}=info")).concat();
    let warnings = WARNING_TARGETS.map(|target| format!(",{target}=warn")).concat();
    format!("off{custom_code}{warnings}")
}

/// Writer of the log, which gets one whole line at a time.
struct LogWriter(LogDestination);

impl Write for LogWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self.0 {
            LogDestination::StandardError => without_progress_bar(|| io::stderr().lock().write(bytes)),
            LogDestination::Parent => {
                let text = String::from_utf8_lossy(bytes);
                print_to_stdout(serde_json::Value::from(text.trim_end()));
                Ok(bytes.len())
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self.0 {
            LogDestination::StandardError => io::stderr().lock().flush(),
            LogDestination::Parent => Ok(()),
        }
    }
}

/// Formatter: `model my_model-Net: the line` for custom code, `warning: the text` for warnings, the log's form for all
/// other lines.
struct LogFormat {
    /// Format of all other lines.
    line_format: LineFormat,
}

impl<S, N> FormatEvent<S, N> for LogFormat
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        let target = event.metadata().target();
        let is_warning = WARNING_TARGETS.contains(&target);
        if !is_warning && !CUSTOM_CODE_TARGETS.contains(&target) {
            return self.line_format.format_event(context, writer, event);
        }
        let mut message = LogMessage::default();
        event.record(&mut message);
        if is_warning {
            return writeln!(writer, "warning: {}", message.line);
        }
        writeln!(writer, "{}: {}", message.name, message.line)
    }
}

/// Name and text of a log event.
#[derive(Default)]
struct LogMessage {
    name: String,
    line: String,
}

impl Visit for LogMessage {
    fn record_str(&mut self, field: &Field, value: &str) {
        if field.name() == "name" {
            value.clone_into(&mut self.name);
        }
    }

    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        if field.name() == "message" {
            // Writing to a string cannot fail.
            let _ = write!(self.line, "{value:?}");
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use super::*;

    #[derive(Clone, Default)]
    struct SharedBuffer(Arc<Mutex<Vec<u8>>>);

    impl Write for SharedBuffer {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().expect("not poisoned").write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn slow_loading_is_shown_at_default_level() {
        let lines = SharedBuffer::default();
        let writer = lines.clone();
        let log = tracing_subscriber::fmt()
            .with_env_filter(EnvFilter::new(default_level()))
            .with_writer(move || writer.clone())
            .event_format(LogFormat { line_format: LineFormat::default() })
            .finish();
        tracing::subscriber::with_default(log, || {
            tracing::warn!(target: LOAD_LOG_TARGET, "model net is still loading");
            tracing::warn!("another line");
        });
        let shown = String::from_utf8(lines.0.lock().expect("not poisoned").clone()).expect("is text");
        assert_eq!(shown, "warning: model net is still loading\n");
    }
}
