//! The border between two processes: sizes, times, ends.

use std::fs;
use std::path::Path;

use peernet_external::python::{Stage, Times};
use peernet_sample::{Description, Part};

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
        let content: Vec<u8> = (0..length).map(|at: u32| (at ^ (at >> 8)) as u8).collect();
        let part = Part { description: Description::bytes(), bytes: content.into() };
        assert_eq!(value(&mut model, std::slice::from_ref(&part)), [part], "{length} bytes");
    }
}

#[test]
fn stages_lie_within_the_call_and_the_rest_is_the_border() {
    let Times { begun, ended, stages } = Module::new(ECHO, "own::Own").model().call(&[bytes(b"x")]).times;
    assert_eq!(
        stages.iter().map(|one| one.0).collect::<Vec<_>>(),
        [Stage::Preprocess, Stage::Infer, Stage::Postprocess]
    );
    let moments: Vec<_> =
        [begun].into_iter().chain(stages.iter().flat_map(|one| [one.1, one.2])).chain([ended]).collect();
    assert!(moments.is_sorted(), "the clock of the worker is ours: {moments:?}");
}

#[test]
fn the_process_ends_with_its_object() {
    let mut sensor = Module::new(ECHO, "own::Number").sensor();
    let number = String::from_utf8(value(&mut sensor, &[])[0].bytes.to_vec()).expect("a number");
    let there = || Path::new("/proc").join(&number).exists();
    assert!(there());
    drop(sensor);
    assert!(!there(), "it was waited for");
}

#[test]
fn the_environment_and_the_folder_are_the_users() {
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
