//! Tasks of publishers that still have messages to send.

use std::time::Duration;

use tokio::time::timeout;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

/// Tasks of the publishers of a node. Each ends when it has sent all published messages.
#[derive(Debug, Default)]
pub(super) struct PublishingTasks {
    tracker: TaskTracker,
    stop: CancellationToken,
}

impl PublishingTasks {
    /// Starts the task of a publisher. The task gets a token that asks it to send the remaining messages and to end.
    pub(super) fn spawn<F: Future<Output = ()> + Send + 'static>(
        &self,
        task: impl FnOnce(CancellationToken) -> F,
    ) {
        self.tracker.spawn(task(self.stop.clone()));
    }

    /// Asks all tasks to end. Returns whether they have sent everything within `time_limit`.
    pub(super) async fn finish(&self, time_limit: Duration) -> bool {
        self.stop.cancel();
        self.tracker.close();
        timeout(time_limit, self.tracker.wait()).await.is_ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn tasks_are_asked_to_end_and_awaited_for_a_limited_time() {
        let tasks = PublishingTasks::default();
        tasks.spawn(|stop| async move { stop.cancelled().await });
        assert!(tasks.finish(Duration::from_secs(60)).await);
        tasks.spawn(|_| std::future::pending());
        assert!(!tasks.finish(Duration::from_millis(10)).await);
    }
}
