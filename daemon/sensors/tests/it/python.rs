use std::fs;

use peernet_external::python::PythonConfig;
use peernet_sensors::{SensorConfig, SensorKind};

use super::{real_clock, recorder};

const SENSOR: &str = "
class Own:
    def __init__(self): self.left = 3
    def sample(self):
        self.left -= 1
        if self.left == 1: raise OSError('no signal')
        if self.left == 0: raise StopIteration
        return b'one'
";

#[test]
fn samples_end_when_object_raises_stop_iteration() {
    let folder = tempfile::tempdir().expect("can be made");
    fs::write(folder.path().join("own.py"), SENSOR).expect("can be written");
    let config_of = |object: &str| {
        let folder = Some(folder.path().to_owned());
        SensorConfig::Python(PythonConfig { folder, ..PythonConfig::new(object) })
    };
    config_of("own::Own").check(&real_clock()).expect("is there");
    let missing = config_of("nowhere::Own").check(&real_clock()).expect_err("is not there").to_string();
    assert!(missing.contains("nowhere.py"), "{missing}");

    let mut sensor = config_of("own::Own").open(&real_clock()).expect("is there");
    assert!(sensor.blocks() && sensor.facts()[0].1.starts_with("the Python class own::Own"));
    let (name, file) = &sensor.facts()[2];
    assert!(name == "Sensor files" && file.contains("/own.py SHA-256 "), "{file}");
    let mut first_recorder = recorder();
    let sample = sensor.sample(&mut first_recorder).expect("no error").expect("a sample");
    assert_eq!((&sample.parts[0].bytes[..], sample.source.as_str()), (&b"one"[..], "own::Own"));
    assert!(first_recorder.tree().find(&["capture-ipc"]).is_some());
    let error = sensor.sample(&mut recorder()).expect_err("raises").to_string();
    assert!(error.contains("no signal") && error.contains("own.py"), "{error}");
    assert!(
        sensor.sample(&mut recorder()).expect("StopIteration is no error").is_none(),
        "there are no more samples"
    );
}

#[test]
fn restart_of_python_process_is_recorded() {
    let source = "
import os, time
time.sleep(0.3)
class Own:
    def __init__(self): self.taken = 0
    def sample(self):
        self.taken += 1
        return b'one' if self.taken < 3 else os._exit(4)
";
    let folder = tempfile::tempdir().expect("can be made");
    fs::write(folder.path().join("own.py"), source).expect("can be written");
    let folder = Some(folder.path().to_owned());
    let config = SensorConfig::Python(PythonConfig { folder, ..PythonConfig::new("own::Own") });
    let mut sensor = config.open(&real_clock()).expect("is there");
    // Each process gives two samples and exits at the third call.
    for (restarted, succeeds) in [(false, true), (false, true), (false, false), (true, true), (false, true)] {
        let mut recorder = recorder();
        assert_eq!(sensor.sample(&mut recorder).is_ok(), succeeds);
        let restart_seconds =
            recorder.tree().find(&["capture-restart"]).and_then(|(_, node)| node.measure.value());
        assert_eq!(restart_seconds.is_some_and(|seconds| seconds >= 0.3), restarted, "{restart_seconds:?}");
    }
}

#[test]
fn object_with_reset_method_is_reset() {
    let source = "
class Own:
    def __init__(self): self.episode = 0
    def reset(self): self.episode += 1
    def sample(self): return str(self.episode)
";
    let folder = tempfile::tempdir().expect("can be made");
    fs::write(folder.path().join("own.py"), source).expect("can be written");
    let folder = Some(folder.path().to_owned());
    let config = SensorConfig::Python(PythonConfig { folder, ..PythonConfig::new("own::Own") });
    let mut sensor = config.open(&real_clock()).expect("is there");
    assert!(sensor.resets());
    for expected in ["1", "2"] {
        sensor.reset().expect("is reset");
        let sample = sensor.sample(&mut recorder()).expect("no error").expect("a sample");
        assert_eq!(&sample.parts[0].bytes[..], expected.as_bytes());
    }
}
