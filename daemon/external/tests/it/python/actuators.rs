//! Tests of objects with `act(answer)` and `reset()`.

use peernet_external::python::{PythonError, Role, Step};
use peernet_sample::{Description, MediaType, Part};

use super::Module;

const ARM: &str = "
class Arm:
    def __init__(self): self.resets = 0
    def reset(self):
        self.resets += 1
        if self.resets == 2: raise OSError('no power')
        if self.resets == 3: raise StopIteration
        return {'an': 'observation'}, {}
    def act(self, answer): return eval(answer)

class Sensor:
    def sample(self): return b''
    def reset(self): pass

class Model:
    def infer(self, x): return x
    def reset(self, everything): raise RuntimeError('is never called')

class WithoutReset:
    def sample(self): return b''
";

fn text(text: &str) -> [Part; 1] {
    let description = Description::unshaped(MediaType::Text);
    [Part { description, bytes: text.as_bytes().to_vec().into() }]
}

#[test]
fn feedback_is_returned_as_json() {
    let module = Module::new(ARM, "own::Arm");
    let mut arm = module.start(Role::Actuator).expect("it has act()");
    for (returned, expected) in [
        ("None", "null"),
        ("{}", "{}"),
        ("{'reward': 1, 'success': None}", r#"{"reward":1.0}"#),
        ("{'episode_ended': True, 'success': 0}", r#"{"episode_ended":true,"success":false}"#),
        (
            "{'success': __import__('numpy').bool_(True), 'reward': __import__('numpy').float32(0.5)}",
            r#"{"success":true,"reward":0.5}"#,
        ),
    ] {
        let actuator_call = arm.call(&text(returned));
        let parts = actuator_call.result.expect(returned).expect("a value");
        assert_eq!(
            (parts[0].description.media.clone(), &parts[0].bytes[..]),
            (MediaType::Json, expected.as_bytes())
        );
        assert!(
            matches!(actuator_call.times.steps[..], [(Step::Act, ..)]),
            "{:?}",
            actuator_call.times.steps
        );
    }
    for (returned, expected_part) in [
        ("3", "act() returned a int; return None, or a dict with episode_ended, success, reward"),
        ("{'sucess': True}", "act() returned the key 'sucess'; the keys are"),
        ("{'reward': '3'}", "act() returned reward = '3'; return a number"),
        ("{'reward': True}", "act() returned reward = True; return a number"),
        ("{'reward': [1]}", "cannot be used: "),
        ("{'success': 'no'}", "act() returned success = 'no'; return True or False"),
        ("{'episode_ended': 2}", "act() returned episode_ended = 2; return True or False"),
        ("{'reward': float('nan')}", "the reward nan, which is not a finite number"),
        ("1 / 0", "ZeroDivisionError"),
    ] {
        let error = arm.call(&text(returned)).result.expect_err(returned).to_string();
        assert!(error.contains(expected_part), "{error}");
    }
    assert!(arm.call(&text("None")).result.is_ok(), "the process continues");
}

#[test]
fn reset_is_called_and_its_exception_is_returned() {
    let module = Module::new(ARM, "own::Arm");
    let mut arm = module.start(Role::Actuator).expect("it has act()");
    assert!(arm.resets());
    arm.reset().expect("the returned observation is ignored");
    let error = arm.reset().expect_err("raises");
    assert!(matches!(&error, PythonError::Raised(text) if text.contains("no power")), "{error}");
    let error = arm.reset().expect_err("raises");
    assert!(matches!(&error, PythonError::Raised(text) if text.contains("StopIteration")), "{error}");
    arm.reset().expect("the process continues");
    let parts = arm.call(&text("{'reward': self.resets}")).result.expect("acts").expect("a value");
    assert_eq!(&parts[0].bytes[..], br#"{"reward":4.0}"#);
}

#[test]
fn models_and_objects_without_method_do_not_reset() {
    let can_reset = |object: &str, role| Module::new(ARM, object).start(role).expect(object).resets();
    assert!(can_reset("own::Sensor", Role::Sensor));
    assert!(!can_reset("own::WithoutReset", Role::Sensor) && !can_reset("own::Model", Role::Model));
    let missing = Module::new(ARM, "own::Sensor").start_error(Role::Actuator);
    assert!(missing.contains("the class own::Sensor has no act(answer)"), "{missing}");
}
