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

/// Longest text, bytes (64 MiB). The limit is lower than the limit of `synthetic`, because each text is generated for its
/// sample.
const MAX_LENGTH: usize = 64 << 20;

/// Configuration of the sensor: `{ kind = "text", … }`. Each sample is another text; the paper's program calls this
/// "random string".
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextConfig {
    /// Number of characters of every sample, one byte each.
    pub length: usize,
    /// Seed of the text. Default: 1.
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
        Ok(Box::new(Text { length: self.length, random: StdRng::seed_from_u64(self.seed) }))
    }
}

impl SensorConfig {
    /// Returns the configuration of random texts of this number of characters.
    pub fn random_text(length: usize) -> Self {
        TextConfig { length, seed: default_seed() }.into()
    }
}

/// Letters and digits of the configured number, another text each time.
struct Text {
    length: usize,
    random: StdRng,
}

impl Sensor for Text {
    fn sample(&mut self, _log: &mut Recorder) -> Result<Option<Sample>, SensorError> {
        let text = Alphanumeric.sample_string(&mut self.random, self.length);
        Ok(Some(Sample::from_part(Description::unshaped(MediaType::Text), text.into())))
    }

    // A long text is generated on another thread, because generating it takes longer than waking that thread.
    fn blocks(&self) -> bool {
        self.length > 4096
    }

    fn facts(&self) -> Vec<(String, String)> {
        vec![("Sensor".to_owned(), format!("random text of {} characters", self.length))]
    }
}
