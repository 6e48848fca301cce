//! Signals that request the end of `peernet` or `peernetd`.

use std::io;

use crate::shutdown_request::ShutdownRequests;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::time::Instant;

/// Listener for Ctrl-C, for the signal of service managers, and for the end of the terminal's session.
pub struct Signals {
    interrupt: Signal,
    terminate: Signal,
    /// Listener for SIGHUP. `None` if the process ignores SIGHUP, as with `nohup`, or if SIGHUP has arrived once: at
    /// the end of a session both the shell and the kernel send it, and both signals are one request.
    hang_up: Option<Signal>,
    shutdown_requests: ShutdownRequests,
}

impl Signals {
    /// Installs the signal handlers.
    ///
    /// # Errors
    /// If a handler cannot be installed.
    pub fn new() -> io::Result<Self> {
        let hang_up =
            if is_ignored(SignalKind::hangup()) { None } else { Some(signal(SignalKind::hangup())?) };
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            hang_up,
            shutdown_requests: ShutdownRequests::default(),
        })
    }

    /// Waits for the next request to end, and returns the name of its signal.
    pub async fn next(&mut self) -> &'static str {
        loop {
            let (kind, name) = tokio::select! {
                _ = self.interrupt.recv() => (SignalKind::interrupt(), "SIGINT"),
                _ = self.terminate.recv() => (SignalKind::terminate(), "SIGTERM"),
                () = wait_for_hang_up(&mut self.hang_up) => {
                    self.hang_up = None;
                    (SignalKind::hangup(), "SIGHUP")
                }
            };
            let is_new_request = self.shutdown_requests.record_signal(kind, Instant::now());
            if is_new_request {
                return name;
            }
        }
    }
}

async fn wait_for_hang_up(signal: &mut Option<Signal>) {
    match signal {
        Some(signal) => {
            signal.recv().await;
        }
        None => std::future::pending().await,
    }
}

/// Returns whether the process was started with this signal ignored.
fn is_ignored(signal: SignalKind) -> bool {
    // Without the file the signal counts as not ignored, which is the default.
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or_default();
    // Bit 0 stands for signal 1.
    mask >> (signal.as_raw_value() - 1) & 1 == 1
}
