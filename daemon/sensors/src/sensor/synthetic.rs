//! `synthetic`: random bytes.

use bytes::Bytes;
use peernet_logger::Recorder;
use peernet_sample::{Description, Sample};
use rand::rngs::StdRng;
use rand::{RngCore, SeedableRng};

use crate::{Sensor, SensorError};

/// The largest payload: 1 GiB.
const MAX_BYTES: usize = 1 << 30;

/// Payloads of given sizes in turn, all of them the beginning of one random buffer.
pub(super) struct Synthetic {
    payloads: Vec<Bytes>,
    next: usize,
}

impl Synthetic {
    pub(super) fn open(size: Option<usize>, sizes: &[usize], seed: u64) -> Result<Self, SensorError> {
        let wrong = |reason: &str| Err(SensorError::Config(format!("a synthetic sensor {reason}")));
        let one;
        let sizes = match size {
            Some(_) if !sizes.is_empty() => return wrong("takes size_bytes or sizes_bytes, not both"),
            Some(size) => {
                one = [size];
                &one
            }
            None => sizes,
        };
        let largest = match sizes.iter().max() {
            Some(&largest) if largest <= MAX_BYTES => largest,
            Some(_) => return wrong("gives at most 1073741824 bytes a sample: lower its size"),
            None => return wrong("needs size_bytes or sizes_bytes"),
        };
        let mut buffer = vec![0; largest];
        StdRng::seed_from_u64(seed).fill_bytes(&mut buffer);
        let buffer = Bytes::from(buffer);
        Ok(Self { payloads: sizes.iter().map(|size| buffer.slice(..*size)).collect(), next: 0 })
    }
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
