//! Queries chrony by running `chronyc`. The library for chrony's protocol is not used, because its licence is the GPL.

use std::io;
use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use peernet_clock::SharedClock;
use tokio::io::{AsyncRead, AsyncReadExt};
use tokio::process::Command;

use super::chrony::{AnswerFreshness, Tracking, TrackingError, report_without_claim};
use super::claim::SourceReport;
use crate::config::ClockConfig;

/// Longest time that `chronyc` may take. If chronyd does not answer, `chronyc` itself would wait longer.
pub(super) const CHRONYC_TIMEOUT: Duration = Duration::from_secs(2);
/// Maximum number of bytes of the output of `chronyc` that are read. A line has about 150 bytes.
const MAX_OUTPUT: u64 = 4096;

/// Reason why chrony cannot be queried.
#[derive(Debug, thiserror::Error)]
enum ChronycError {
    #[error("cannot run {command}: {source}")]
    Run { command: String, source: io::Error },
    #[error("no answer within {} s", CHRONYC_TIMEOUT.as_secs())]
    Timeout,
    /// Error text that `chronyc` printed.
    #[error("{0}")]
    Printed(String),
    #[error("{command} failed: {status}")]
    Failed { command: String, status: ExitStatus },
    #[error("cannot read the output of {command}: {source}")]
    Output { command: String, source: TrackingError },
    #[error("no measurement since the clock was stepped")]
    Outdated,
}

/// Queries chrony repeatedly.
#[derive(Debug)]
pub(super) struct Chronyc {
    command: String,
    arguments: Vec<String>,
    clock: SharedClock,
    answer_freshness: AnswerFreshness,
    /// `true` after a log line has said that chrony is not installed.
    has_logged_absence: bool,
}

impl Chronyc {
    pub(super) fn new(config: &ClockConfig, clock: SharedClock) -> Self {
        let answer_freshness = AnswerFreshness::new(clock.wall_epoch());
        let (command, arguments) = (config.chronyc.clone(), config.chronyc_arguments.clone());
        Self { command, arguments, clock, answer_freshness, has_logged_absence: false }
    }

    /// Queries chrony; `None` if chrony is not installed on this host.
    pub(super) async fn query(&mut self) -> Option<SourceReport> {
        match self.query_tracking().await {
            Ok(answer) => Some(answer),
            Err(ChronycError::Run { source, .. }) if source.kind() == io::ErrorKind::NotFound => {
                if !self.has_logged_absence {
                    tracing::info!(
                        "{} is not installed; chrony is not queried about this host's clock",
                        self.command
                    );
                    self.has_logged_absence = true;
                }
                None
            }
            Err(error) => Some(report_without_claim(&error)),
        }
    }

    async fn query_tracking(&mut self) -> Result<SourceReport, ChronycError> {
        let queried_at = self.clock.mono();
        let command = || self.command.clone();
        let result = tokio::time::timeout(CHRONYC_TIMEOUT, self.run_command()).await;
        let (status, output, errors) = result
            .map_err(|_| ChronycError::Timeout)?
            .map_err(|source| ChronycError::Run { command: command(), source })?;
        if !status.success() {
            let message = [errors, output].into_iter().find(|line| !line.is_empty());
            return Err(match message {
                Some(message) => ChronycError::Printed(message),
                None => ChronycError::Failed { command: command(), status },
            });
        }
        let tracking = Tracking::parse(&output);
        let tracking = tracking.map_err(|source| ChronycError::Output { command: command(), source })?;
        if self.answer_freshness.accepts(&tracking, self.clock.wall_epoch()) {
            Ok(tracking.to_report(queried_at))
        } else {
            Err(ChronycError::Outdated)
        }
    }

    /// Runs `chronyc`. Returns its exit status and the first lines of its output and its errors.
    async fn run_command(&self) -> io::Result<(ExitStatus, String, String)> {
        let mut child = Command::new(&self.command)
            .args(&self.arguments)
            // Without `-n`, chronyc looks up names of addresses, which may take long.
            .args(["-n", "-c", "tracking"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // The timeout drops this future.
            .kill_on_drop(true)
            .spawn()?;
        let (output, errors) = (child.stdout.take(), child.stderr.take());
        // Both pipes are served at the same time: the command would block if the pipe that is not read became full.
        let (output, errors) = tokio::try_join!(first_line(output), first_line(errors))?;
        Ok((child.wait().await?, output, errors))
    }
}

/// Reads a pipe up to its end, or up to [`MAX_OUTPUT`] bytes. Returns the first line.
async fn first_line(pipe: Option<impl AsyncRead + Unpin>) -> io::Result<String> {
    let mut bytes = Vec::new();
    if let Some(pipe) = pipe {
        pipe.take(MAX_OUTPUT).read_to_end(&mut bytes).await?;
    }
    Ok(String::from_utf8_lossy(&bytes).lines().next().unwrap_or_default().trim().to_owned())
}
