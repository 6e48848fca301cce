//! Language models behind a server. The server follows scripts and uses real sockets.

mod failures;
mod scripted_server;
mod stream_errors;
mod tls;

use peernet_inference::FinishedJob;
use peernet_logger::Tree;
use peernet_sample::{Description, MediaType, Sample};
use serde_json::json;

use super::{bank, jpeg, loaded, run};
use scripted_server::{
    ScriptedServer, Step, content, done, event, finish, head, http_chunk, pause, usage, whole_response,
};

/// Returns the table of a model on a server, with further lines.
fn model(server: &ScriptedServer, more: &str) -> String {
    format!("name = 'vlm'\nkind = 'openai'\nurl = {:?}\nmodel = 'llava'\n{more}", server.url())
}

fn text(text: &'static str) -> Sample {
    Sample::from_part(Description::unshaped(MediaType::Text), text.into())
}

/// Sends one sample to a model whose server follows a script. `more` are further lines of the model's table.
fn ask(script: Vec<Step>, more: &str) -> FinishedJob {
    let server = ScriptedServer::start(vec![script]);
    let bank = bank(&[&model(&server, more)]);
    run(&loaded(&bank, "vlm"), text("Where is the plate?"))
}

/// Returns the value of a node below `inference`.
fn value(tree: &Tree, name: &str) -> Option<f64> {
    tree.find(&["inference", name]).and_then(|(_, node)| node.measure.value())
}

/// Returns the text of an answer, and its details.
fn parts(answer: &Sample) -> (&str, serde_json::Value) {
    let [text, details] = &answer.parts[..] else { panic!("{answer:?}") };
    assert_eq!((&text.description.media, &details.description.media), (&MediaType::Text, &MediaType::Json));
    let text = std::str::from_utf8(&text.bytes).expect("is text");
    (text, serde_json::from_slice(&details.bytes).expect("is JSON"))
}

/// Returns the value of the variable `PATH`, which the tests use as API key because it is always set.
fn api_key() -> String {
    std::env::var("PATH").expect("is set")
}

#[test]
fn answer_has_text_times_and_token_counts() {
    let role = json!({ "choices": [{ "delta": { "role": "assistant", "content": "" } }] }).to_string();
    let script = vec![
        head(),
        event(&role),
        event(""),
        http_chunk(b": ping\n\n"),
        pause(40),
        content("On"),
        pause(30),
        content(" the table."),
        finish("stop"),
        usage(21, 5),
        done(),
    ];
    let finished = ask(script, "");
    let answer = finished.result.expect("answers");
    let details = json!({
        "finish_reason": "stop", "input_tokens": 21, "output_tokens": 5, "reasoning_tokens": null,
        "output_chunks": 2,
    });
    assert_eq!(parts(&answer), ("On the table.", details));
    let tree = finished.recorder.finish();
    let value = |name| value(&tree, name);
    let first = value("time-to-first-token").expect("is recorded");
    let inference =
        tree.find(&["inference"]).and_then(|(_, node)| node.measure.value()).expect("is recorded");
    let gap = value("inter-token-latency").expect("is recorded");
    assert!(first >= 0.040, "the event with the role counted as a token: {first}");
    // A busy machine may stamp the first chunk late, so only the time until the second has a lower limit.
    assert!(gap > 0.0 && first + gap >= 0.070 && inference >= first + gap, "{inference} {first} {gap}");
    assert_eq!(value("inter-token-latency-max"), Some(gap));
    assert_eq!(value("inter-token-latency-p50"), Some(gap));
    // The time from the first chunk to the last is divided by the number of tokens minus 1. Here this time is one gap,
    // and there are five tokens.
    let per_token = value("time-per-output-token").expect("is recorded");
    assert!((per_token * 4.0 - gap).abs() < 1e-6, "{per_token} {gap}");
    let rate = value("output-token-rate").expect("is recorded");
    assert!((rate * (first + gap) - 5.0).abs() < 1e-6, "{rate}");
    assert_eq!((value("output-tokens"), value("output-chunks")), (Some(5.0), Some(2.0)));
    assert_eq!((value("input-tokens"), value("reasoning-tokens")), (Some(21.0), None));
    assert_eq!((value("finish-reason-stop"), value("finish-reason-length")), (Some(1.0), Some(0.0)));
    assert!(value("connect").is_some_and(|connect| connect < first));
    assert!(tree.find(&["preprocessing"]).is_some() && tree.find(&["postprocessing"]).is_some());
}

