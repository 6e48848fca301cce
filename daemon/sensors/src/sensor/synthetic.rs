//! Sensor kind `synthetic`: random bytes.

use bytes::Bytes;
use peernet_clock::SharedClock;
use peernet_external::exec::MAX_SAMPLE_BYTES;
use peernet_logger::Recorder;
use peernet_sample::{Description, Sample};
use rand::rngs::StdRng;
use rand::{RngCore, SeedableRng};
use serde::{Deserialize, Serialize};

use super::{SensorConfig, SensorKind, default_seed};
use crate::{Sensor, SensorError};

/// Configuration of the sensor: `{ kind = "synthetic", … }`. The sensor creates the payloads when it is opened, so that
/// capturing a sample takes almost no time.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SyntheticConfig {
    /// Payload size of every sample, bytes. Either `size_bytes` or `sizes_bytes` must be given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size_bytes: Option<usize>,
    /// Payload sizes of successive samples, bytes. After the last size the list begins again.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sizes_bytes: Vec<usize>,
    /// Seed of the random bytes. Default: 1.
    #[serde(default = "default_seed")]
    pub seed: u64,
}

impl SensorKind for SyntheticConfig {
    fn open(&self, _clock: &SharedClock) -> Result<Box<dyn Sensor>, SensorError> {
        let config_error = |reason: &str| Err(SensorError::Config(format!("a synthetic sensor {reason}")));
        let sizes = match self.size_bytes {
            Some(_) if !self.sizes_bytes.is_empty() => {
                return config_error("takes size_bytes or sizes_bytes, not both");
            }
            Some(ref size) => std::slice::from_ref(size),
            None => &self.sizes_bytes,
        };
        let largest = match sizes.iter().max() {
            Some(&largest) if largest as u64 <= MAX_SAMPLE_BYTES => largest,
            Some(_) => return config_error("produces at most 1073741824 bytes per sample; lower its size"),
            None => return config_error("needs size_bytes or sizes_bytes"),
        };
        // All payloads are slices of one buffer, so that many sizes take no more memory than the largest size.
        let mut buffer = vec![0; largest];
        StdRng::seed_from_u64(self.seed).fill_bytes(&mut buffer);
        let buffer = Bytes::from(buffer);
        let payloads = sizes.iter().map(|size| buffer.slice(..*size)).collect();
        Ok(Box::new(SyntheticSensor { payloads, next: 0 }))
    }
}

impl SensorConfig {
    /// Returns the configuration of random payloads of one size, bytes.
    pub fn random_bytes(size: usize) -> Self {
        SyntheticConfig { size_bytes: Some(size), sizes_bytes: Vec::new(), seed: default_seed() }.into()
    }

    /// Returns the configuration of random payloads with the sizes in this list, bytes. After the last size the list
    /// begins again.
    pub fn size_sweep(sizes_bytes: Vec<usize>) -> Self {
        SyntheticConfig { size_bytes: None, sizes_bytes, seed: default_seed() }.into()
    }
}

/// Sensor with one payload for each size. All payloads are the beginning of the same random bytes.
struct SyntheticSensor {
    payloads: Vec<Bytes>,
    next: usize,
}

impl Sensor for SyntheticSensor {
    fn sample(&mut self, _recorder: &mut Recorder) -> Result<Option<Sample>, SensorError> {
        let payload = self.payloads[self.next].clone();
        self.next = (self.next + 1) % self.payloads.len();
        Ok(Some(Sample::from_part(Description::bytes(), payload)))
    }

    // A sample is a slice of the buffer and copies no bytes.
    fn blocks(&self) -> bool {
        false
    }

    fn facts(&self) -> Vec<(String, String)> {
        let sizes: Vec<_> = self.payloads.iter().map(|payload| payload.len().to_string()).collect();
        vec![("Sensor".to_owned(), format!("random payloads of {} bytes", sizes.join(", ")))]
    }
}
