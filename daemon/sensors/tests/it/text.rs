use peernet_sample::MediaType;
use peernet_sensors::sensor::text::TextConfig;
use peernet_sensors::{Sensor, SensorError, SensorKind};

use super::{clock, next};

fn text(length: usize, seed: u64) -> Result<Box<dyn Sensor>, SensorError> {
    TextConfig { length, seed }.open(&clock())
}

fn sample(sensor: &mut dyn Sensor) -> String {
    let sample = next(sensor).expect("cannot fail").expect("never ends");
    assert_eq!(sample.parts[0].description.media, MediaType::Text);
    String::from_utf8(sample.parts[0].bytes.to_vec()).expect("is text")
}

#[test]
fn seed_determines_texts_of_configured_length() {
    let texts_of = |seed| {
        let mut sensor = text(1000, seed).expect("opens");
        (sample(sensor.as_mut()), sample(sensor.as_mut()))
    };
    let (first, second) = texts_of(1);
    assert!(first.len() == 1000 && first.bytes().all(|byte| byte.is_ascii_alphanumeric()));
    assert_ne!(first, second);
    assert_eq!(texts_of(1), (first.clone(), second));
    assert_ne!(texts_of(2).0, first);
}

#[test]
fn length_is_bounded() {
    assert_eq!(sample(text(0, 1).expect("opens").as_mut()), "");
    assert!(text(usize::MAX, 1).err().expect("is refused").to_string().contains("at most"));
}
