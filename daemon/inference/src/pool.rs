//! A loaded model and the threads that run it.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use peernet_clock::{MonoTime, SharedClock, Span};
use peernet_logger::Slug;

use crate::blockage_detector::{BlockageDetector, CurrentComputation};
use crate::loaded_models::{CountedModel, LoadedModelCounter};
use crate::queue::{Queue, Rejection};
use crate::thread::{WorkerSlot, deliver};
use crate::{FinishedJob, InferenceError, Job, LoadError, Model, RefusedJob};

/// Loaded model with its workers. All pipelines and sessions that use the model share this pool.
///
/// Dropping the last `Arc`, or [`shutdown`](Self::shutdown), ends the threads: each finishes its current sample;
/// waiting jobs get [`InferenceError::Stopped`].
pub struct Pool {
    name: Slug,
    model: Arc<dyn Model>,
    load_duration: Span,
    /// Growth of the process's resident memory while the model was loaded, bytes.
    memory_growth: Option<u64>,
    /// Counts this model as loaded until the pool is dropped.
    counted_model: Option<CountedModel>,
    loaded_at: MonoTime,
    workers: usize,
    execution: Execution,
    /// Facts in addition to the facts of the model.
    additional_facts: Vec<(String, String)>,
}

/// Threads on which jobs run.
enum Execution {
    /// On threads of the pool, which take jobs from a queue.
    Threads { queue: Arc<Queue<Job>>, handles: Mutex<Vec<JoinHandle<()>>>, blockage: BlockageDetector },
    /// On the thread of the caller: for models that neither block nor compute for long.
    Inline(Mutex<WorkerSlot>),
}

impl Pool {
    /// Creates the workers and starts their threads; `started_at` is the time at which loading the model started.
    pub(crate) fn start(
        name: Slug,
        model: Arc<dyn Model>,
        sizes: Sizes,
        clock: &SharedClock,
        started_at: MonoTime,
    ) -> Result<Self, LoadError> {
        let new_slot = |_| {
            let worker = Some(model.create_worker()?);
            let (name, model, clock) = (name.clone(), Arc::clone(&model), Arc::clone(clock));
            Ok(WorkerSlot {
                name,
                model,
                clock,
                worker,
                current_computation: Arc::<CurrentComputation>::default(),
            })
        };
        // A model that does not block runs on the thread of its caller, one sample at a time.
        let workers = if model.blocks() { sizes.workers } else { 1 };
        let mut slots = (0..workers).map(new_slot).collect::<Result<Vec<_>, LoadError>>()?;
        let execution = match slots.pop() {
            Some(slot) if !model.blocks() => Execution::Inline(Mutex::new(slot)),
            last_slot => {
                // The slot is put back: each slot gets a thread.
                slots.extend(last_slot);
                let computations = slots.iter().map(|slot| Arc::clone(&slot.current_computation)).collect();
                let blockage = BlockageDetector::new(computations, Arc::clone(clock));
                Execution::threads(&name, slots, sizes.queue, blockage)?
            }
        };
        let loaded_at = clock.mono();
        Ok(Self {
            load_duration: loaded_at - started_at,
            memory_growth: None,
            counted_model: None,
            loaded_at,
            name,
            model,
            workers,
            execution,
            additional_facts: Vec::new(),
        })
    }

    /// Sets the growth of the process's resident memory while the model was loaded, bytes, and counts the model as
    /// loaded.
    pub(crate) fn with_memory_growth(mut self, bytes: Option<u64>, counter: &LoadedModelCounter) -> Self {
        self.memory_growth = bytes;
        self.counted_model = Some(counter.count(bytes.unwrap_or(0)));
        self
    }

    /// Adds facts to the facts of the model.
    pub(crate) fn with_facts(mut self, facts: Vec<(String, String)>) -> Self {
        self.additional_facts = facts;
        self
    }

    /// Submits a job and returns at once. For a model that does not [block](Model::blocks), the callback of the job
    /// runs on this thread, before `submit` returns.
    ///
    /// # Errors
    /// Returns the job if the queue is full or the pool is shut down.
    pub fn submit(&self, job: Job) -> Result<(), RefusedJob> {
        match &self.execution {
            Execution::Inline(slot) => {
                // The reply is called without the lock, because it may submit the next job.
                let mut slot = slot.lock().unwrap_or_else(PoisonError::into_inner);
                let taken_at = slot.clock.mono();
                let finished = slot.compute(vec![job], taken_at);
                drop(slot);
                for (reply, finished_job) in finished {
                    deliver(&self.name, reply, finished_job);
                }
                Ok(())
            }
            Execution::Threads { queue, blockage, .. } => {
                // In a blockage, all workers compute cancelled requests, and other requests wait. A blockage delays
                // only submitted requests. Therefore a check at each submission is enough, and no timer is needed.
                blockage.check(&self.name);
                if queue.is_full() {
                    self.drop_cancelled(queue);
                }
                queue.push(job).map_err(|(job, rejection)| {
                    let model = self.name.to_string();
                    let reason = match rejection {
                        Rejection::Full => InferenceError::QueueFull { model, capacity: queue.capacity() },
                        Rejection::Closed => InferenceError::Stopped { model },
                    };
                    RefusedJob { job: Box::new(job), reason }
                })
            }
        }
    }

