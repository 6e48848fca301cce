//! Runs `chronyc`: the library for chrony's protocol is GPL and so not linked.

use std::io;
use std::process::Stdio;
use std::time::Duration;

use peernet_clock::SharedClock;
use tokio::io::{AsyncRead, AsyncReadExt};
use tokio::process::Command;

use super::chrony::{Tracking, Trust, silent};
use super::claim::Answer;
use crate::config::ClockConfig;

/// How long `chronyc` may take; it gives up after some seconds by itself when nobody answers.
pub(super) const PATIENCE: Duration = Duration::from_secs(2);
/// Most bytes of its output that are read; a line has about 150.
const MAX_OUTPUT: u64 = 4096;

/// Asks chrony, again and again.
#[derive(Debug)]
pub(super) struct Chronyc {
    command: String,
    arguments: Vec<String>,
    clock: SharedClock,
    trust: Trust,
    /// Whether it was said already that there is none.
    told: bool,
}

impl Chronyc {
    pub(super) fn new(config: &ClockConfig, clock: SharedClock) -> Self {
        let trust = Trust::new(clock.epoch());
        let (command, arguments) = (config.chronyc.clone(), config.chronyc_arguments.clone());
        Self { command, arguments, clock, trust, told: false }
    }

    /// What chrony says now; `None` when there is no chrony on this host.
    pub(super) async fn ask(&mut self) -> Option<Answer> {
        let at = self.clock.mono();
        let printed = match tokio::time::timeout(PATIENCE, self.print()).await {
            Err(_) => return Some(silent(&format!("no answer within {} s", PATIENCE.as_secs()))),
            Ok(Err(error)) if error.kind() == io::ErrorKind::NotFound => {
                if !self.told {
                    tracing::info!(
                        "{} is not installed: chrony is not asked about this host's clock",
                        self.command
                    );
                    self.told = true;
                }
                return None;
            }
            Ok(Err(error)) => return Some(silent(&format!("cannot run {}: {error}", self.command))),
            Ok(Ok(printed)) => printed,
        };
        let line = match printed {
            Ok(line) => line,
            Err(complaint) => return Some(silent(&complaint)),
        };
        Some(match Tracking::parse(&line) {
            Ok(tracking) if self.trust.allows(&tracking, self.clock.epoch()) => tracking.answer(at),
            Ok(_) => silent("has not measured since the clock was stepped"),
            Err(why) => silent(&format!("{} printed what cannot be understood: {why}", self.command)),
        })
    }

    /// The line printed, or the line that says why there is none.
    async fn print(&self) -> io::Result<Result<String, String>> {
        let mut child = Command::new(&self.command)
            .args(&self.arguments)
            .args(["-n", "-c", "tracking"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .kill_on_drop(true)
            .spawn()?;
        let (output, errors) = (child.stdout.take(), child.stderr.take());
        let (output, errors) = tokio::try_join!(first_line(output), first_line(errors))?;
        let status = child.wait().await?;
        if status.success() {
            return Ok(Ok(output));
        }
        let complaint = [errors, output].into_iter().find(|line| !line.is_empty());
        Ok(Err(complaint.unwrap_or_else(|| format!("{}: {status}", self.command))))
    }
}

/// The first line of a pipe, which is read to its end.
async fn first_line(pipe: Option<impl AsyncRead + Unpin>) -> io::Result<String> {
    let mut bytes = Vec::new();
    if let Some(pipe) = pipe {
        pipe.take(MAX_OUTPUT).read_to_end(&mut bytes).await?;
    }
    Ok(String::from_utf8_lossy(&bytes).lines().next().unwrap_or_default().trim().to_owned())
}
