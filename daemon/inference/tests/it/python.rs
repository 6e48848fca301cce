//! Python objects as models.

use std::fs;

use peernet_inference::{InferenceError, LoadError};
use peernet_sample::{Description, MediaType, Sample};

use super::recording_requester::run_until_partial_answer;
use super::{bank, loaded, run, slug};

const MODEL: &str = "
import os
class Net:
    def preprocess(self, x):
        if not x: raise ValueError('nothing to see')
        return x.upper()
    def infer(self, x): return {1, 2} if x == 'SET' else x
    def postprocess(self, y): return [y, os.environ['PEERNET_DEVICE'], os.environ['COLOUR']]
";

/// Returns the table of an object in the module `net`, with additional lines.
fn model(folder: &tempfile::TempDir, object: &str, more: &str) -> String {
    fs::write(folder.path().join("net.py"), MODEL).expect("can be written");
    format!("name = 'p'\nkind = 'python'\nobject = '{object}'\nfolder = {:?}\n{more}", folder.path())
}

fn text(text: &'static str) -> Sample {
    Sample::from_part(Description::unshaped(MediaType::Text), text.into())
}

#[test]
fn steps_are_stages_and_remaining_time_is_ipc() {
    let folder = tempfile::tempdir().expect("can be made");
    let config = model(&folder, "net::Net", "device = 'cuda:3'\nenv = { COLOUR = 'red' }\nworkers = 2");
    let bank = bank(&[&config]);
    assert!(bank.check().is_empty(), "{:?}", bank.check());
    let pool = loaded(&bank, "p");
    assert_eq!((pool.device(), pool.workers()), ("cuda:3".to_owned(), 2));
    assert!(pool.facts()[0].1.starts_with("the Python class net::Net, Python 3."), "{:?}", pool.facts());
    let (name, file) = &pool.facts()[2];
    assert!(name == "Model files" && file.contains("/net.py SHA-256 "), "{:?}", pool.facts());
    let done = run(&pool, text("cat"));
    assert_eq!(done.result.expect("answers").parts[0].bytes, r#"["CAT","cuda:3","red"]"#);
    let tree = done.recorder.finish();
    for stage in ["queue", "preprocessing", "inference", "postprocessing", "ipc"] {
        assert!(tree.find(&[stage]).is_some_and(|(_, node)| node.measure.value().is_some()), "{stage}");
    }
}

#[test]
fn exceptions_and_unsupported_values_fail_one_sample() {
    let folder = tempfile::tempdir().expect("can be made");
    let bank = bank(&[&model(&folder, "net::Net", "env = { COLOUR = 'red' }")]);
    let pool = loaded(&bank, "p");
    let done = run(&pool, text(""));
    let error = done.result.expect_err("raises");
    let message = error.to_string();
    assert!(matches!(error, InferenceError::Failed { .. }), "{message}");
    assert!(message.contains("ValueError: nothing to see") && message.contains("net.py"), "{message}");
    assert!(done.recorder.finish().find(&["inference"]).is_none(), "the step infer never began");
    let error = run(&pool, text("set")).result.expect_err("a set cannot be transferred");
    assert!(matches!(error, InferenceError::Failed { .. }), "{error}");
    assert!(error.to_string().contains("its answer: a builtins.set cannot be transferred"), "{error}");
    assert!(run(&pool, text("cat")).result.is_ok());
}

const GENERATORS: &str = "
class Words:
    def infer(self, x):
        try:
            for word in x.split(): yield word + ' '
        except GeneratorExit:
            open('closed', 'w').close()
            raise
class Count:
    def infer(self, x):
        yield bytes(50000)
        yield b'1' * 50000
        return {'words': len(x.split())}
class Many:
    def infer(self, x):
        for part in range(64): yield b'part'
class Large:
    def infer(self, x):
        import resource
        used = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + (256 << 20),) * 2)
        for part in range(1000): yield bytes(1 << 20)
        return 'the end'
class Broken:
    def infer(self, x):
        yield 'a'
        raise ValueError('lost the thread')
";

/// Runs an object of [`GENERATORS`]. Partial answer number `limit` cancels the request. Returns the result and the
/// partial answers.
fn run_generator(
    folder: &tempfile::TempDir,
    object: &str,
    limit: usize,
) -> (Result<Sample, InferenceError>, Vec<Sample>) {
    fs::write(folder.path().join("generators.py"), GENERATORS).expect("can be written");
    let bank = bank(&[&model(folder, &format!("generators::{object}"), "")]);
    let pool = loaded(&bank, "p");
    let (result, partial_answers) = run_until_partial_answer(&pool, text("one two three"), limit);
    // The process also serves the next sample. `Broken` and `Many` fail again, the other objects answer again.
    assert_eq!(run(&pool, text("one two three")).result.is_ok(), !["Broken", "Many"].contains(&object));
    (result, partial_answers)
}

#[test]
fn partial_answers_of_inner_model_are_not_sent() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("generators.py"), GENERATORS).expect("can be written");
    let replayed = "name = 'gpu'\nkind = 'distribution'\nmean_ms = 1.0\nstd_ms = 0.0\ninner = 'p'";
    let bank = bank(&[replayed, &model(&folder, "generators::Words", "")]);
    let (result, partial_answers) = run_until_partial_answer(&loaded(&bank, "gpu"), text("one two"), 10);
    assert!(result.is_ok() && partial_answers.is_empty(), "{result:?} {partial_answers:?}");
}

