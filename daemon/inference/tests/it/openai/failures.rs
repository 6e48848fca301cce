//! Servers that refuse a request, send nothing, or close the connection too early.

use std::net::TcpListener;

use peernet_inference::{InferenceError, LoadError};

use super::*;

/// Returns the reason why a request fails, and the tree of the iteration.
pub(super) fn failure(script: Vec<Step>, more: &str) -> (String, Tree) {
    let finished = ask(script, more);
    let reason = match finished.result {
        Err(error @ InferenceError::Server { .. }) => {
            assert!(!error.to_peer().contains("http://127.0.0.1"), "a peer does not see the address");
            let text = error.to_string();
            let (model_and_url, reason) = text.split_once(" failed: ").expect("the server is named");
            assert!(model_and_url.starts_with("model vlm at http://127.0.0.1:"), "{text}");
            reason.to_owned()
        }
        result => panic!("{result:?}"),
    };
    (reason, finished.recorder.finish())
}

#[test]
fn stall_before_first_token_ends_at_limit() {
    for script in [
        vec![Step::Stall],
        vec![head(), Step::Stall],
        // Neither a role nor comments are tokens.
        vec![
            head(),
            event("{\"choices\":[{\"delta\":{\"role\":\"assistant\"}}]}"),
            http_chunk(b": ping\n\n"),
            Step::Stall,
        ],
    ] {
        let (reason, tree) = failure(script, "first_token_timeout_ms = 120");
        let expected =
            "its server sent no token within 120 ms; raise first_token_timeout_ms if it needs longer";
        assert_eq!(reason, expected);
        assert!(tree.find(&["inference"]).is_some_and(|(_, node)| node.measure.value() >= Some(0.120)));
        assert_eq!(value(&tree, "time-to-first-token"), None);
    }
}

#[test]
fn stall_between_tokens_ends_at_limit() {
    let script = vec![head(), content("a"), content("b"), Step::Stall];
    let (reason, tree) = failure(script, "token_timeout_ms = 120");
    let expected =
        "its server sent nothing for 120 ms after 2 chunks; raise token_timeout_ms if it needs longer";
    assert_eq!(reason, expected);
    assert!(
        value(&tree, "time-to-first-token").is_some(),
        "the time of the first token is recorded although the request fails"
    );
    assert_eq!(value(&tree, "output-chunks"), Some(2.0));
}

#[test]
fn endless_answer_ends_at_total_limit() {
    let mut script = vec![head()];
    (0..500).for_each(|_| script.extend([content("a"), pause(20)]));
    let (reason, _) = failure(script, "timeout_ms = 150");
    assert!(reason.starts_with("its answer is not complete within 150 ms, after "), "{reason}");
    assert!(reason.ends_with("raise timeout_ms, or set max_tokens in parameters"), "{reason}");
}

