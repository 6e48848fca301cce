//! The tasks of the agent and how they may end.

use std::collections::HashMap;

use tokio::runtime::Handle;
use tokio::task::{Id, JoinSet};
use tokio_util::sync::CancellationToken;

/// A part of the agent ended that should not have.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{part} ended unexpectedly: {reason}")]
pub struct Failure {
    /// Which part.
    pub part: String,
    /// What is known of the cause.
    pub reason: String,
}

/// All tasks but the outbox, which outlives them.
#[derive(Debug)]
pub(crate) struct Tasks {
    stop: CancellationToken,
    set: JoinSet<Result<(), String>>,
    names: HashMap<Id, String>,
}

impl Tasks {
    /// No tasks yet; `stop` tells them when to end.
    pub(crate) fn new(stop: &CancellationToken) -> Self {
        // A child: that one task fails ends this agent, not whoever shares the process.
        Self { stop: stop.child_token(), set: JoinSet::new(), names: HashMap::new() }
    }

    /// What tells the tasks to end.
    pub(crate) fn stop(&self) -> CancellationToken {
        self.stop.clone()
    }

    /// Starts a task there that must run until it is told to stop.
    pub(crate) fn keep(
        &mut self,
        there: &Handle,
        name: &str,
        task: impl Future<Output = ()> + Send + 'static,
    ) {
        self.keep_or_fail(there, name, async {
            task.await;
            Ok(())
        });
    }

    /// Starts a task there that must run until it is told to stop, and may tell why it could not.
    pub(crate) fn keep_or_fail(
        &mut self,
        there: &Handle,
        name: &str,
        task: impl Future<Output = Result<(), String>> + Send + 'static,
    ) {
        let stop = self.stop();
        self.spawn(there, name, async move {
            task.await?;
            if stop.is_cancelled() { Ok(()) } else { Err("it was not told to".to_owned()) }
        });
    }

    /// Starts a task there that may end when it is done.
    pub(crate) fn let_end(
        &mut self,
        there: &Handle,
        name: &str,
        task: impl Future<Output = ()> + Send + 'static,
    ) {
        self.spawn(there, name, async {
            task.await;
            Ok(())
        });
    }

    fn spawn(
        &mut self,
        there: &Handle,
        name: &str,
        task: impl Future<Output = Result<(), String>> + Send + 'static,
    ) {
        let id = self.set.spawn_on(task, there).id();
        self.names.insert(id, name.to_owned());
    }

    /// Waits until all have ended after being told to. The first that fails ends the others.
    pub(crate) async fn join(mut self) -> Result<(), Failure> {
        let mut first = Ok(());
        while let Some(ended) = self.set.join_next_with_id().await {
            let (id, reason) = match ended {
                Ok((_, Ok(()))) => continue,
                Ok((id, Err(reason))) => (id, reason),
                Err(error) => (error.id(), error.to_string()),
            };
            let part = self.names.get(&id).cloned().unwrap_or_default();
            let failure = Failure { part, reason };
            tracing::error!("{failure}");
            self.stop.cancel();
            if first.is_ok() {
                first = Err(failure);
            }
        }
        first
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_task_that_dies_ends_the_others_and_is_named() {
        let outer = CancellationToken::new();
        let mut tasks = Tasks::new(&outer);
        let stop = tasks.stop();
        tasks.keep(&Handle::current(), "steady", async move { stop.cancelled().await });
        tasks.let_end(&Handle::current(), "brief", async {});
        tasks.keep(&Handle::current(), "fragile", async { panic!("as planned") });
        let failure = tasks.join().await.expect_err("fragile died");
        assert_eq!(failure.part, "fragile");
        assert!(!outer.is_cancelled(), "the rest of the process goes on");
    }

    #[tokio::test]
    async fn a_task_that_stops_untold_is_a_failure() {
        let mut tasks = Tasks::new(&CancellationToken::new());
        tasks.keep(&Handle::current(), "lazy", async {});
        assert_eq!(tasks.join().await.expect_err("lazy stopped").part, "lazy");
    }

    #[tokio::test]
    async fn all_end_well_when_told_to() {
        let outer = CancellationToken::new();
        let mut tasks = Tasks::new(&outer);
        let stop = tasks.stop();
        tasks.keep(&Handle::current(), "steady", async move { stop.cancelled().await });
        outer.cancel();
        tasks.join().await.expect("a clean end");
    }
}
