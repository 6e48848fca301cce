//! `text`: random letters and digits.

use peernet_logger::Recorder;
use peernet_sample::{Description, MediaType, Sample};
use rand::SeedableRng;
use rand::distr::{Alphanumeric, SampleString};
use rand::rngs::StdRng;

use crate::{Sensor, SensorError};

/// The longest text: 64 MiB. It is made anew each time.
const MAX_LENGTH: usize = 64 << 20;

/// Letters and digits, as many as asked for, another text each time.
pub(super) struct Text {
    length: usize,
    random: StdRng,
}

impl Text {
    pub(super) fn open(length: usize, seed: u64) -> Result<Self, SensorError> {
        if length > MAX_LENGTH {
            return Err(SensorError::Config(format!(
                "a text sensor gives at most {MAX_LENGTH} characters a sample: lower its length"
            )));
        }
        Ok(Self { length, random: StdRng::seed_from_u64(seed) })
    }
}

impl Sensor for Text {
    fn sample(&mut self, _log: &mut Recorder) -> Result<Option<Sample>, SensorError> {
        let text = Alphanumeric.sample_string(&mut self.random, self.length);
        Ok(Some(Sample::of(Description::unshaped(MediaType::Text), text.into())))
    }

    /// A long text takes longer to make than a thread takes to be woken.
    fn blocks(&self) -> bool {
        self.length > 4096
    }

    fn facts(&self) -> Vec<(String, String)> {
        vec![("Sensor".to_owned(), format!("random text of {} characters", self.length))]
    }
}