    /// Answers the waiting jobs that were cancelled, which frees their places in the queue.
    // Otherwise the cancelled jobs would keep their places until a worker takes them, and a worker may compute for
    // long.
    fn drop_cancelled(&self, queue: &Queue<Job>) {
        for Job { recorder, reply, .. } in queue.remove(|job| job.requester.cancellation().is_cancelled()) {
            let result = Err(InferenceError::Cancelled { model: self.name.to_string() });
            deliver(&self.name, reply, FinishedJob { recorder, result });
        }
    }

    /// Ends the threads after their current samples, and answers all waiting jobs with [`InferenceError::Stopped`].
    /// Blocks, so that it must not be called on an I/O thread.
    pub fn shutdown(&self) {
        let Execution::Threads { queue, handles, .. } = &self.execution else { return };
        for Job { recorder, reply, .. } in queue.close() {
            let result = Err(InferenceError::Stopped { model: self.name.to_string() });
            deliver(&self.name, reply, FinishedJob { recorder, result });
        }
        let handles = std::mem::take(&mut *handles.lock().unwrap_or_else(PoisonError::into_inner));
        for handle in handles {
            // The callback of a job may drop the last `Arc` of the pool on one of the pool's own threads, which
            // cannot join itself.
            if handle.thread().id() != thread::current().id() && handle.join().is_err() {
                tracing::error!(model = %self.name, "a thread of the model panicked");
            }
        }
    }

    /// Returns the name under which the model is offered.
    pub fn name(&self) -> &Slug {
        &self.name
    }

    /// Returns the device on which the model runs, such as `cpu` or `cuda:0`.
    pub fn device(&self) -> String {
        self.model.device()
    }

    /// Returns facts for the run's page.
    pub fn facts(&self) -> Vec<(String, String)> {
        self.model.facts().into_iter().chain(self.additional_facts.iter().cloned()).collect()
    }

    /// Returns whether jobs run on threads of the pool; otherwise [`submit`](Self::submit) computes at once.
    pub fn runs_on_threads(&self) -> bool {
        self.model.blocks()
    }

    /// Returns the duration of loading the model and creating its workers.
    pub fn load_duration(&self) -> Span {
        self.load_duration
    }

    /// Returns the time at which the model was loaded.
    pub(crate) fn loaded_at(&self) -> MonoTime {
        self.loaded_at
    }

    /// Returns the growth of this process's resident memory while the model was loaded, bytes; `None` if it is
    /// unknown. Memory of a GPU and of child processes is not included. Memory that other threads allocated meanwhile
    /// is included.
    pub fn memory_growth(&self) -> Option<u64> {
        self.memory_growth
    }

    /// Returns the number of workers, each of which computes one sample or one batch at a time.
    pub fn workers(&self) -> usize {
        self.workers
    }

    /// Returns the age of the oldest computation if every worker computes only cancelled requests, so that all other
    /// requests wait. `None` if a worker is free or computes a request that is not cancelled.
    pub fn blocked_for(&self) -> Option<Span> {
        match &self.execution {
            Execution::Threads { blockage, .. } => blockage.duration(),
            Execution::Inline(_) => None,
        }
    }

    /// Returns the number of samples that wait for a free worker.
    pub fn waiting_samples(&self) -> usize {
        match &self.execution {
            Execution::Threads { queue, .. } => queue.len(),
            Execution::Inline(_) => 0,
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

/// Number of worker threads and capacity of the queue.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sizes {
    pub(crate) workers: usize,
    pub(crate) queue: usize,
}

impl Execution {
    fn threads(
        name: &Slug,
        slots: Vec<WorkerSlot>,
        capacity: usize,
        blockage: BlockageDetector,
    ) -> Result<Self, LoadError> {
        let queue = Arc::new(Queue::new(capacity));
        let mut handles = Vec::with_capacity(slots.len());
        for (index, mut slot) in slots.into_iter().enumerate() {
            let jobs = Arc::clone(&queue);
            // The number comes first, because the kernel keeps only 15 characters of a thread's name.
            let thread = thread::Builder::new().name(format!("{index}-{name}"));
            match thread.spawn(move || slot.serve(&jobs)) {
                Ok(handle) => handles.push(handle),
                Err(error) => {
                    // Otherwise the threads that have started would wait for jobs for ever.
                    queue.close();
                    return Err(LoadError::Thread { model: name.to_string(), reason: error.to_string() });
                }
            }
        }
        Ok(Self::Threads { queue, handles: Mutex::new(handles), blockage })
    }
}

#[cfg(test)]
mod tests;
