//! Errors of custom code, after which the next call still succeeds.

use std::num::NonZeroU64;

use peernet_external::python::{PythonError, Step};

use super::{Module, bytes, failure, value};

const MODEL: &str = "
import ctypes, os, sys, time, threading
class Own:
    def infer(self, x):
        if x == b'raise':
            return self.deeper(x)
        if x == b'exit':
            print('no more', file=sys.stderr)
            sys.exit(3)
        if x == b'crash':
            ctypes.string_at(0)
        if x == b'hang':
            time.sleep(600)
        if x == b'object':
            return threading.Lock()
        if x == b'loud':
            print('words of mine')
            os.write(1, b'more words\\n')
        if x == b'eof':
            raise EOFError('of mine')
        return x
    def deeper(self, x):
        raise ValueError('wrong: %r' % x)
";

fn module() -> Module {
    Module::new(MODEL, "own::Own")
}

#[test]
fn exception_fails_one_call_with_custom_traceback() {
    let mut model = module().model();
    let model_call = model.call(&[bytes(b"raise")]);
    assert_eq!(model_call.times.steps.iter().map(|step| step.0).collect::<Vec<_>>(), [Step::Infer]);
    let message = model_call.result.expect_err("it raised").to_string();
    assert!(message.starts_with("ValueError: wrong: b'raise'\nTraceback"), "{message}");
    assert!(message.contains("own.py\", line") && message.contains("in deeper"), "{message}");
    assert!(!message.contains("<peernet>"), "frames of the worker are omitted: {message}");
    assert!(failure(&mut model, &[bytes(b"eof")]).starts_with("EOFError: of mine"));
    assert_eq!(value(&mut model, &[bytes(b"on")])[0].bytes, "on");
}

#[test]
fn control_characters_of_exception_are_replaced() {
    let source = r"
class Own:
    def infer(self, x):
        raise ValueError('\x1b[31mred\x9b4m\r\nand more')
";
    let message = failure(&mut Module::new(source, "own::Own").model(), &[]);
    assert!(message.starts_with("ValueError:  [31mred 4m \nand more\nTraceback"), "{message:?}");
    assert!(!message.contains(|c: char| c.is_control() && c != '\n'), "{message:?}");
}

#[test]
fn long_traceback_is_shortened() {
    let source = "
class Own:
    def infer(self, x):
        raise ValueError('x' * 100000)
";
    let message = failure(&mut Module::new(source, "own::Own").model(), &[]);
    assert!(message.starts_with("ValueError: xxx") && message.len() < 5000, "{} bytes", message.len());
}

#[test]
fn unsupported_value_fails_one_call() {
    let mut model = module().model();
    let message = failure(&mut model, &[bytes(b"object")]);
    assert!(message.contains("_thread.lock cannot be transferred"), "{message}");
    assert_eq!(value(&mut model, &[bytes(b"on")])[0].bytes, "on");
}

#[test]
fn masked_array_values_are_refused() {
    let source = "
import numpy
class Own:
    def infer(self, x): return numpy.ma.masked_array([1, 2], [x == b'masked', False])
";
    let mut model = Module::new(source, "own::Own").model();
    let message = failure(&mut model, &[bytes(b"masked")]);
    assert!(message.contains("masked array cannot be transferred"), "{message}");
    assert_eq!(value(&mut model, &[bytes(b"plain")])[0].description.shape, [2]);
}

#[test]
fn incomplete_numpy_or_torch_in_sys_modules_is_ignored() {
    let source = "
import sys, types
class Own:
    def infer(self, x):
        for name in ('numpy', 'PIL.Image', 'torch'): sys.modules[name] = types.ModuleType(name)
        return [x, 3]
";
    let mut model = Module::new(source, "own::Own").model();
    for _ in 0..2 {
        assert!(model.call(&[bytes(b"on")]).result.expect("lists are transferred").is_some());
    }
}

#[test]
fn printed_output_does_not_affect_calls() {
    let mut model = module().model();
    assert_eq!(value(&mut model, &[bytes(b"loud")])[0].bytes, "loud");
    assert_eq!(value(&mut model, &[bytes(b"on")])[0].bytes, "on");
}

#[test]
fn dead_process_is_reported_and_restarted() {
    let module = module();
    let mut model = module.model();
    let message = failure(&mut model, &[bytes(b"exit")]);
    assert!(
        message.contains("exit status 3") && message.contains("no more") && message.contains("restarted"),
        "{message}"
    );
    assert_eq!(value(&mut model, &[bytes(b"on")])[0].bytes, "on");
    let message = failure(&mut model, &[bytes(b"crash")]);
    assert!(message.contains("SIGSEGV"), "{message}");
    assert_eq!(value(&mut model, &[bytes(b"on")])[0].bytes, "on");
}

#[test]
fn repeated_deaths_delay_the_restart() {
    let module = module();
    let mut model = module.model();
    let mut delay_count = 0;
    for _ in 0..6 {
        match model.call(&[bytes(b"exit")]).result.expect_err("it dies") {
            PythonError::RestartDelayed { remaining_delay, last_failure, .. } => {
                assert!(last_failure.contains("exit status 3"), "{last_failure}");
                std::thread::sleep(remaining_delay.to_duration());
                delay_count += 1;
            }
            error => assert!(matches!(error, PythonError::Died { .. }), "{error}"),
        }
    }
    assert!(delay_count >= 2, "{delay_count} restarts were delayed");
}

#[test]
fn hanging_call_ends_at_timeout() {
    let mut module = module();
    module.config.timeout_ms = NonZeroU64::new(500).expect("above 0");
    let mut model = module.model();
    let message = failure(&mut model, &[bytes(b"hang")]);
    assert!(message.contains("within 0.5 s") && message.contains("timeout_ms"), "{message}");
    // The short timeout also holds for the next call, which therefore may fail. It must not hang.
    model.call(&[bytes(b"on")]);
}

#[test]
fn death_is_detected_despite_forked_child() {
    let source = "
import multiprocessing, os, time
class Own:
    def infer(self, x):
        multiprocessing.get_context('fork').Process(target=time.sleep, args=(600,)).start()
        os._exit(7)
";
    let message = failure(&mut Module::new(source, "own::Own").model(), &[]);
    assert!(message.contains("exit status 7"), "{message}");
}
