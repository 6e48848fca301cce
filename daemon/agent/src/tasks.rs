//! The tasks of the agent and how they may end.

use std::collections::HashMap;
use std::convert::Infallible;
use std::error::Error;

use tokio::runtime::Handle;
use tokio::task::{Id, JoinError, JoinSet};
use tokio_util::sync::CancellationToken;

/// An unexpected end of a part of the agent.
#[derive(Debug, thiserror::Error)]
#[error("{part} ended unexpectedly: {cause}")]
pub struct Failure {
    /// Name of the part, such as `outbox` or `pipeline NAME`.
    pub part: String,
    /// Cause of the end.
    #[source]
    pub cause: FailureCause,
}

/// Cause of an unexpected end.
#[derive(Debug, thiserror::Error)]
pub enum FailureCause {
    /// The task ended before it was asked to stop.
    #[error("it returned before the agent was stopped")]
    EndedEarly,
    /// The task panicked.
    #[error(transparent)]
    Panicked(#[from] JoinError),
    /// The task returned an error; each part has its own error type.
    #[error(transparent)]
    Failed(Box<dyn Error + Send + Sync>),
}

/// All tasks of the agent except the outbox, which ends after these tasks.
#[derive(Debug)]
pub(crate) struct Tasks {
    stop: CancellationToken,
    set: JoinSet<Result<(), FailureCause>>,
    names: HashMap<Id, String>,
    first_failure: Option<Failure>,
}

impl Tasks {
    /// Creates an empty set of tasks that end when `stop` is cancelled.
    pub(crate) fn new(stop: &CancellationToken) -> Self {
        // The token is a child of `stop`: a failing task ends this agent, but not an aggregator in the same process.
        Self { stop: stop.child_token(), set: JoinSet::new(), names: HashMap::new(), first_failure: None }
    }

    /// Returns the token that asks the tasks to end.
    pub(crate) fn stop_token(&self) -> CancellationToken {
        self.stop.clone()
    }

    /// Starts a task on `runtime` that must run until it is asked to stop.
    pub(crate) fn spawn_required(
        &mut self,
        runtime: &Handle,
        name: &str,
        task: impl Future<Output = ()> + Send + 'static,
    ) {
        self.spawn_required_fallible(runtime, name, async {
            task.await;
            Ok::<(), Infallible>(())
        });
    }

    /// Starts a task on `runtime` that must run until it is asked to stop, and that may return an error.
    pub(crate) fn spawn_required_fallible<E: Error + Send + Sync + 'static>(
        &mut self,
        runtime: &Handle,
        name: &str,
        task: impl Future<Output = Result<(), E>> + Send + 'static,
    ) {
        let stop = self.stop_token();
        self.spawn(runtime, name, async move {
            task.await.map_err(|error| FailureCause::Failed(Box::new(error)))?;
            if stop.is_cancelled() { Ok(()) } else { Err(FailureCause::EndedEarly) }
        });
    }

    /// Starts a task on `runtime` that may end at any time.
    pub(crate) fn spawn_finite(
        &mut self,
        runtime: &Handle,
        name: &str,
        task: impl Future<Output = ()> + Send + 'static,
    ) {
        self.spawn(runtime, name, async {
            task.await;
            Ok(())
        });
    }

    fn spawn(
        &mut self,
        runtime: &Handle,
        name: &str,
        task: impl Future<Output = Result<(), FailureCause>> + Send + 'static,
    ) {
        let id = self.set.spawn_on(task, runtime).id();
        self.names.insert(id, name.to_owned());
    }

    /// Waits for the first unexpected end of a task, which also stops the other tasks. Never returns if all tasks end
    /// as expected. The wait can be cancelled; [`join`](Self::join) returns the failure.
    pub(crate) async fn wait_for_failure(&mut self) {
        self.wait_until_ended_or_failed().await;
        if self.first_failure.is_none() {
            std::future::pending::<()>().await;
        }
    }

    /// Waits until all tasks have ended. The first unexpected end of a task stops the other tasks and is returned.
    pub(crate) async fn join(mut self) -> Result<(), Failure> {
        while !self.set.is_empty() {
            self.wait_until_ended_or_failed().await;
        }
        self.first_failure.map_or(Ok(()), Err)
    }

    /// Waits until all tasks have ended or a task has ended unexpectedly.
    async fn wait_until_ended_or_failed(&mut self) {
        while let Some(task_result) = self.set.join_next_with_id().await {
            let (id, cause) = match task_result {
                Ok((_, Ok(()))) => continue,
                Ok((id, Err(cause))) => (id, cause),
                Err(error) => (error.id(), error.into()),
            };
            let part = self.names.get(&id).cloned().unwrap_or_default();
            let failure = Failure { part, cause };
            tracing::error!("{failure}");
            // An agent that lost a part must not look healthy: the other parts are stopped, and the process ends with
            // an error.
            self.stop.cancel();
            self.first_failure.get_or_insert(failure);
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn panicked_task_stops_other_tasks_and_is_named() {
        let process_stop = CancellationToken::new();
        let mut tasks = Tasks::new(&process_stop);
        let stop = tasks.stop_token();
        tasks.spawn_required(&Handle::current(), "steady", async move { stop.cancelled().await });
        tasks.spawn_finite(&Handle::current(), "brief", async {});
        tasks.spawn_required(&Handle::current(), "fragile", async { panic!("as planned") });
        let failure = tasks.join().await.expect_err("fragile panicked");
        assert_eq!(failure.part, "fragile");
        assert!(!process_stop.is_cancelled(), "the rest of the process continues");
    }

    #[tokio::test]
    async fn task_that_ends_early_is_a_failure() {
        let mut tasks = Tasks::new(&CancellationToken::new());
        tasks.spawn_required(&Handle::current(), "lazy", async {});
        assert_eq!(tasks.join().await.expect_err("lazy stopped").part, "lazy");
    }

    #[tokio::test]
    async fn failure_is_returned_after_it_was_awaited() {
        let mut tasks = Tasks::new(&CancellationToken::new());
        tasks.spawn_required(&Handle::current(), "fragile", async { panic!("as planned") });
        tasks.wait_for_failure().await;
        assert_eq!(tasks.join().await.expect_err("fragile panicked").part, "fragile");
    }

    #[tokio::test]
    async fn all_tasks_end_when_stopped() {
        let process_stop = CancellationToken::new();
        let mut tasks = Tasks::new(&process_stop);
        let stop = tasks.stop_token();
        tasks.spawn_required(&Handle::current(), "steady", async move { stop.cancelled().await });
        process_stop.cancel();
        tasks.join().await.expect("a clean end");
    }
}
