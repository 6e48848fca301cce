//! The tasks of a cloud, and how they end.

use std::time::Duration;

use tokio::time::timeout;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

/// Tasks of a cloud. They are asked to stop, and are aborted if they do not stop in time.
#[derive(Clone, Debug, Default)]
pub(super) struct CloudTasks {
    stop: CancellationToken,
    abort: CancellationToken,
    tracker: TaskTracker,
}

impl CloudTasks {
    /// Starts a task that must end when one of the tokens is cancelled.
    pub(super) fn spawn(&self, task: impl Future<Output = ()> + Send + 'static) {
        self.tracker.spawn(task);
    }

    /// Returns the token that asks the tasks to stop with a goodbye.
    pub(super) fn stop_token(&self) -> CancellationToken {
        self.stop.clone()
    }

    /// Returns a token that ends one connection without a goodbye.
    pub(super) fn abort_token(&self) -> CancellationToken {
        self.abort.child_token()
    }

    /// Asks all tasks to end immediately, without goodbyes.
    pub(super) fn abort(&self) {
        self.abort.cancel();
    }

    /// Waits until the tasks are aborted.
    pub(super) async fn wait_for_abort(&self) {
        self.abort.cancelled().await;
    }

    /// Waits until the tasks are asked to stop or are aborted.
    pub(super) async fn wait_for_stop(&self) {
        tokio::select! {
            () = self.stop.cancelled() => {}
            () = self.abort.cancelled() => {}
        }
    }

    /// Asks the tasks to stop, and aborts them after `linger`.
    pub(super) async fn close(&self, linger: Duration) {
        self.stop.cancel();
        self.tracker.close();
        if timeout(linger, self.tracker.wait()).await.is_err() {
            self.abort();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn task_that_does_not_stop_is_aborted() {
        let tasks = CloudTasks::default();
        let (stoppable, unstoppable) = (tasks.stop_token(), tasks.abort_token());
        tasks.spawn(async move { stoppable.cancelled().await });
        tasks.spawn(async move { unstoppable.cancelled().await });
        tasks.close(Duration::from_millis(20)).await;
        tasks.wait_for_abort().await;
        tasks.tracker.wait().await;
    }

    #[tokio::test]
    async fn tasks_that_stop_are_not_aborted() {
        let tasks = CloudTasks::default();
        let cloned_tasks = tasks.clone();
        tasks.spawn(async move { cloned_tasks.wait_for_stop().await });
        tasks.close(Duration::from_secs(60)).await;
        assert!(!tasks.abort_token().is_cancelled());
    }
}