#[test]
fn request_has_configured_fields_and_api_key() {
    let answer = vec![head(), content("yes"), finish("length"), done()];
    let server = ScriptedServer::start(vec![answer.clone(), answer]);
    let key = &api_key();
    let more = "api_key_env = 'PATH'\nprompt = 'Is it open?'\ndevice = 'cuda:0'\n\
                parameters = { max_tokens = 3, temperature = 0.0 }";
    let bank = bank(&[&model(&server, more)]);
    let pool = loaded(&bank, "vlm");
    assert_eq!(pool.device(), "cuda:0");
    let facts = pool.facts();
    assert!(
        facts.contains(&("Model".to_owned(), "llava, over the chat API of OpenAI".to_owned())),
        "{facts:?}"
    );
    let settings = facts.iter().find(|(name, _)| name == "Model settings").expect("is recorded");
    assert!(settings.1.contains("parameters = {\"max_tokens\":3,\"temperature\":0.0}"), "{settings:?}");
    assert!(!format!("{facts:?}").contains(key), "the key is a secret");

    let finished = run(&pool, jpeg(b"\xff\xd8".to_vec()));
    assert_eq!(parts(&finished.result.expect("answers")).0, "yes");
    assert_eq!(value(&finished.recorder.finish(), "finish-reason-length"), Some(1.0));
    let request = server.request();
    assert!(request.head.starts_with("post /v1/chat/completions http/1.1\r\n"), "{}", request.head);
    let header = format!("authorization: bearer {}\r\n", key.to_lowercase());
    assert!(request.head.contains(&header), "{}", request.head);
    let content = json!([
        { "type": "text", "text": "Is it open?" },
        { "type": "image_url", "image_url": { "url": "data:image/jpeg;base64,/9g=" } },
    ]);
    let expected = json!({
        "model": "llava", "max_tokens": 3, "temperature": 0.0, "stream": true,
        "stream_options": { "include_usage": true },
        "messages": [{ "role": "user", "content": content }],
    });
    assert_eq!(request.body, expected);

    assert!(run(&pool, text("now?")).result.is_ok());
    assert_eq!(server.request().body["messages"][0]["content"], "Is it open?\nnow?");
}

#[test]
fn reasoning_does_not_count_as_first_token() {
    let reasoning =
        |text: &str| event(&json!({ "choices": [{ "delta": { "reasoning": text } }] }).to_string());
    let counts = json!({
        "prompt_tokens": 9, "completion_tokens": 30, "prompt_tokens_details": { "cached_tokens": 8 },
        "completion_tokens_details": { "reasoning_tokens": 25 },
    });
    let counts = event(&json!({ "choices": [], "usage": counts }).to_string());
    let finished = ask(
        vec![head(), reasoning("Let me see."), pause(30), content("42"), finish("stop"), counts, done()],
        "",
    );
    let answer = finished.result.expect("answers");
    assert_eq!((parts(&answer).0, &parts(&answer).1["reasoning_tokens"]), ("42", &json!(25)));
    let tree = finished.recorder.finish();
    let value = |name| value(&tree, name).unwrap_or_else(|| panic!("{name} is recorded"));
    assert!(value("time-to-first-token") > value("time-to-first-reasoning-token"));
    assert!(value("time-to-first-token") >= 0.030, "the reasoning counted as text of the answer");
    assert_eq!((value("reasoning-tokens"), value("output-tokens")), (25.0, 30.0));
    assert_eq!((value("cached-input-tokens"), value("output-chunks")), (8.0, 2.0));
}

#[test]
fn choices_other_than_first_are_ignored() {
    let choices = |choices: serde_json::Value| event(&json!({ "choices": choices }).to_string());
    let other = json!([{ "index": 1, "delta": { "content": "B" }, "finish_reason": "length" }]);
    let both = json!([
        { "index": 1, "delta": { "content": "B" } },
        { "index": 0, "delta": { "content": "A" }, "finish_reason": "stop" },
    ]);
    let finished = ask(vec![head(), choices(other), choices(both), done()], "");
    let answer = finished.result.expect("answers");
    assert_eq!((parts(&answer).0, &parts(&answer).1["finish_reason"]), ("A", &json!("stop")));
    assert_eq!(value(&finished.recorder.finish(), "output-chunks"), Some(1.0));
}

#[test]
fn call_of_a_tool_is_an_answer_without_text() {
    let call = json!({ "choices": [{ "index": 0, "delta": { "tool_calls": [{ "index": 0 }] } }] });
    let finished = ask(vec![head(), event(&call.to_string()), finish("tool_calls"), done()], "");
    let answer = finished.result.expect("answers");
    assert_eq!((parts(&answer).0, &parts(&answer).1["finish_reason"]), ("", &json!("tool_calls")));
}

