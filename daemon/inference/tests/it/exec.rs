//! External programs as models.

use peernet_inference::{InferenceError, LoadError};
use peernet_sample::{Description, MediaType, Sample};

use super::recording_requester::{REFUSED, run_until_partial_answer};
use super::{bank, jpeg, loaded, run, slug};

/// Program that answers with its input and its device. For the sample `stages` it also reports the durations of stages,
/// and for the sample `lie` an impossible duration.
const MODEL: &str = r#"
while read -r word bytes media shape source; do
    sample=$(head -c "$bytes")
    case $sample in
    stages) echo stage preprocessing 0; echo stage inference 0.0000001; echo value layers 3 ;;
    lie) echo stage inference 3600 ;;
    esac
    answer="$sample on $PEERNET_DEVICE $COLOUR"
    echo "answer ${#answer} text/plain"
    printf %s "$answer"
done
"#;

fn model(more: &str) -> String {
    format!("name = 'p'\nkind = 'exec'\ncommand = {}\n{more}", toml::Value::from(MODEL))
}

fn text(text: &'static str) -> Sample {
    Sample::from_part(Description::unshaped(MediaType::Text), text.into())
}

#[test]
fn call_is_inference_unless_program_reports_stages() {
    let bank = bank(&[&model("device = 'cuda:3'\nenv = { COLOUR = 'red' }\nworkers = 2")]);
    let pool = loaded(&bank, "p");
    assert_eq!((pool.device(), pool.workers()), ("cuda:3".to_owned(), 2));
    let done = run(&pool, text("plain"));
    let answer = done.result.expect("answers");
    assert_eq!(answer.parts[0].bytes, "plain on cuda:3 red");
    assert_eq!(answer.parts[0].description.media, MediaType::Text);
    let tree = done.recorder.finish();
    assert!(tree.find(&["inference"]).is_some() && tree.find(&["ipc"]).is_none());
}

#[test]
fn time_outside_reported_stages_is_ipc() {
    let bank = bank(&[&model("")]);
    let tree = run(&loaded(&bank, "p"), text("stages")).recorder.finish();
    let value = |name: &str| tree.find(&[name]).and_then(|(_, node)| node.measure.value());
    assert_eq!((value("preprocessing"), value("inference")), (Some(0.0), Some(1e-7)));
    assert!(value("ipc").is_some_and(|ipc| ipc > 0.0));
    assert_eq!(value("layers"), Some(3.0));
}

#[test]
fn first_answer_after_restart_has_restart_stage() {
    let script = r#"
sleep 0.3
while read -r word bytes media shape source; do
    case $(head -c "$bytes") in
    die) exit 4 ;;
    stages) echo stage inference 0.0000001 ;;
    esac
    echo answer 0
done
"#;
    let config = format!("name = 'p'\nkind = 'exec'\ncommand = {}", toml::Value::from(script));
    let bank = bank(&[&config]);
    let pool = loaded(&bank, "p");
    for (sample, inference) in [("plain", None), ("stages", Some(1e-7))] {
        assert!(run(&pool, text("die")).result.is_err());
        let done = run(&pool, text(sample));
        assert!(done.result.is_ok());
        let tree = done.recorder.finish();
        let value = |name: &str| tree.find(&[name]).and_then(|(_, node)| node.measure.value());
        assert!(
            value("restart").is_some_and(|restart_s| restart_s >= 0.3),
            "{sample}: {:?}",
            value("restart")
        );
        // After a restart, time outside the reported stages is part of `restart`, and neither `inference` nor `ipc`.
        assert_eq!((value("inference"), value("ipc")), (inference, None), "{sample}");
        assert!(run(&pool, text(sample)).recorder.finish().find(&["restart"]).is_none());
    }
}

#[test]
fn stages_longer_than_call_fail_one_sample() {
    let bank = bank(&[&model("")]);
    let pool = loaded(&bank, "p");
    let error = run(&pool, text("lie")).result.expect_err("the call took less than an hour");
    assert!(
        matches!(&error, InferenceError::Failed { .. }) && error.to_string().contains("3600s"),
        "{error}"
    );
    // The program answers the next sample, whatever its bytes are.
    assert!(run(&pool, jpeg(b"\xff".to_vec())).result.is_ok());
}

#[test]
fn missing_program_is_found_by_check_and_load() {
    let bank = bank(&["name = 'p'\nkind = 'exec'\ncommand = ['./no-such-program']"]);
    assert!(matches!(bank.check().as_slice(), [(0, LoadError::Program { .. })]));
    let error = bank.load(&slug("p"), None).expect_err("is not there").to_string();
    assert!(error.contains("model p") && error.contains("./no-such-program"), "{error}");
}

#[test]
fn partial_answers_of_program_are_sent() {
    let script = "while read -r word bytes media shape rest; do x=$(head -c \"$bytes\"); \
                  for i in 1 2 3; do printf 'partial 2 text/plain\\n%s;' \"$i\"; done; \
                  printf 'answer 4 text/plain\\n%s' done; done";
    let config = format!("name = 'p'\nkind = 'exec'\ncommand = {script:?}");
    let bank = bank(&[&config]);
    let pool = loaded(&bank, "p");
    let (result, partial_answers) = run_until_partial_answer(&pool, text("x"), 10);
    let texts: Vec<_> = partial_answers.iter().map(|partial| partial.parts[0].bytes.clone()).collect();
    assert_eq!(texts, ["1;", "2;", "3;"]);
    assert_eq!(result.unwrap_or_else(|error| panic!("{error}")).parts[0].bytes, "done");
    let (result, partial_answers) = run_until_partial_answer(&pool, text("x"), 2);
    assert_eq!(
        (result, partial_answers.len()),
        (Err(InferenceError::Cancelled { model: "p".to_owned() }), 2)
    );
    assert!(run(&pool, text("x")).result.is_ok(), "the program was started again");
}

#[test]
fn refused_partial_answer_fails_request() {
    let script = format!(
        "while read -r word bytes media shape rest; do x=$(head -c \"$bytes\"); \
         printf 'partial {} text/plain\\n{REFUSED}'; printf 'answer 4 text/plain\\ndone'; done",
        REFUSED.len()
    );
    let bank = bank(&[&format!("name = 'p'\nkind = 'exec'\ncommand = {script:?}")]);
    let (result, partial_answers) = run_until_partial_answer(&loaded(&bank, "p"), text("x"), 10);
    let reason = "it is too large".to_owned();
    assert_eq!(result, Err(InferenceError::Failed { model: "p".to_owned(), reason }));
    assert!(partial_answers.is_empty());
}
