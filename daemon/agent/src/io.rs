//! The threads on which samples travel: pipelines, sessions, serving and probes, and nothing else.
//!
//! As in ZeroMQ there is one of them unless more is moved than one can carry, some gigabytes each second. An iteration
//! of several short tasks, each of which wakes the next, then stays on one processor: with a thread for each processor,
//! as is usual in servers, every step may wake another thread first, which on the way of a sample costs more than it
//! gains (`docs/measurements.md`). The outbox, the host's figures and, in a process that has them, the aggregator and
//! the web server run on other threads: no batch and no page holds these up.

use std::future::Future;
use std::io;
use std::num::NonZeroUsize;

use tokio::runtime::{Builder, Handle, Runtime};
use tokio_util::context::TokioContext;

/// The threads. Dropping it ends what still runs on them at its next wait.
#[derive(Debug)]
pub(crate) struct IoThreads {
    handle: Handle,
    /// Taken when this is dropped.
    runtime: Option<Runtime>,
}

impl IoThreads {
    /// Starts them.
    ///
    /// # Errors
    /// When the system gives no thread or no event queue.
    pub(crate) fn start(count: NonZeroUsize) -> io::Result<Self> {
        let runtime =
            Builder::new_multi_thread().worker_threads(count.get()).thread_name("io").enable_all().build()?;
        Ok(Self { handle: runtime.handle().clone(), runtime: Some(runtime) })
    }

    /// Where tasks are started on them.
    pub(crate) const fn handle(&self) -> &Handle {
        &self.handle
    }

    /// The future, whose sockets and tasks will be theirs, whoever waits for it.
    pub(crate) fn within<F: Future>(&self, future: F) -> TokioContext<F> {
        TokioContext::new(future, self.handle().clone())
    }
}

impl Drop for IoThreads {
    fn drop(&mut self) {
        // A runtime that is simply dropped waits for its threads, which a task may not do.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use tokio::net::UdpSocket;

    use super::*;

    #[tokio::test]
    async fn tasks_run_there_and_sockets_belong_there_whoever_waits() {
        let io = IoThreads::start(NonZeroUsize::MIN).expect("there are threads");
        let this = thread::current().id();
        let there =
            io.handle().spawn(async { (thread::current().id(), thread::current().name() == Some("io")) });
        let (thread, is_named) = there.await.expect("it ran");
        assert!(is_named && thread != this);
        let begin = async { tokio::spawn(async { thread::current().id() }).await };
        assert_eq!(io.within(begin).await.expect("it ran"), thread, "the only one");
    }

    #[tokio::test]
    async fn what_still_runs_ends_with_the_threads_and_nobody_waits() {
        let io = IoThreads::start(NonZeroUsize::MIN).expect("there are threads");
        let socket = io.within(UdpSocket::bind("127.0.0.1:0")).await.expect("there is a port");
        let waiting = io.handle().spawn(async move {
            let _ = socket.recv(&mut [0]).await;
        });
        drop(io);
        assert!(waiting.await.expect_err("it did not finish").is_cancelled());
    }
}
