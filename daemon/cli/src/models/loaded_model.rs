//! A loaded model, whose stages are timed as in an agent.

use std::sync::Arc;
use std::sync::mpsc::sync_channel;

use crate::clock;
use crate::exit::{Exit, Failure};
use peernet_clock::{ClockIdentity, SharedClock};
use peernet_inference::bank::ModelOnDisk;
use peernet_inference::{Bank, BankConfig, InferenceError, Job, OnnxRuntimeConfig, Pool};
use peernet_logger::{HostId, Recorder, Tree};
use peernet_sample::Sample;

use super::failure;

/// Options for loading a model.
#[derive(Debug, clap::Args)]
pub(super) struct Options {
    /// The device: cpu, cuda:N, tensorrt:N or openvino:DEVICE.
    #[arg(long, default_value = "cpu")]
    device: String,
    /// Threads within one operator of the model, as `intra_threads` of a [[model]].
    #[arg(long, value_name = "N", default_value = "1")]
    pub(super) intra_threads: std::num::NonZeroUsize,
}

/// A loaded model with one worker.
pub(super) struct LoadedModel {
    pool: Arc<Pool>,
    clock: SharedClock,
    host: HostId,
}

impl LoadedModel {
    /// Loads the model, which also runs it on zeros once.
    pub(super) fn load(model: &ModelOnDisk, options: &Options) -> Result<Self, Failure> {
        let clock =
            clock::system(ClockIdentity::SYSTEM).map_err(|error| Failure::new(Exit::Unavailable, error))?;
        let settings = BankConfig { intra_threads: options.intra_threads, ..BankConfig::default() };
        let config = settings.model(&model.name, &model.folder, &options.device);
        let bank = Bank::new(vec![config], OnnxRuntimeConfig::default(), Arc::clone(&clock));
        if let Some((_, error)) = bank.check().into_iter().next() {
            return Err(failure(error));
        }
        let configured_device = None;
        let pool = bank.load(&model.name, configured_device).map_err(failure)?;
        Ok(Self { pool, clock, host: HostId::random() })
    }

    /// Returns the pool that runs the model.
    pub(super) fn pool(&self) -> &Pool {
        &self.pool
    }

    /// Returns this machine's clock.
    pub(super) fn clock(&self) -> &SharedClock {
        &self.clock
    }

    /// Returns the answer to a sample with its measurements.
    pub(super) fn infer(&self, sample: Sample) -> (Result<Sample, InferenceError>, Tree) {
        let (sender, receiver) = sync_channel(1);
        // Sending fails only if this function has panicked.
        let reply = Box::new(move |result| drop(sender.send(result)));
        let recorder = Recorder::new(Arc::clone(&self.clock), self.host);
        let received = self.clock.mono();
        if let Err(rejected) = self.pool.submit(Job::for_whole_answer(sample, recorder, received, reply)) {
            return (Err(rejected.reason), rejected.job.recorder.finish());
        }
        match receiver.recv() {
            Ok(finished) => (finished.result, finished.recorder.finish()),
            Err(_) => {
                let reason = "its thread dropped the sample".to_owned();
                let recorder = Recorder::new(Arc::clone(&self.clock), self.host);
                let model = self.pool.name().to_string();
                (Err(InferenceError::Failed { model, reason }), recorder.finish())
            }
        }
    }
}
