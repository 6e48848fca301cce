//! Tests of the programs in `docs/examples/external`, with samples of one part and of several parts.

use std::fs;
use std::path::PathBuf;
use std::process::Command;
use std::sync::Arc;

use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use peernet_external::exec::{CommandLine, ExecConfig, Program, ReplyOutcome, Request, Role};
use peernet_sample::{Description, MediaType, Part, Sample};

fn example(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../docs/examples/external").join(name)
}

fn start(role: Role, words: &[&str]) -> Program {
    let words = words.iter().map(|word| (*word).to_owned()).collect();
    let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "test")));
    Program::start(&ExecConfig::new(CommandLine::Words(words)), role, "an example", &clock).expect("is there")
}

fn sample(media: &str, parts: &[&'static [u8]]) -> Sample {
    let description = Description::unshaped(MediaType::from_iana(media));
    let part = |bytes: &&'static [u8]| Part { description: description.clone(), bytes: (*bytes).into() };
    Sample { parts: parts.iter().map(part).collect(), source: "cam".to_owned(), label: None }
}

#[test]
fn actuator_writes_all_parts_of_an_answer() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("answers");
    let (program, file) = (example("record.sh"), file.to_string_lossy().into_owned());
    let mut program = start(Role::Actuator, &[&program.to_string_lossy(), &file]);
    for parts in [&[&b"left"[..]][..], &[b"left", b"0.5", b"now"], &[b"right"]] {
        let answer = sample("text/plain", parts);
        let actuator_call = program.call(Request::Answer { answer: &answer, source: "cam" }).expect("acts");
        assert_eq!(actuator_call.outcome, ReplyOutcome::Done);
    }
    assert_eq!(fs::read_to_string(file).expect("was written"), "cam left\ncam left 0.5 now\ncam right\n");
}

#[test]
fn model_refuses_several_pictures_and_continues() {
    let folder = tempfile::tempdir().expect("a folder");
    let program = folder.path().join("brightness");
    let compilation = Command::new("cc").arg("-o").arg(&program).arg(example("brightness.c")).status();
    assert!(compilation.expect("a C compiler is installed").success());
    let mut program = start(Role::Model, &[&program.to_string_lossy()]);
    let grey = |parts: &[&'static [u8]]| sample("image/x-grey8", parts);
    let error = program
        .call(Request::Sample(&grey(&[b"\xff", b"\xff"])))
        .expect_err("the model takes one picture")
        .to_string();
    assert!(error.contains("not a sample of 2 parts"), "{error}");
    let answer = program.call(Request::Sample(&grey(&[b"\xff"]))).expect("answers");
    assert!(
        matches!(&answer.outcome, ReplyOutcome::Parts(parts) if parts[0].bytes.starts_with(b"{\"label\":\"bright\"")),
        "{answer:?}"
    );
}
