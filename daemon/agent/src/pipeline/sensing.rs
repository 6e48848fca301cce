//! Runs the sensor and the transforms of a pipeline, inline or on a thread.

use std::convert::Infallible;
use std::io;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use peernet_logger::{Recorder, Slug, stage};
use peernet_sample::Sample;
use peernet_sensors::{Sensor, SensorError, Transform};
use tokio::sync::oneshot;

use super::preparation::Preparation;

/// Longest wait for the end of a sensor. A sensor that is custom code has a second to end and is then killed.
const END_TIMEOUT: Duration = Duration::from_secs(5);

/// Output of a sensor for one request.
pub(super) struct SensorOutput {
    /// The recorder with the node `sensing`.
    pub(super) log: Recorder,
    /// The transformed sample; `Ok(None)` if the sensor has no more samples.
    pub(super) sample: Result<Option<Sample>, SensorError>,
}

/// A sensor and the transforms that are applied to its samples, in order.
pub(super) struct SensorChain {
    pub(super) sensor: Box<dyn Sensor>,
    pub(super) transforms: Vec<Box<dyn Transform>>,
}

/// Runs a sensor and its transforms.
pub(super) enum SensorExecutor {
    /// In the pipeline's task, for a sensor that neither blocks nor computes: a thread would add two wake-ups.
    Inline(SensorChain),
    /// On a separate thread, named after the pipeline.
    Thread {
        requests: SyncSender<SensorRequest>,
        /// Closed when the thread has ended and the sensor is dropped.
        // `Infallible` has no values, so that the type shows that nothing is ever sent.
        ended: oneshot::Receiver<Infallible>,
    },
}

/// Response to a request for a sample.
#[expect(clippy::large_enum_variant, reason = "lives for a moment; boxing would allocate once an iteration")]
pub(super) enum SensorResponse {
    /// The sensor ran inline.
    Done(SensorOutput),
    /// The sensor's thread will send the output; the channel is closed if the thread has ended.
    Pending(oneshot::Receiver<SensorOutput>),
}

/// Request to the thread of a sensor.
pub(super) enum SensorRequest {
    /// Asks for one sample.
    Sample { log: Recorder, reply: oneshot::Sender<SensorOutput> },
    /// Prepares the sensor for the next sample.
    Prepare { preparation: Preparation, reply: oneshot::Sender<Result<(), SensorError>> },
}

/// Sender of one request for a preparation to the thread of the sensor.
pub(super) struct PreparationSender(SyncSender<SensorRequest>);

impl PreparationSender {
    /// Requests the preparation. The caller must have no other pending request. The receiver is closed if the thread
    /// has ended.
    pub(super) fn send(self, preparation: Preparation) -> oneshot::Receiver<Result<(), SensorError>> {
        let (reply, output) = oneshot::channel();
        // If the thread has ended, the request is dropped with `reply`.
        let _ = self.0.try_send(SensorRequest::Prepare { preparation, reply });
        output
    }
}

impl SensorChain {
    /// Takes a sample and transforms it. Records `sensing` with its children `capture` and `transform`.
    fn run(&mut self, mut log: Recorder) -> SensorOutput {
        let sample = self.sample(&mut log);
        SensorOutput { log, sample }
    }

    fn sample(&mut self, log: &mut Recorder) -> Result<Option<Sample>, SensorError> {
        let mut sensing = log.time(stage::SENSING);
        let captured = self.sensor.sample(&mut sensing.time(stage::CAPTURE))?;
        let Some(mut sample) = captured else { return Ok(None) };
        if self.transforms.is_empty() {
            return Ok(Some(sample));
        }
        let mut transform = sensing.time(stage::TRANSFORM);
        for step in &mut self.transforms {
            sample = step.apply(sample, &mut transform)?;
        }
        Ok(Some(sample))
    }
}

impl SensorExecutor {
    /// Starts a thread for the chain if the sensor blocks or the chain has transforms.
    ///
    /// # Errors
    /// When the operating system refuses a thread.
    pub(super) fn new(chain: SensorChain, pipeline: &Slug) -> io::Result<Self> {
        if !chain.sensor.blocks() && chain.transforms.is_empty() {
            return Ok(Self::Inline(chain));
        }
        // With a capacity of 0, `try_send` would fail while the thread does not wait for a request yet.
        let (requests, request_receiver) = sync_channel(1);
        let (end_signal, ended) = oneshot::channel();
        thread::Builder::new().name(pipeline.to_string()).spawn(move || {
            serve_requests(chain, &request_receiver);
            drop(end_signal);
        })?;
        Ok(Self::Thread { requests, ended })
    }

    /// Ends the sensor, and waits until it has released its resources, at most for [`END_TIMEOUT`].
    // The next start of the same sensor would otherwise find its port or its device in use.
    pub(super) async fn close(self, pipeline: &Slug) {
        let Self::Thread { requests, ended } = self else { return };
        drop(requests);
        if tokio::time::timeout(END_TIMEOUT, ended).await.is_err() {
            tracing::warn!(
                %pipeline,
                "the sensor has not ended within {} s; it may still hold its port or its device",
                END_TIMEOUT.as_secs()
            );
        }
    }

    /// Returns the sender of a request for a preparation; `None` for a sensor without a thread, which needs no
    /// preparation.
    pub(super) fn preparation_sender(&self) -> Option<PreparationSender> {
        match self {
            Self::Inline(_) => None,
            Self::Thread { requests, .. } => Some(PreparationSender(requests.clone())),
        }
    }

    /// Requests a sample. The caller must have no other pending request.
    pub(super) fn request_sample(&mut self, log: Recorder) -> SensorResponse {
        match self {
            Self::Inline(chain) => SensorResponse::Done(chain.run(log)),
            Self::Thread { requests, .. } => {
                let (reply, output) = oneshot::channel();
                // If the thread has ended, the request is dropped with `reply`, which closes the receiver.
                let _ = requests.try_send(SensorRequest::Sample { log, reply });
                SensorResponse::Pending(output)
            }
        }
    }
}

/// Serves requests until the pipeline drops its end of the channel.
fn serve_requests(mut chain: SensorChain, requests: &Receiver<SensorRequest>) {
    while let Ok(request) = requests.recv() {
        // The send fails if the pipeline has stopped in the meantime; the output is not needed then.
        match request {
            SensorRequest::Sample { log, reply } => {
                let _ = reply.send(chain.run(log));
            }
            SensorRequest::Prepare { preparation, reply } => {
                let _ = reply.send(match preparation {
                    // In this case only the actuator needs the reset.
                    Preparation::Reset if !chain.sensor.resets() => Ok(()),
                    Preparation::Reset => chain.sensor.reset(),
                    Preparation::Advance(time) => chain.sensor.advance(time),
                });
            }
        }
    }
}
