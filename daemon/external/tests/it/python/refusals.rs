//! Which objects are accepted and which are refused: at the start, and by a check that does not run custom code.

use std::fs;
use std::path::PathBuf;

use peernet_external::python::{PythonObject, Role};

use super::{Module, clock};

const SOURCE: &str = "
import json
from collections import OrderedDict
class Model:
    def infer(self, x): return x
class Broken:
    def __init__(self): raise RuntimeError('no camera at 0')
class Needs:
    def __init__(self, path): pass
    def infer(self, x): return x
def detect(x): return x
instance = Model()
";

fn message(object: &str, role: Role) -> String {
    Module::new(SOURCE, object).start_error(role)
}

#[test]
fn start_error_names_missing_part() {
    for (object, role, parts) in [
        ("nowhere::Model", Role::Model, &["no Python module nowhere", "nowhere.py", "folder"][..]),
        (
            "own::Nothing",
            Role::Model,
            &["own has no Nothing; it defines Model, Broken, Needs, detect, instance"],
        ),
        ("own::Model", Role::Sensor, &["class own::Model has no sample()"]),
        ("own::detect", Role::Model, &["function own::detect has no infer(x)"]),
        ("own", Role::Model, &["module own has no infer(x)"]),
        ("own::Broken", Role::Model, &["RuntimeError: no camera at 0", "own.py"]),
        ("own::Needs", Role::Model, &["TypeError", "path"]),
        ("own.py::Model", Role::Model, &["cannot start own.py::Model", "No module named 'own.py'"]),
        ("./own::Model", Role::Model, &["module::object"]),
    ] {
        let message = message(object, role);
        for part in parts {
            assert!(message.contains(part), "{object}: {message}");
        }
    }
}

#[test]
fn classes_instances_and_modules_are_accepted() {
    for object in ["own::Model", "own::instance"] {
        let model = Module::new(SOURCE, object).model();
        assert!(model.description().object.ends_with(object), "{}", model.description().object);
        assert!(model.description().python.starts_with("3."));
    }
    let model = Module::new("def infer(x): return x", "own").model();
    assert_eq!(model.description().object, "module own");
}

#[test]
fn failed_import_reports_reason() {
    let message = Module::new("import nothing_of_this_name", "own::A").start_error(Role::Model);
    assert!(message.contains("ModuleNotFoundError: No module named 'nothing_of_this_name'"), "{message}");
    let message = Module::new("def broken(:", "own::A").start_error(Role::Model);
    assert!(message.contains("SyntaxError"), "{message}");
    let message = Module::new("import sys; sys.exit('not on this robot')", "own::A").start_error(Role::Model);
    assert!(message.contains("exit status 1") && message.contains("not on this robot"), "{message}");
}

#[test]
fn check_runs_no_custom_code() {
    let mut module = Module::new("raise SystemExit(9)", "own::Model");
    let check =
        |module: &Module| PythonObject::check(&module.config, &clock()).map_err(|error| error.to_string());
    check(&module).expect("the module is there");
    module.config.object = "json::JSONDecoder".to_owned();
    check(&module).expect("Python has it");
    module.config.object = "nowhere::Model".to_owned();
    assert!(check(&module).is_err_and(|message| message.contains("no Python module nowhere")));
    module.config.folder = Some("/nowhere".into());
    assert!(check(&module).is_err_and(|message| message.contains("/nowhere is not a folder")));
    module.config.folder = None;
    module.config.python = Some(PathBuf::from("/nowhere/python3"));
    assert!(check(&module).is_err_and(|message| message.contains("no Python at /nowhere/python3")));
    let broken = module.folder.path().join("python");
    fs::write(&broken, "not a program").expect("it can be written");
    module.config.python = Some(broken);
    assert!(check(&module).is_err_and(|message| message.contains("cannot start")));
}
