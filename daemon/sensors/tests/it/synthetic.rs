use bytes::Bytes;
use peernet_sample::MediaType;
use peernet_sensors::sensor::synthetic::SyntheticConfig;
use peernet_sensors::{Sensor, SensorError, SensorKind};

use super::{clock, next};

fn synthetic(size: Option<usize>, sizes: &[usize], seed: u64) -> Result<Box<dyn Sensor>, SensorError> {
    SyntheticConfig { size_bytes: size, sizes_bytes: sizes.to_vec(), seed }.open(&clock())
}

fn payload(sensor: &mut dyn Sensor) -> Bytes {
    let sample = next(sensor).expect("cannot fail").expect("never ends");
    assert_eq!(sample.parts[0].description.media, MediaType::Bytes);
    sample.parts[0].bytes.clone()
}

#[test]
fn sizes_repeat_and_payloads_are_reused() {
    let mut sensor = synthetic(None, &[1000, 0, 70_000], 1).expect("opens");
    assert!(!sensor.blocks());
    let first: Vec<_> = (0..3).map(|_| payload(sensor.as_mut())).collect();
    assert_eq!(first.iter().map(Bytes::len).collect::<Vec<_>>(), [1000, 0, 70_000]);
    let second: Vec<_> = (0..3).map(|_| payload(sensor.as_mut())).collect();
    assert!(first.iter().zip(&second).all(|(a, b)| a.as_ptr() == b.as_ptr() && a.len() == b.len()));
}

#[test]
fn bytes_follow_from_seed_and_are_incompressible() {
    let payload_of = |seed| payload(synthetic(Some(4096), &[], seed).expect("opens").as_mut());
    assert_eq!(payload_of(1), payload_of(1));
    assert_ne!(payload_of(1), payload_of(2));
    let mut counts = [0u32; 256];
    payload_of(1).iter().for_each(|byte| counts[usize::from(*byte)] += 1);
    // On average, each of the 256 byte values occurs 16 times in 4096 bytes.
    assert!(counts.iter().all(|count| *count < 50), "{counts:?}");
}

#[test]
fn size_must_be_given_once() {
    let open_error = |size, sizes: &[usize]| synthetic(size, sizes, 1).err().expect("is refused").to_string();
    assert!(open_error(None, &[]).contains("needs size_bytes"));
    assert!(open_error(Some(1), &[1]).contains("not both"));
    assert!(open_error(Some(usize::MAX), &[]).contains("at most"));
}
