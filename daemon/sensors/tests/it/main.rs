//! Tests of sensors on real folders and of transforms on real pictures.

mod exec;
mod images;
mod python;
mod synthetic;
mod text;
mod transforms;

use std::sync::Arc;

use peernet_clock::{ClockIdentity, ManualClock, SharedClock, SystemClock, WallTime};
use peernet_logger::{HostId, Recorder};
use peernet_sample::Sample;
use peernet_sensors::{Sensor, SensorError};

fn clock() -> SharedClock {
    Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "clock")))
}

/// Returns a real clock, for tests that wait for processes.
fn real_clock() -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::new("boot", "clock")))
}

fn recorder() -> Recorder {
    Recorder::new(clock(), HostId::random())
}

fn next(sensor: &mut dyn Sensor) -> Result<Option<Sample>, SensorError> {
    sensor.sample(&mut recorder())
}

/// Returns the sources of the next `count` samples.
fn sources(sensor: &mut dyn Sensor, count: usize) -> Vec<String> {
    (0..count).map(|_| next(sensor).expect("is readable").expect("goes on").source).collect()
}
