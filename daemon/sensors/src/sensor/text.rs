//! Sensor kind `text`: random letters and digits.

use peernet_clock::SharedClock;
use peernet_logger::Recorder;
use peernet_sample::{Description, MediaType, Sample};
use rand::SeedableRng;
use rand::distr::{Alphanumeric, SampleString};
use rand::rngs::StdRng;
use serde::{Deserialize, Serialize};

use super::{SensorConfig, SensorKind, default_seed};
use crate::{Sensor, SensorError};

/// Longest text, bytes (64 MiB).
// The limit is lower than that of `synthetic`, because this sensor generates a new text for each sample.
const MAX_LENGTH: usize = 64 << 20;

/// Configuration of the sensor: `{ kind = "text", … }`. Each sample is a new random text; the paper's program calls
/// it "random string".
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextConfig {
    /// Number of characters of every sample, one byte each.
    pub length: usize,
    /// Seed of the random texts. Default: 1.
    #[serde(default = "default_seed")]
    pub seed: u64,
}

impl SensorKind for TextConfig {
    fn open(&self, _clock: &SharedClock) -> Result<Box<dyn Sensor>, SensorError> {
        if self.length > MAX_LENGTH {
            return Err(SensorError::Config(format!(
                "a text sensor produces at most {MAX_LENGTH} characters per sample; lower its length"
            )));
        }
        Ok(Box::new(TextSensor { length: self.length, random: StdRng::seed_from_u64(self.seed) }))
    }
}

impl SensorConfig {
    /// Returns the configuration of random texts of `length` characters.
    pub fn random_text(length: usize) -> Self {
        TextConfig { length, seed: default_seed() }.into()
    }
}

/// Sensor that generates a new text of letters and digits for each sample.
struct TextSensor {
    length: usize,
    random: StdRng,
}

impl Sensor for TextSensor {
    fn sample(&mut self, _recorder: &mut Recorder) -> Result<Option<Sample>, SensorError> {
        let text = Alphanumeric.sample_string(&mut self.random, self.length);
        Ok(Some(Sample::from_part(Description::unshaped(MediaType::Text), text.into())))
    }

    // Generating a long text takes longer than waking another thread, which then generates it.
    fn blocks(&self) -> bool {
        self.length > 4096
    }

    fn facts(&self) -> Vec<(String, String)> {
        vec![("Sensor".to_owned(), format!("random text of {} characters", self.length))]
    }
}
