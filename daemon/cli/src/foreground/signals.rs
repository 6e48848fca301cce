//! Being told to end.

use std::io;

use crate::wish::Wishes;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::time::Instant;

/// Ctrl-C, what service managers send, and the end of the terminal's session.
pub(crate) struct Signals {
    interrupt: Signal,
    terminate: Signal,
    /// `None` when it is not listened to: it was switched off, as `nohup` does, or has come. A shell and the system both
    /// send it when a session ends, which is one wish to end and not two.
    hang_up: Option<Signal>,
    wishes: Wishes,
}

impl Signals {
    pub(crate) fn new() -> io::Result<Self> {
        let hang_up =
            if is_ignored(SignalKind::hangup()) { None } else { Some(signal(SignalKind::hangup())?) };
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            hang_up,
            wishes: Wishes::default(),
        })
    }

    /// Waits for the next wish to end.
    pub(crate) async fn next(&mut self) {
        loop {
            let kind = tokio::select! {
                _ = self.interrupt.recv() => SignalKind::interrupt(),
                _ = self.terminate.recv() => SignalKind::terminate(),
                () = hung_up(&mut self.hang_up) => {
                    self.hang_up = None;
                    SignalKind::hangup()
                }
            };
            if self.wishes.is_another(kind, Instant::now()) {
                return;
            }
        }
    }
}

async fn hung_up(signal: &mut Option<Signal>) {
    match signal {
        Some(signal) => {
            signal.recv().await;
        }
        None => std::future::pending().await,
    }
}

/// Whether whoever started this program wants it not to mind a signal.
fn is_ignored(signal: SignalKind) -> bool {
    // Without the file the system's usual way stands: a signal is minded.
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or_default();
    mask >> (signal.as_raw_value() - 1) & 1 == 1
}