#[test]
fn refusal_is_reported_with_text_of_server() {
    for (status, headers, body, expected) in [
        (
            "429 Too Many Requests",
            "Retry-After: 7\r\n",
            "{\"error\":{\"message\":\"slow down\"}}",
            "its server answered with HTTP status 429 Too Many Requests: slow down; the server asks to wait 7 s; lower the rate \
             of the pipeline, or the number of workers",
        ),
        (
            "503 Service Unavailable",
            "Retry-After: Fri, 31 Dec 1999 23:59:59 GMT\r\n",
            "",
            "its server answered with HTTP status 503 Service Unavailable; the server asks to wait until Fri, 31 Dec 1999 23:59:59 \
             GMT; lower the rate of the pipeline, or the number of workers",
        ),
        (
            "500 Internal Server Error",
            "",
            "oops",
            "its server answered with HTTP status 500 Internal Server Error: oops; its log says why",
        ),
        (
            "404 Not Found",
            "",
            "{\"object\":\"error\",\"message\":\"The model `llava` does not exist.\"}",
            "its server answered with HTTP status 404 Not Found: The model `llava` does not exist.; check url and model",
        ),
        (
            "429 Too Many Requests",
            "Retry-After: -5\r\n",
            "slow down",
            "its server answered with HTTP status 429 Too Many Requests: slow down; lower the rate of the pipeline, or the \
             number of workers",
        ),
        (
            "307 Temporary Redirect",
            "Location: http://127.0.0.1:1/v1/chat/completions\r\n",
            "",
            "its server answered with HTTP status 307 Temporary Redirect; it redirects to \
             http://127.0.0.1:1/v1/chat/completions, and redirects are not followed: write the address of the API into url",
        ),
        (
            "201 Created",
            "Content-Type: text/event-stream\r\n",
            "",
            "its server answered with HTTP status 201 Created; a chat API answers with 200 and an event stream: check url",
        ),
        (
            "200 OK",
            "Content-Type: text/event-stream\r\nContent-Encoding: gzip\r\n",
            "compressed",
            "its server answered with Content-Encoding: gzip, although the request allows none; switch compression off in the \
             server or its proxy",
        ),
        (
            "200 OK",
            "Content-Type: text/event-stream\r\n",
            "{\"choices\": []}\n",
            "its answer of 16 bytes is no event stream; url must name a server with the OpenAI API",
        ),
        (
            "200 OK",
            "Content-Type: text/event-stream\r\n",
            "data: [DONE]\n\n",
            "its server ended the answer without text; the server's log says why",
        ),
        (
            "200 OK",
            "Content-Type: application/json\r\n",
            "{}",
            "its server answered with application/json instead of text/event-stream; it must support \"stream\": true, \
             and url must end before /chat/completions",
        ),
    ] {
        assert_eq!(failure(whole_response(status, headers, body), "").0, expected);
    }
}

#[test]
fn interrupted_answer_fails_request() {
    // The body has no end.
    let (reason, tree) = failure(vec![head(), content("a")], "");
    assert!(reason.starts_with("the connection to its server broke after 1 chunk: "), "{reason}");
    assert_eq!(value(&tree, "output-chunks"), Some(1.0));
    // The body has an end, but the answer has none.
    let (reason, _) = failure(vec![head(), content("a"), Step::Send(b"0\r\n\r\n".to_vec())], "");
    assert_eq!(
        reason,
        "its server closed the connection after 1 chunk without ending the answer; the server's log says why"
    );
    let (reason, _) = failure(vec![], "");
    assert!(reason.starts_with("the connection to its server broke after 0 chunks: "), "{reason}");
    let error = event("{\"error\":{\"message\":\"out of memory\"}}");
    let (reason, _) = failure(vec![head(), content("a"), error, Step::Stall], "");
    assert_eq!(reason, "its server ended the answer after 1 chunk: out of memory; the server's log says why");
    let (reason, _) = failure(vec![head(), event("{\"choices\":["), Step::Stall], "");
    assert!(reason.starts_with("event 1 of its answer cannot be read: "), "{reason}");
}

#[test]
fn partial_text_of_refusal_is_reported_at_limit() {
    let part = "HTTP/1.1 500 Internal Server Error\r\nContent-Length: 100\r\n\r\nout of mem";
    let script = vec![Step::Send(part.as_bytes().to_vec()), Step::Stall];
    let (reason, tree) = failure(script, "timeout_ms = 400");
    let expected =
        "its server answered with HTTP status 500 Internal Server Error: out of mem; its log says why";
    assert_eq!(reason, expected);
    // Without the limit of the request, the text is awaited for five seconds.
    assert!(tree.find(&["inference"]).is_some_and(|(_, node)| node.measure.value() < Some(5.0)));
}

#[test]
fn server_that_does_not_answer_is_refused_at_load() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port is free");
    let url = format!("http://{}/v1", listener.local_addr().expect("is bound"));
    let table = format!("name = 'vlm'\nkind = 'openai'\nurl = {url:?}\nmodel = 'llava'\ntimeout_ms = 200");
    let error = bank(&[&table]).load(&"vlm".parse().expect("is a name"), None).expect_err("no answer");
    assert!(matches!(error, LoadError::Server { .. }) && error.is_transient(), "{error}");
    let expected = format!(
        "model vlm at {url}: its server accepts connections and did not answer GET /v1/models within 200 ms; restart it, or \
         correct url"
    );
    assert_eq!(error.to_string(), expected);
}

