//! Log lines about a model that loads for long.

use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use peernet_logger::Slug;

/// Time from the start of loading to the first log line. The time between two lines doubles with each line.
const FIRST_LINE_AFTER: Duration = Duration::from_secs(30);

/// Log target of the lines. Commands that show no other log lines select these lines by this target.
pub const LOAD_LOG_TARGET: &str = "peernet_inference::loading";

/// Logs that a model is still loading, until the `LoadWatch` is dropped.
// Loading may include a first inference, which may never end, and the building of an engine for a GPU, which may take
// many minutes.
pub(super) struct LoadWatch {
    /// Dropping this sender ends the thread that logs.
    loading_sender: Option<SyncSender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl LoadWatch {
    /// Starts to watch the loading of a model on a device.
    pub(super) fn start(model: &Slug, device: &str) -> Self {
        let (loading_sender, loading_receiver) = sync_channel(0);
        let (model, device) = (model.clone(), device.to_owned());
        let report = move || {
            let mut next_wait = FIRST_LINE_AFTER;
            let mut elapsed_s = 0;
            while loading_receiver.recv_timeout(next_wait) == Err(RecvTimeoutError::Timeout) {
                elapsed_s += next_wait.as_secs();
                next_wait *= 2;
                tracing::warn!(
                    target: LOAD_LOG_TARGET,
                    "model {model} is still loading on {device} after {elapsed_s} s: its files are read, or its first computation has not \
                     ended"
                );
            }
        };
        let thread = thread::Builder::new().name("load-watch".to_owned()).spawn(report);
        let thread = thread.inspect_err(
            |error| tracing::error!(%error, "cannot start the thread that reports long loading"),
        );
        Self { loading_sender: Some(loading_sender), thread: thread.ok() }
    }
}

impl Drop for LoadWatch {
    fn drop(&mut self) {
        drop(self.loading_sender.take());
        if self.thread.take().is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("the thread that reports long loading panicked");
        }
    }
}