#[test]
fn invalid_usage_is_not_recorded() {
    for usage in [
        r#"{"prompt_tokens":12.0,"completion_tokens":-5}"#,
        r#"{"prompt_tokens":"12","completion_tokens":18446744073709551615}"#,
        // No floating-point number is that large.
        r#"{"prompt_tokens":1.5,"completion_tokens":1e999}"#,
        r#""many""#,
    ] {
        let counts = event(&format!(r#"{{"choices":[],"usage":{usage}}}"#));
        let finished = ask(vec![head(), content("a"), content("b"), finish("stop"), counts, done()], "");
        let answer = finished.result.expect("answers");
        assert_eq!((parts(&answer).0, &parts(&answer).1["output_tokens"]), ("ab", &json!(null)), "{usage}");
        let tree = finished.recorder.finish();
        for name in ["input-tokens", "output-tokens", "output-token-rate", "time-per-output-token"] {
            assert_eq!(value(&tree, name), None, "{name} of {usage}");
        }
        assert_eq!(value(&tree, "output-chunks"), Some(2.0));
    }
}

#[test]
fn character_split_over_http_chunks_is_complete() {
    let stream =
        "data: {\"choices\":[{\"delta\":{\"content\":\"grün 漢\"},\"finish_reason\":\"stop\"}]}\r\n\r\n";
    let mut script = vec![head()];
    // Each byte is sent alone, with a pause so that it also arrives alone.
    for byte in stream.as_bytes() {
        script.extend([http_chunk(&[*byte]), pause(1)]);
    }
    script.push(done());
    let finished = ask(script, "");
    assert_eq!(parts(&finished.result.expect("answers")).0, "grün 漢");
    let tree = finished.recorder.finish();
    assert_eq!((value(&tree, "output-chunks"), value(&tree, "output-tokens")), (Some(1.0), None));
    assert_eq!(value(&tree, "time-per-output-token"), None, "the number of tokens is not known");
}

#[test]
fn events_of_one_http_chunk_are_counted_separately() {
    let chunk = |text: &str| format!("data: {{\"choices\":[{{\"delta\":{{\"content\":\"{text}\"}}}}]}}\n\n");
    let stream = [chunk("a"), chunk("b"), chunk("c")].concat();
    let finished = ask(vec![head(), http_chunk(stream.as_bytes()), finish("stop"), usage(1, 3), done()], "");
    assert_eq!(parts(&finished.result.expect("answers")).0, "abc");
    let tree = finished.recorder.finish();
    assert_eq!((value(&tree, "output-chunks"), value(&tree, "output-tokens")), (Some(3.0), Some(3.0)));
    assert_eq!(value(&tree, "inter-token-latency"), Some(0.0), "the three events arrived at the same time");
}

#[test]
fn answer_ends_with_finish_reason_or_done_event() {
    // The stream ends after the finish reason, without `[DONE]`.
    let close = Step::Send(b"0\r\n\r\n".to_vec());
    let finished = ask(vec![head(), content("a"), finish("stop"), close], "");
    assert_eq!(parts(&finished.result.expect("answers")).0, "a");
    // The server closes the connection in the middle of the HTTP body.
    let finished = ask(vec![head(), content("a"), finish("stop")], "");
    assert_eq!(parts(&finished.result.expect("answers")).0, "a");
    // `[DONE]` arrives without a finish reason. The end of the connection is the end of the HTTP body.
    let body = "HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nConnection: close\r\n\r\n\
                data: {\"choices\":[{\"delta\":{\"content\":\"b\"}}]}\n\ndata: [DONE]\n\n";
    let finished = ask(vec![Step::Send(body.as_bytes().to_vec())], "");
    assert_eq!(parts(&finished.result.expect("answers")).0, "b");
}

#[test]
fn failed_request_does_not_affect_next_one() {
    let answer = vec![head(), content("yes"), finish("stop"), done()];
    let busy = whole_response(
        "429 Too Many Requests",
        "Retry-After: 7\r\n",
        "{\"error\":{\"message\":\"slow down\"}}",
    );
    let server = ScriptedServer::start(vec![busy, answer]);
    let bank = bank(&[&model(&server, "")]);
    let pool = loaded(&bank, "vlm");
    assert!(run(&pool, text("a")).result.is_err());
    assert_eq!(parts(&run(&pool, text("b")).result.expect("answers")).0, "yes");
}
