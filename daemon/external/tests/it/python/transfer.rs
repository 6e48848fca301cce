//! Transfer of values between PEERNet and a Python process: sizes, times and the end of the Python process.

use std::fs;
use std::path::Path;

use peernet_external::python::{CallTimes, Step};
use peernet_sample::{Description, ElementType, MediaType, Part};

use super::{Module, bytes, value};

const ECHO: &str = "
import os
class Own:
    def preprocess(self, x): return x
    def infer(self, x): return x
    def postprocess(self, x): return x
class Number:
    def sample(self): return os.getpid()
";

#[test]
fn payloads_of_any_size_cross_unchanged() {
    let mut model = Module::new(ECHO, "own::Own").model();
    for length in [0, 1, 65_527, 65_536, 1_200_000, 9_000_001] {
        let content: Vec<u8> = (0..length).map(|index: u32| (index ^ (index >> 8)) as u8).collect();
        let part = Part { description: Description::bytes(), bytes: content.into() };
        assert_eq!(value(&mut model, std::slice::from_ref(&part)), [part], "{length} bytes");
    }
}

#[test]
fn small_and_large_parts_are_transferred_together() {
    let source = "
class Own:
    def infer(self, x): return [b'small', x * 3, bytearray(4096), x]
";
    let mut model = Module::new(source, "own::Own").model();
    // Values of at least 4,096 bytes are passed in shared memory, shorter values in the pipe.
    for length in [4095, 4096, 700_000, 10] {
        let content = vec![length as u8; length];
        let part = Part { description: Description::bytes(), bytes: content.clone().into() };
        let answer: Vec<_> = value(&mut model, &[part]).into_iter().map(|part| part.bytes).collect();
        assert_eq!(answer, [b"small".to_vec(), content.repeat(3), vec![0; 4096], content], "{length} bytes");
    }
}

#[test]
fn kept_values_are_unchanged_by_next_call() {
    let source = "
class Own:
    def __init__(self): self.kept = []
    def infer(self, x):
        self.kept.append(x)
        return [self.kept[0], self.kept[0]]
";
    let mut model = Module::new(source, "own::Own").model();
    let part = |byte: u8| Part {
        description: Description {
            media: MediaType::Tensor,
            shape: vec![50_000],
            element: Some(ElementType::U8),
        },
        bytes: vec![byte; 50_000].into(),
    };
    for byte in 1..4 {
        let answer = value(&mut model, &[part(byte)]);
        assert!(answer.iter().all(|returned| *returned == part(1)), "call {byte}");
    }
}

#[test]
fn steps_lie_within_call_in_order() {
    let CallTimes { started_at, ended_at, steps, restart_began_at } =
        Module::new(ECHO, "own::Own").model().call(&[bytes(b"x")]).times;
    assert_eq!(
        steps.iter().map(|step| step.0).collect::<Vec<_>>(),
        [Step::Preprocess, Step::Infer, Step::Postprocess]
    );
    assert_eq!(restart_began_at, None);
    let stamps: Vec<_> = [started_at]
        .into_iter()
        .chain(steps.iter().flat_map(|step| [step.1, step.2]))
        .chain([ended_at])
        .collect();
    assert!(stamps.is_sorted(), "the worker and this process read the same clock: {stamps:?}");
}

#[test]
fn picture_decoding_counts_as_sensor_time() {
    let source = "
import time, PIL.Image
def slow():
    picture = PIL.Image.new('RGB', (2, 1))
    load = picture.load
    picture.load = lambda: (time.sleep(0.1), load())
    return picture
class One:
    def sample(self): return slow()
class Two:
    def sample(self): return [slow(), slow()]
class Named:
    def sample(self): return {'left': slow(), 'right': slow()}
";
    for (object, seconds) in [("own::One", 0.1), ("own::Two", 0.2), ("own::Named", 0.2)] {
        let sensor_call = Module::new(source, object).sensor().call(&[]);
        sensor_call.result.expect("pictures are transferred");
        let (_, from, to) = sensor_call.times.steps[0];
        assert!((to - from).seconds() >= seconds, "{object}: {:?}", to - from);
    }
}

#[test]
fn process_ends_with_its_object() {
    let mut sensor = Module::new(ECHO, "own::Number").sensor();
    let number = String::from_utf8(value(&mut sensor, &[])[0].bytes.to_vec()).expect("a number");
    let exists = || Path::new("/proc").join(&number).exists();
    assert!(exists());
    drop(sensor);
    assert!(!exists(), "dropping the object waits for the end of the process");
}

#[test]
fn configured_environment_and_folder_are_used() {
    let source = "
import os, pathlib
class Own:
    def sample(self): return [os.environ['WHO'], pathlib.Path('near.txt').read_text()]
";
    let mut module = Module::new(source, "own::Own");
    fs::write(module.folder.path().join("near.txt"), "near").expect("it can be written");
    module.config.env.insert("WHO".to_owned(), "me".to_owned());
    assert_eq!(value(&mut module.sensor(), &[])[0].bytes, r#"["me","near"]"#);
}