#[test]
fn values_that_infer_yields_are_partial_answers() {
    let folder = tempfile::tempdir().expect("can be made");
    let (result, partial_answers) = run_generator(&folder, "Words", 10);
    let texts: Vec<_> = partial_answers.iter().map(|partial| partial.parts[0].bytes.clone()).collect();
    assert_eq!(texts, ["one ", "two ", "three "]);
    assert_eq!(
        result.expect("answers").parts[0].bytes,
        "one two three ",
        "without a returned value, the answer is all yielded values"
    );
    // Bytes of 50 kB are in the shared memory, one after the other.
    let (result, partial_answers) = run_generator(&folder, "Count", 10);
    let first_bytes_and_lengths: Vec<_> = partial_answers
        .iter()
        .map(|partial| (partial.parts[0].bytes[0], partial.parts[0].bytes.len()))
        .collect();
    assert_eq!(first_bytes_and_lengths, [(0, 50_000), (b'1', 50_000)]);
    assert_eq!(result.expect("answers").parts[0].bytes, r#"{"words":3}"#);
    let (result, _) = run_generator(&folder, "Many", 100);
    let advice = "at most 63 can be transferred; infer() yielded 64 values and returned none, \
                  so the yielded values are the whole answer: let infer() return another whole answer";
    let error = result.expect_err("has too many parts").to_string();
    assert!(error.contains(advice), "{error}");
    let (result, partial_answers) = run_generator(&folder, "Broken", 10);
    assert!(result.expect_err("raises").to_string().contains("ValueError: lost the thread"));
    assert_eq!(partial_answers.len(), 1);
}

#[test]
fn yielded_values_are_not_kept_if_value_is_returned() {
    let folder = tempfile::tempdir().expect("can be made");
    fs::write(folder.path().join("generators.py"), GENERATORS).expect("can be written");
    let bank = bank(&[&model(&folder, "generators::Large", "")]);
    let answered = run(&loaded(&bank, "p"), text("one")).result;
    assert_eq!(answered.expect("1 GiB of yielded values does not fill the memory").parts[0].bytes, "the end");
}

#[test]
fn generator_is_closed_when_nobody_waits() {
    let folder = tempfile::tempdir().expect("can be made");
    let (result, partial_answers) = run_generator(&folder, "Words", 2);
    assert_eq!(result, Err(InferenceError::Cancelled { model: "p".to_owned() }));
    assert_eq!(partial_answers.len(), 2, "the third partial answer is not computed");
    assert!(folder.path().join("closed").exists());
}

#[test]
fn refused_partial_answer_fails_request_and_closes_generator() {
    let folder = tempfile::tempdir().expect("can be made");
    fs::write(folder.path().join("generators.py"), GENERATORS).expect("can be written");
    let pool = loaded(&bank(&[&model(&folder, "generators::Words", "")]), "p");
    let (result, partial_answers) = run_until_partial_answer(&pool, text("one refused three"), 10);
    let reason = "it is too large".to_owned();
    assert_eq!(result, Err(InferenceError::Failed { model: "p".to_owned(), reason }));
    assert_eq!(partial_answers.len(), 1);
    assert!(folder.path().join("closed").exists());
}

#[test]
fn restart_of_worker_is_recorded() {
    let source = "
import os, time
time.sleep(0.3)
class Net:
    def infer(self, x): return os._exit(4) if x == 'die' else x
";
    let folder = tempfile::tempdir().expect("can be made");
    fs::write(folder.path().join("own.py"), source).expect("can be written");
    let bank = bank(&[&model(&folder, "own::Net", "")]);
    let pool = loaded(&bank, "p");
    // Returns whether there is an answer, the time of a restart, and whether `ipc` was recorded.
    let run_and_read_times = |sample: &'static str| {
        let done = run(&pool, text(sample));
        let tree = done.recorder.finish();
        let value = |name: &str| tree.find(&[name]).and_then(|(_, node)| node.measure.value());
        (done.result.is_ok(), value("restart"), value("ipc").is_some())
    };
    assert_eq!(
        [run_and_read_times("cat"), run_and_read_times("die")],
        [(true, None, true), (false, None, true)]
    );
    let (is_answered, restart_s, _) = run_and_read_times("cat");
    assert!(is_answered && restart_s.is_some_and(|restart_s| restart_s >= 0.3), "{restart_s:?}");
    assert_eq!(run_and_read_times("cat"), (true, None, true));
}

#[test]
fn missing_object_is_found_by_check_or_load() {
    let folder = tempfile::tempdir().expect("can be made");
    let missing = bank(&[&model(&folder, "nowhere::Net", "")]);
    let checked = missing.check();
    assert!(matches!(checked.as_slice(), [(0, LoadError::Python(_))]) && checked[0].1.is_missing());
    let without = bank(&[&model(&folder, "net::Camera", "")]);
    assert!(without.check().is_empty(), "the check does not run the module");
    let error = without.load(&slug("p"), None).expect_err("the module has no Camera").to_string();
    assert!(error.contains("net has no Camera") && error.contains("Net"), "{error}");
}
