//! The I/O threads. They run only tasks that carry samples: pipelines, sessions, serving and probes.
//!
//! As in ZeroMQ the default is one thread, which carries some gigabytes per second. An iteration is several short
//! tasks, each of which wakes the next. With a thread for each processor, as is usual in servers, each step may first
//! have to wake another thread. On two processors, two threads instead of one reduced the round trips per second of
//! samples of 1 kB by a third; while events were stored, the 99th percentile of the total was up to three times as long
//! (measured on 2026-11-21 with commit e8b9baf3). With one thread the whole chain stays on one
//! processor.
//!
//! The outbox and the host's metrics run on other threads. So do the aggregator and the web server if they are in
//! the same process. Therefore neither sending a batch nor rendering a page delays a sample.

use std::future::Future;
use std::io;
use std::num::NonZeroUsize;

use tokio::runtime::{Builder, Handle, Runtime};
use tokio_util::context::TokioContext;

/// A runtime whose threads carry samples. Dropping this value cancels the tasks of the runtime at their next wait.
#[derive(Debug)]
pub(crate) struct IoThreads {
    handle: Handle,
    /// `None` only while this is being dropped.
    runtime: Option<Runtime>,
}

impl IoThreads {
    /// Starts `count` threads.
    ///
    /// # Errors
    /// When the operating system refuses to create a thread or an epoll instance.
    pub(crate) fn start(count: NonZeroUsize) -> io::Result<Self> {
        let runtime =
            Builder::new_multi_thread().worker_threads(count.get()).thread_name("io").enable_all().build()?;
        Ok(Self { handle: runtime.handle().clone(), runtime: Some(runtime) })
    }

    /// Returns the handle with which tasks are started on these threads.
    pub(crate) const fn handle(&self) -> &Handle {
        &self.handle
    }

    /// Wraps a future in the context of this runtime. The sockets and tasks that it creates belong to the I/O threads,
    /// no matter which thread polls the future.
    pub(crate) fn with_context<F: Future>(&self, future: F) -> TokioContext<F> {
        TokioContext::new(future, self.handle().clone())
    }
}

impl Drop for IoThreads {
    fn drop(&mut self) {
        // Dropping a runtime waits for its threads, which panics inside an asynchronous task.
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
    async fn tasks_and_sockets_belong_to_io_threads() {
        let io = IoThreads::start(NonZeroUsize::MIN).expect("there are threads");
        let test_thread = thread::current().id();
        let task =
            io.handle().spawn(async { (thread::current().id(), thread::current().name() == Some("io")) });
        let (thread, is_named) = task.await.expect("the task ran");
        assert!(is_named && thread != test_thread);
        let spawn_task = async { tokio::spawn(async { thread::current().id() }).await };
        assert_eq!(io.with_context(spawn_task).await.expect("it ran"), thread, "the only I/O thread");
    }

    #[tokio::test]
    async fn dropping_io_threads_cancels_running_tasks() {
        let io = IoThreads::start(NonZeroUsize::MIN).expect("there are threads");
        let socket = io.with_context(UdpSocket::bind("127.0.0.1:0")).await.expect("there is a port");
        let waiting = io.handle().spawn(async move {
            let _ = socket.recv(&mut [0]).await;
        });
        drop(io);
        assert!(waiting.await.expect_err("it did not finish").is_cancelled());
    }
}
