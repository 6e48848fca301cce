//! The sensor and the transforms of a pipeline, on the thread that suits them.

use std::io;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

use peernet_logger::{Recorder, Slug, stage};
use peernet_sample::Sample;
use peernet_sensors::{Sensor, SensorError, Transform};
use tokio::sync::oneshot;

/// What the sensor yielded, and the recorder with `sensing` in it. `Ok(None)` when it has ended.
pub(super) struct Sensed {
    pub(super) log: Recorder,
    pub(super) sample: Result<Option<Sample>, SensorError>,
}

/// The sensor and the transforms after it.
pub(super) struct Chain {
    pub(super) sensor: Box<dyn Sensor>,
    pub(super) transforms: Vec<Box<dyn Transform>>,
}

/// How the chain is run.
pub(super) enum Senses {
    /// In the pipeline's own task: it neither blocks nor computes, and a thread would only cost two hops.
    Inline(Chain),
    /// On a thread of its own, named after the pipeline.
    Thread(SyncSender<Order>),
}

/// A sample under way.
#[expect(clippy::large_enum_variant, reason = "lives for a moment; boxing would allocate once an iteration")]
pub(super) enum Sensing {
    Done(Sensed),
    Pending(oneshot::Receiver<Sensed>),
}

/// What the thread is asked for.
pub(super) struct Order {
    log: Recorder,
    reply: oneshot::Sender<Sensed>,
}

impl Chain {
    /// Asks the sensor for a sample and transforms it, recording `sensing` with `capture` and `transform`.
    fn run(&mut self, mut log: Recorder) -> Sensed {
        let sample = self.sample(&mut log);
        Sensed { log, sample }
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

impl Senses {
    /// Finds the right place for a chain.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub(super) fn new(chain: Chain, pipeline: &Slug) -> io::Result<Self> {
        if !chain.sensor.blocks() && chain.transforms.is_empty() {
            return Ok(Self::Inline(chain));
        }
        let (orders, taken) = sync_channel(1);
        thread::Builder::new().name(pipeline.to_string()).spawn(move || serve(chain, &taken))?;
        Ok(Self::Thread(orders))
    }

    /// Begins a sample; there is never more than one under way.
    pub(super) fn begin(&mut self, log: Recorder) -> Sensing {
        match self {
            Self::Inline(chain) => Sensing::Done(chain.run(log)),
            Self::Thread(orders) => {
                let (reply, sensed) = oneshot::channel();
                // When the thread is gone the order is dropped, and with it `reply`: the receiver learns of it.
                let _ = orders.try_send(Order { log, reply });
                Sensing::Pending(sensed)
            }
        }
    }
}

/// The thread: ends when the pipeline does.
fn serve(mut chain: Chain, orders: &Receiver<Order>) {
    while let Ok(Order { log, reply }) = orders.recv() {
        // A pipeline that has stopped in between does not want the sample any more.
        let _ = reply.send(chain.run(log));
    }
}
