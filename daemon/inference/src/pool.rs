//! A loaded model and the threads that run it.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_logger::Slug;

use crate::queue::{Queue, Rejection};
use crate::thread::{Station, deliver};
use crate::{Done, InferenceError, Job, LoadError, Model, Refused};

/// A loaded model with its workers, shared by all who use it.
///
/// Dropping the last handle, or [`shutdown`](Self::shutdown), ends the threads: each finishes the sample it is
/// at; whoever still waits gets [`InferenceError::Stopped`].
pub struct Pool {
    name: Slug,
    model: Arc<dyn Model>,
    loaded_in: Span,
    workers: usize,
    means: Means,
    /// What is told of it beside what the model tells.
    beside: Vec<(String, String)>,
}

/// How jobs are run.
enum Means {
    /// On threads of its own, behind a queue.
    Threads { queue: Arc<Queue<Job>>, handles: Mutex<Vec<JoinHandle<()>>> },
    /// On the thread of whoever submits: for models that neither block nor compute for long.
    Inline(Mutex<Station>),
}

impl Pool {
    /// Builds the workers and starts their threads; `begun` is when the loading of the model began.
    pub(crate) fn start(
        name: Slug,
        model: Arc<dyn Model>,
        sizes: Sizes,
        clock: &SharedClock,
        begun: MonoTime,
    ) -> Result<Self, LoadError> {
        let station = |_| {
            let worker = Some(model.worker()?);
            Ok(Station { name: name.clone(), model: Arc::clone(&model), clock: Arc::clone(clock), worker })
        };
        let workers = if model.blocks() { sizes.workers } else { 1 };
        let mut stations = (0..workers).map(station).collect::<Result<Vec<_>, LoadError>>()?;
        let means = match stations.pop() {
            Some(station) if !model.blocks() => Means::Inline(Mutex::new(station)),
            last => {
                stations.extend(last);
                Means::threads(&name, stations, sizes.queue)?
            }
        };
        Ok(Self { loaded_in: clock.mono() - begun, name, model, workers, means, beside: Vec::new() })
    }

    /// The same, with more to tell.
    pub(crate) fn telling(mut self, facts: Vec<(String, String)>) -> Self {
        self.beside = facts;
        self
    }

    /// Hands a job over and returns at once; for a model that does not [block](Model::blocks) the reply has
    /// been called by then, on this thread.
    ///
    /// # Errors
    /// Gives the job back when the queue is full or the pool is shut down.
    pub fn submit(&self, job: Job) -> Result<(), Refused> {
        match &self.means {
            Means::Inline(station) => {
                // Not under the lock: the reply may well submit the next job.
                let (reply, done) = station.lock().unwrap_or_else(PoisonError::into_inner).compute(job);
                deliver(&self.name, reply, done);
                Ok(())
            }
            Means::Threads { queue, .. } => queue.push(job).map_err(|(job, why)| {
                let model = self.name.to_string();
                let reason = match why {
                    Rejection::Full => InferenceError::QueueFull { model, capacity: queue.capacity() },
                    Rejection::Closed => InferenceError::Stopped { model },
                };
                Refused { job: Box::new(job), reason }
            }),
        }
    }

    /// Ends the threads and waits for the samples they are at; answers all that wait with
    /// [`InferenceError::Stopped`]. Blocks: not for an I/O thread.
    pub fn shutdown(&self) {
        let Means::Threads { queue, handles } = &self.means else { return };
        for Job { log, reply, .. } in queue.close() {
            let result = Err(InferenceError::Stopped { model: self.name.to_string() });
            deliver(&self.name, reply, Done { log, result });
        }
        let handles = std::mem::take(&mut *handles.lock().unwrap_or_else(PoisonError::into_inner));
        for handle in handles {
            // The last handle of a pool may be dropped by a reply, on one of the pool's own threads.
            if handle.thread().id() != thread::current().id() && handle.join().is_err() {
                tracing::error!(model = %self.name, "a thread of the model had panicked");
            }
        }
    }

    /// The name under which the model is offered.
    pub fn name(&self) -> &Slug {
        &self.name
    }

    /// The device it really runs on, such as `cpu` or `cuda:0`.
    pub fn device(&self) -> String {
        self.model.device()
    }

    /// What it is, in words, for the run's page.
    pub fn facts(&self) -> Vec<(String, String)> {
        self.model.facts().into_iter().chain(self.beside.iter().cloned()).collect()
    }

    /// Whether jobs run on threads of their own; otherwise [`submit`](Self::submit) computes at once.
    pub fn blocks(&self) -> bool {
        self.model.blocks()
    }

    /// How long loading the model and building its workers took.
    pub fn loaded_in(&self) -> Span {
        self.loaded_in
    }

    /// How many samples are computed on at a time.
    pub fn workers(&self) -> usize {
        self.workers
    }

    /// How many samples wait for a free worker now.
    pub fn waiting(&self) -> usize {
        match &self.means {
            Means::Threads { queue, .. } => queue.len(),
            Means::Inline(_) => 0,
        }
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        self.shutdown();
    }
}

impl fmt::Debug for Pool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Pool")
            .field("name", &self.name)
            .field("workers", &self.workers)
            .finish_non_exhaustive()
    }
}

/// How many threads and how many waiting jobs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sizes {
    pub(crate) workers: usize,
    pub(crate) queue: usize,
}

impl Means {
    fn threads(name: &Slug, stations: Vec<Station>, capacity: usize) -> Result<Self, LoadError> {
        let queue = Arc::new(Queue::new(capacity));
        let mut handles = Vec::with_capacity(stations.len());
        for (index, mut station) in stations.into_iter().enumerate() {
            let jobs = Arc::clone(&queue);
            // The kernel shows 15 characters: the number first, so that threads can be told apart.
            let thread = thread::Builder::new().name(format!("{index}-{name}"));
            match thread.spawn(move || station.serve(&jobs)) {
                Ok(handle) => handles.push(handle),
                Err(error) => {
                    queue.close();
                    return Err(LoadError::Thread { model: name.to_string(), reason: error.to_string() });
                }
            }
        }
        Ok(Self::Threads { queue, handles: Mutex::new(handles) })
    }
}

#[cfg(test)]
mod tests;