#[test]
fn too_long_answer_is_refused() {
    let long = content(&"x".repeat(600_000));
    let (reason, _) = failure(vec![head(), long.clone(), long, Step::Stall], "");
    assert_eq!(reason, "its answer is longer than 1 MiB; set max_tokens in parameters");
}

#[test]
fn api_key_in_answer_of_server_is_hidden() {
    let key = &api_key();
    let refused = whole_response("401 Unauthorized", "", &format!("{{\"error\":\"wrong key {key}\"}}"));
    let (reason, _) = failure(refused, "api_key_env = 'PATH'");
    assert_eq!(
        reason,
        "its server answered with HTTP status 401 Unauthorized: wrong key ***; check the key in the environment variable that api_key_env names"
    );
    let (reason, _) =
        failure(vec![head(), event(&format!("\"Bearer {key}\"")), Step::Stall], "api_key_env = 'PATH'");
    assert!(reason.contains("Bearer ***") && !reason.contains(key.as_str()), "{reason}");
}

#[test]
fn server_that_is_down_is_refused_at_load() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port is free");
    let url = format!("http://{}/v1", listener.local_addr().expect("is bound"));
    drop(listener);
    let bank = bank(&[&format!("name = 'vlm'\nkind = 'openai'\nurl = {url:?}\nmodel = 'llava'")]);
    assert!(bank.check().is_empty(), "the check does not connect: {:?}", bank.check());
    let error = bank.load(&"vlm".parse().expect("is a name"), None).expect_err("nothing listens");
    assert!(matches!(error, LoadError::Server { .. }) && error.is_transient(), "{error}");
    let text = error.to_string();
    assert!(text.starts_with(&format!("model vlm at {url}: cannot connect to its server: ")), "{text}");
    assert!(text.ends_with("start the server, or correct url"), "{text}");
    let text_for_peer = error.to_peer("vlm", "gpu-1");
    assert!(
        text_for_peer.starts_with("model vlm cannot be loaded on host gpu-1: cannot connect to its server: "),
        "{text_for_peer}"
    );
    assert!(!text_for_peer.contains("127.0.0.1"), "a peer does not see the address: {text_for_peer}");
}

#[test]
fn peer_sees_reason_without_host_of_server() {
    for (host, reason, is_shown) in [
        ("ai", "its server is not trained yet", true),
        ("10.0.0.1", "10.0.0.12 is not ready", true),
        ("10.0.0.1", "10.0.0.1 is not ready", false),
        ("gpu-1.example", "GPU-1.example:8000 is not ready", false),
        ("[::1]", "nothing listens on ::1", false),
    ] {
        let error = LoadError::Server {
            model: "vlm".to_owned(),
            url: format!("http://{host}:8000/v1"),
            is_transient: true,
            reason: reason.to_owned(),
        };
        assert_eq!(error.to_peer("vlm", "edge").contains(reason), is_shown, "{host}: {reason}");
    }
}

#[test]
fn invalid_keys_are_refused_with_reason() {
    for (lines, key, reason) in [
        ("url = 'gpu:8080'", "url", "http://"),
        (
            "url = 'http://gpu'\nparameters = { stream = false }",
            "parameters",
            "stream is reserved for this program",
        ),
        (
            "url = 'http://gpu'\nparameters = { temperature = nan }",
            "parameters",
            "temperature is no finite number",
        ),
        (
            "url = 'http://gpu'\napi_key_env = 'PEERNET_NO_SUCH_KEY'",
            "api_key_env",
            "PEERNET_NO_SUCH_KEY is not set",
        ),
    ] {
        let bank = bank(&[&format!("name = 'vlm'\nkind = 'openai'\nmodel = 'llava'\n{lines}")]);
        match &bank.check()[..] {
            [(0, error @ LoadError::InvalidKey { key: found, .. })] => {
                assert!(*found == key && error.to_string().contains(reason), "{error}");
            }
            errors => panic!("{lines}: {errors:?}"),
        }
    }
}
