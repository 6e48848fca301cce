//! Streams in which a server reports an error, or which have text in another form than the chat API.

use super::failures::failure;
use super::*;

/// Returns the reason why a request fails. The stream of its answer has these events and ends with `[DONE]`.
fn reason(events: &[Step]) -> String {
    failure([&[head()][..], events, &[done()][..]].concat(), "").0
}

#[test]
fn error_within_stream_fails_with_text_of_server() {
    let errors = [
        ("data: {\"error\":{\"message\":\"out of memory\"}}\n\n", "out of memory"),
        (
            "data: {\"object\":\"error\",\"message\":\"CUDA out of memory\",\"type\":\"InternalServerError\",\"code\":500}\n\n",
            "CUDA out of memory",
        ),
        ("event: error\ndata: {\"message\":\"oom\",\"code\":500}\n\n", "oom"),
        ("event: error\ndata: no memory\n\n", "no memory"),
        ("data: {\"message\":\"oom\",\"code\":500}\n\n", "oom"),
        ("data: {\"detail\":\"Internal error\"}\n\n", "Internal error"),
        ("error: {\"code\":500,\"message\":\"context full\",\"type\":\"server_error\"}\n\n", "context full"),
        (
            "data: {\"choices\":[{\"delta\":{},\"finish_reason\":\"error\",\"error\":{\"message\":\"upstream died\"}}]}\n\n",
            "upstream died",
        ),
        ("data: {\"choices\":[{\"delta\":{},\"finish_reason\":\"error\"}]}\n\n", "finish_reason is error"),
    ];
    for (error, text) in errors {
        let error = http_chunk(error.as_bytes());
        let expected = |after: &str| {
            format!("its server ended the answer after {after}: {text}; the server's log says why")
        };
        assert_eq!(reason(&[content("a"), error.clone()]), expected("1 chunk"));
        assert_eq!(reason(&[error]), expected("0 chunks"));
    }
}

#[test]
fn answer_without_delta_fails_with_reason() {
    let remedy = "; url must name a server with the OpenAI API";
    for (choice, field) in [
        (json!({ "index": 0, "message": { "content": "A" }, "finish_reason": "stop" }), "message"),
        (json!({ "index": 0, "text": "A", "finish_reason": "stop" }), "text"),
    ] {
        assert_eq!(
            reason(&[event(&json!({ "choices": [choice] }).to_string())]),
            format!(
                "event 1 of its answer has text in `{field}` and no `delta`: the server does not stream its answer as chat{remedy}"
            )
        );
    }
    let other = json!({ "choices": [{ "index": -1, "delta": { "content": "A" } }] });
    assert_eq!(
        reason(&[event(&other.to_string())]),
        format!(
            "its answer has text only in a choice with the index -1, and PEERNet reads the choice with the index 0{remedy}"
        )
    );
}

#[test]
fn repeated_whole_answer_is_not_added_to_text() {
    // PEERNet also reads an index that a server writes as a text.
    let chunk = json!({ "choices": [{ "index": "0", "delta": { "content": "A" } }] });
    let whole =
        json!({ "choices": [{ "index": 0, "message": { "content": "A" }, "finish_reason": "stop" }] });
    let script = vec![head(), event(&chunk.to_string()), event(&whole.to_string()), done()];
    let answer = ask(script, "").result.expect("answers");
    assert_eq!(parts(&answer).0, "A");
}
