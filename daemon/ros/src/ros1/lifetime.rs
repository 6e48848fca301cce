//! Lifetime of a node: the reason for its end, and the tasks that end with it.

use std::sync::{Arc, OnceLock};

use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::error::NodeError;

/// Lifetime of a node, from its opening to its end. The end has a reason and is final.
#[derive(Debug)]
pub(super) struct NodeLifetime {
    /// Global name of the node.
    node: Arc<str>,
    stop: CancellationToken,
    end_reason: OnceLock<String>,
    tasks: TaskTracker,
}

impl NodeLifetime {
    pub(super) fn new(node: Arc<str>) -> Self {
        Self { node, stop: CancellationToken::new(), end_reason: OnceLock::new(), tasks: TaskTracker::new() }
    }

    /// Returns the global name of the node.
    pub(super) fn node(&self) -> &Arc<str> {
        &self.node
    }

    /// Returns the token that is cancelled when the node ends.
    pub(super) fn stop(&self) -> &CancellationToken {
        &self.stop
    }

    /// Returns the tracker of the tasks that end with the node.
    pub(super) fn tasks(&self) -> &TaskTracker {
        &self.tasks
    }

    /// Ends the node. The first reason is kept.
    pub(super) fn end(&self, reason: String) {
        // `set` fails if there is already a reason, which is then kept.
        let _ = self.end_reason.set(reason);
        self.stop.cancel();
    }

    /// Waits until all tasks of a node that was ended have returned.
    pub(super) async fn wait_for_tasks(&self) {
        self.tasks.close();
        self.tasks.wait().await;
    }

    /// Checks that the node has not ended.
    ///
    /// # Errors
    /// If the node has ended.
    pub(super) fn check_open(&self) -> Result<(), NodeError> {
        if self.stop.is_cancelled() { Err(self.closed_error()) } else { Ok(()) }
    }

    /// Returns the error for calls after the end.
    pub(super) fn closed_error(&self) -> NodeError {
        let reason = self.end_reason.get().cloned().unwrap_or_else(|| "it was shut down".to_owned());
        NodeError::Closed { node: self.node.to_string(), reason }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn first_end_reason_is_kept_and_tasks_end() {
        let lifetime = NodeLifetime::new("/camera".into());
        let stop = lifetime.stop().child_token();
        lifetime.tasks().spawn(async move { stop.cancelled().await });
        assert!(lifetime.check_open().is_ok());
        lifetime.end("another node has its name".into());
        lifetime.end("it was dropped".into());
        let error = lifetime.check_open().unwrap_err();
        assert!(
            matches!(&error, NodeError::Closed { node, reason } if node == "/camera" && reason == "another node has its name"),
            "{error}"
        );
        lifetime.wait_for_tasks().await;
    }
}
