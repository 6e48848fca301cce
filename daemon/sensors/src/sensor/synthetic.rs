//! `synthetic`: random bytes.

use bytes::Bytes;
use peernet_clock::SharedClock;
use peernet_logger::Recorder;
use peernet_sample::{Description, Sample};
use rand::rngs::StdRng;
use rand::{RngCore, SeedableRng};
use serde::{Deserialize, Serialize};

use super::{SensorConfig, SensorKind, default_seed};
use crate::{Sensor, SensorError};

/// The largest payload: 1 GiB.
const MAX_BYTES: usize = 1 << 30;

/// `{ kind = "synthetic", … }`: made once per size, so that a sample costs nothing.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SyntheticConfig {
    /// Payload of every sample, in bytes. Give this or `sizes_bytes`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size_bytes: Option<usize>,
    /// Payloads of successive samples, in bytes, over and over: a size sweep.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sizes_bytes: Vec<usize>,
    /// What the bytes follow from.
    #[serde(default = "default_seed")]
    pub seed: u64,
}

impl SensorKind for SyntheticConfig {
    fn open(&self, _clock: &SharedClock) -> Result<Box<dyn Sensor>, SensorError> {
        let wrong = |reason: &str| Err(SensorError::Config(format!("a synthetic sensor {reason}")));
        let sizes = match self.size_bytes {
            Some(_) if !self.sizes_bytes.is_empty() => {
                return wrong("takes size_bytes or sizes_bytes, not both");
            }
            Some(ref size) => std::slice::from_ref(size),
            None => &self.sizes_bytes,
        };
        let largest = match sizes.iter().max() {
            Some(&largest) if largest <= MAX_BYTES => largest,
            Some(_) => return wrong("gives at most 1073741824 bytes a sample: lower its size"),
            None => return wrong("needs size_bytes or sizes_bytes"),
        };
        let mut buffer = vec![0; largest];
        StdRng::seed_from_u64(self.seed).fill_bytes(&mut buffer);
        let buffer = Bytes::from(buffer);
        let payloads = sizes.iter().map(|size| buffer.slice(..*size)).collect();
        Ok(Box::new(Synthetic { payloads, next: 0 }))
    }
}

impl SensorConfig {
    /// Random payloads of one size in bytes.
    pub fn random_bytes(size: usize) -> Self {
        SyntheticConfig { size_bytes: Some(size), sizes_bytes: Vec::new(), seed: default_seed() }.into()
    }

    /// Random payloads of these sizes in bytes, one after the other, over and over.
    pub fn size_sweep(sizes_bytes: Vec<usize>) -> Self {
        SyntheticConfig { size_bytes: None, sizes_bytes, seed: default_seed() }.into()
    }
}

/// Payloads of given sizes in turn, all of them the beginning of one random buffer.
struct Synthetic {
    payloads: Vec<Bytes>,
    next: usize,
}

impl Sensor for Synthetic {
    fn sample(&mut self, _log: &mut Recorder) -> Result<Option<Sample>, SensorError> {
        let payload = self.payloads[self.next].clone();
        self.next = (self.next + 1) % self.payloads.len();
        Ok(Some(Sample::of(Description::bytes(), payload)))
    }

    fn blocks(&self) -> bool {
        false
    }

    fn facts(&self) -> Vec<(String, String)> {
        let sizes: Vec<_> = self.payloads.iter().map(|payload| payload.len().to_string()).collect();
        vec![("Sensor".to_owned(), format!("random payloads of {} bytes", sizes.join(", ")))]
    }
}
