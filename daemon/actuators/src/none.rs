//! `none`: does nothing.

use peernet_logger::Recorder;
use peernet_sample::Sample;

use crate::{Actuator, ActuatorError};

pub(crate) struct Idle;

impl Actuator for Idle {
    fn act(&mut self, _source: &str, _answer: &Sample, _log: &mut Recorder) -> Result<(), ActuatorError> {
        Ok(())
    }
}
