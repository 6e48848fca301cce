//! Tests of custom Python objects in real agents: a sensor on the edge, a model on the cloud.

mod two_agents;
mod worker;

use std::fs;
use std::path::Path;

use peernet_tests::python;

/// Sensor in the style of the paper's program, with two arrays per sample.
const RIG: &str = r#"
import numpy

class Rig:
    def __init__(self):
        self.taken = 0
        print("the rig is up")

    def sample(self):
        self.taken += 1
        image = numpy.full((48, 64, 3), self.taken, dtype="uint8")
        return image, numpy.array([self.taken, 0.5])
"#;

/// Model in the style of the paper's program, which raises an exception for every tenth sample.
const FOLLOWER: &str = r#"
import os

class Follower:
    def __init__(self):
        with open("pid", "w") as file:
            file.write(str(os.getpid()))
        print("following on", os.environ["PEERNET_DEVICE"])

    def preprocess(self, sample):
        image, state = sample
        assert image.shape == (48, 64, 3) and image.dtype == "uint8" and state.dtype == "float64"
        return image.mean(), state

    def infer(self, sample):
        brightness, state = sample
        if state[0] % 10 == 0:
            raise ValueError("the path is lost at %d" % state[0])
        return brightness * state[1]

    def postprocess(self, steering):
        return {"steering": steering}
"#;

const MODEL: &str = r#"
[[model]]
name = "follower"
kind = "python"
object = "follower::Follower"
device = "cuda:0"
python = "{python}"
"#;

const DRIVE: &str = r#"
[[pipeline]]
name = "drive"
sensor = { kind = "python", object = "rig::Rig", python = "{python}" }
placement = PLACEMENT
warm_up = { iterations = 0 }
"#;

/// Writes both modules into the folder in which the agents are started.
fn write_modules(folder: &Path) {
    for (name, text) in [("rig.py", RIG), ("follower.py", FOLLOWER)] {
        fs::write(folder.join(name), text).expect("the temporary folder is writable");
    }
}

/// Returns the table of the model, with an existing Python interpreter.
fn model_table() -> String {
    MODEL.replace("{python}", &python().display().to_string())
}

/// Returns the table of a pipeline with this placement.
fn pipeline_table(placement: &str) -> String {
    DRIVE.replace("PLACEMENT", placement).replace("{python}", &python().display().to_string())
}
