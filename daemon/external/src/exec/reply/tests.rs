use std::io::{BufRead, Cursor, Read};

use peernet_sample::{Description, ElementType, Sample};
use proptest::prelude::*;

use super::*;
use crate::exec::{MAX_LINE_BYTES, Request};

/// Feeds a program's output to an assembler. Returns the reply and the number of bytes that belong to it; `None` if the
/// output ends before the reply is complete.
fn feed(role: Role, output_bytes: &[u8]) -> Result<Option<(Reply, usize)>, FramingError> {
    let mut output = Cursor::new(output_bytes);
    let mut assembler = ReplyAssembler::new(role);
    let mut step = AssemblyStep::ReadLine;
    loop {
        step = match step {
            AssemblyStep::ReadLine => {
                let mut line = Vec::new();
                output.read_until(b'\n', &mut line).expect("memory can be read");
                if line.pop() != Some(b'\n') {
                    return Ok(None);
                }
                assembler.push_line(&line)?
            }
            AssemblyStep::ReadBytes(count) => {
                let mut bytes = Vec::new();
                output.by_ref().take(count).read_to_end(&mut bytes).expect("memory can be read");
                if bytes.len() as u64 != count {
                    return Ok(None);
                }
                assembler.push_bytes(bytes.into())
            }
            AssemblyStep::DeliverPartialAnswer(_) => AssemblyStep::ReadLine,
            AssemblyStep::Complete(reply) => return Ok(Some((reply, output.position() as usize))),
        }
    }
}

fn reply(role: Role, output_text: &str) -> Reply {
    let (reply, used_bytes) =
        feed(role, output_text.as_bytes()).expect("is well formed").expect("is complete");
    assert_eq!(used_bytes, output_text.len(), "nothing is left over");
    reply
}

fn error(role: Role, output_text: &str) -> String {
    feed(role, output_text.as_bytes()).expect_err("is not well formed").to_string()
}

#[test]
fn answer_is_header_line_and_announced_bytes() {
    let answer = reply(Role::Model, "answer 13 application/json\n{\"label\":\"a\"}");
    let ReplyOutcome::Parts(parts) = answer.outcome else { panic!("is an answer") };
    assert_eq!(
        (&parts[0].description.media, parts[0].bytes.as_ref()),
        (&MediaType::Json, &b"{\"label\":\"a\"}"[..])
    );
    // A line may end with a carriage return before the line feed.
    let ReplyOutcome::Parts(parts) = reply(Role::Sensor, "answer 2\r\n\n\n").outcome else {
        panic!("is an answer")
    };
    assert_eq!((&parts[0].description, parts[0].bytes.as_ref()), (&Description::bytes(), &b"\n\n"[..]));
}

#[test]
fn reply_has_parts_with_their_shapes() {
    let output_text = "part 3 image/x-rgb8 1x1x3:u8\nrgbanswer 8 application/x-tensor 2:f32\n12345678";
    let ReplyOutcome::Parts(parts) = reply(Role::Sensor, output_text).outcome else { panic!("is an answer") };
    assert_eq!(parts.len(), 2);
    assert_eq!(
        (parts[1].description.shape.as_slice(), parts[1].description.element),
        (&[2][..], Some(ElementType::F32))
    );
}

#[test]
fn notes_before_answer_are_returned() {
    let output_text = "version 1\nsequence 7\nlabel golden retriever\nsource a b.jpg\nstage warming 0.25\nvalue exposure 1e-3 s\nanswer 0\n";
    let notes = reply(Role::Sensor, output_text).notes;
    let expected = ReplyNotes {
        stages: vec![("warming".to_owned(), Span::from_millis(250))],
        values: vec![("exposure".to_owned(), 0.001, "s".to_owned())],
        sequence: Some(7),
        label: Some("golden retriever".to_owned()),
        source: Some("a b.jpg".to_owned()),
        ..ReplyNotes::default()
    };
    assert_eq!(notes, expected);
}

#[test]
fn feedback_lines_precede_done_line() {
    let notes = reply(Role::Actuator, "reward -0.5\nsuccess 1\nepisode-ended\ndone\n").notes;
    assert_eq!((notes.reward, notes.success, notes.episode_ended), (Some(-0.5), Some(true), true));
    for (output_text, expected_part) in [
        ("reward inf\n", "reward NUMBER"),
        ("reward\n", "reward NUMBER"),
        ("success true\n", "success 0, or success 1"),
        ("value episode-return 1\n", "a reserved name"),
        ("value reward 5\n", "an actuator writes the line: reward NUMBER"),
        ("value success 1\n", "an actuator writes the line: success 0, or success 1"),
        ("value episode-ended 1\n", "an actuator writes the line: episode-ended"),
        ("stage parts 1\n", "a reserved name"),
        ("reward 1\nreward 2\n", "it wrote the line reward more than once in one reply"),
        ("success 0\nsuccess 1\n", "it wrote the line success more than once in one reply"),
        ("hello\n", "an actuator writes one of: done"),
    ] {
        let text = error(Role::Actuator, output_text);
        assert!(text.contains(expected_part), "{output_text:?}: {text}");
    }
    assert!(
        error(Role::Model, "reward 1\n").contains("a model writes one of"),
        "a model cannot report a reward"
    );
}

#[test]
fn roles_accept_different_words() {
    assert_eq!(reply(Role::Sensor, "end\n").outcome, ReplyOutcome::End);
    assert_eq!(reply(Role::Actuator, "done\n").outcome, ReplyOutcome::Done);
    assert_eq!(reply(Role::Model, "error too dark\n").outcome, ReplyOutcome::Error("too dark".to_owned()));
    assert!(error(Role::Model, "end\n").contains("a model writes one of: answer"));
    assert!(error(Role::Actuator, "answer 3\nabc").contains("an actuator writes one of"));
    assert!(error(Role::Model, "label a\n").contains("label a"));
}

#[test]
fn reset_is_replied_to_with_done_or_error() {
    for role in [Role::Sensor, Role::Actuator] {
        let outcome = |line: &[u8]| ReplyAssembler::for_reset(role).push_line(line);
        let reply = |outcome| AssemblyStep::Complete(Reply { notes: ReplyNotes::default(), outcome });
        assert_eq!(outcome(b"done"), Ok(reply(ReplyOutcome::Done)));
        assert_eq!(outcome(b"error stuck"), Ok(reply(ReplyOutcome::Error("stuck".to_owned()))));
        let wrong = outcome(b"answer 3").expect_err("is no sample").to_string();
        assert!(wrong.contains("in reply to reset"), "{wrong}");
    }
}

#[test]
fn errors_show_the_expected_form() {
    for (output_text, expected_part) in [
        ("hello\n", "standard error"),
        ("answer\n", "answer BYTES"),
        ("answer -3\n", "answer BYTES"),
        ("answer 3 text/plain - more\n", "answer BYTES"),
        ("part -3\n", "part BYTES"),
        ("partial 3 text/plain - more\n", "partial BYTES"),
        ("answer 9999999999999\n", "at most"),
        ("answer 3 application/x-tensor 2:u8\n", "its shape and type need 2 bytes"),
        ("stage inference\n", "stage NAME SECONDS"),
        ("stage inference -1\n", "stage NAME SECONDS"),
        ("stage inference NaN\n", "stage NAME SECONDS"),
        ("stage Upper 1\n", "stage NAME SECONDS"),
        ("stage upload 1\n", "a reserved name"),
        ("value inference 3 bar\n", "a reserved name"),
        ("value skipped-starts 1\n", "a reserved name"),
        ("value map-50 1\n", "a reserved name"),
        ("value batch-size 1\n", "a reserved name"),
        ("value outcome 1\n", "a reserved name"),
        ("value warm-up 1\n", "a reserved name"),
        ("value x inf\n", "value NAME NUMBER"),
        ("version 2\n", "version 2"),
        ("version x\n", "version NUMBER"),
    ] {
        let text = error(Role::Model, output_text);
        assert!(text.contains(expected_part), "{output_text:?}: {text}");
    }
    assert!(matches!(feed(Role::Model, b"\xff\xfe\n"), Err(FramingError::NotText(_))));
}

#[test]
fn lines_parts_and_bytes_of_reply_are_limited() {
    assert_eq!(feed(Role::Model, "\n".repeat(MAX_LINES + 1).as_bytes()), Err(FramingError::TooManyLines));
    assert_eq!(
        feed(Role::Model, "part 0\n".repeat(MAX_PARTS + 1).as_bytes()),
        Err(FramingError::TooManyParts)
    );
    let largest_answer_header = format!("answer {MAX_SAMPLE_BYTES}\n");
    assert_eq!(
        ReplyAssembler::new(Role::Model).push_line(largest_answer_header.trim_end().as_bytes()),
        Ok(AssemblyStep::ReadBytes(MAX_SAMPLE_BYTES))
    );
    let mut assembler = ReplyAssembler::new(Role::Model);
    assembler.push_line(b"part 1").expect("is small");
    assembler.push_bytes(Bytes::from_static(b"x"));
    assert_eq!(
        assembler.push_line(largest_answer_header.trim_end().as_bytes()),
        Err(FramingError::TooLarge(MAX_SAMPLE_BYTES + 1))
    );
}

proptest! {
    /// Any output leads to a reply, an error, or a request for more input.
    #[test]
    fn garbage_never_panics(output_bytes in prop::collection::vec(any::<u8>(), 0..MAX_LINE_BYTES), role in 0..3) {
        let role = [Role::Sensor, Role::Model, Role::Actuator][role as usize];
        let _ = feed(role, &output_bytes);
    }

    /// Output that resembles the framing does not cause a panic either.
    #[test]
    fn nearly_right_words_never_panic(
        words in prop::collection::vec("(answer|part|stage|value|error|end|done|version|sequence|label) ?[0-9a-z.:x/-]{0,12} ?[0-9a-z.:x/-]{0,8}\n", 0..20),
    ) {
        for role in [Role::Sensor, Role::Model, Role::Actuator] {
            if let Ok(Some((_, used_bytes))) = feed(role, words.concat().as_bytes()) {
                prop_assert!(used_bytes <= words.concat().len());
            }
        }
    }

    /// The request to an actuator can be parsed as a model's reply, because both directions encode parts in the same way.
    #[test]
    fn written_requests_are_parsed_back(payloads in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..200), 1..5)) {
        let parts: Vec<_> = payloads
            .into_iter()
            .map(|bytes| Part {
                description: Description {
                    media: MediaType::Tensor,
                    shape: vec![bytes.len() as u32],
                    element: Some(ElementType::U8),
                },
                bytes: bytes.into(),
            })
            .collect();
        let sample = Sample { parts, source: String::new(), label: None };
        let request_bytes = Request::Answer { answer: &sample, source: "" }.pieces().concat();
        // An empty source is written as `-` at the end of each header. A reply has no such word.
        let (parsed_parts, _) = feed_without_source(&request_bytes);
        prop_assert_eq!(parsed_parts, sample.parts);
    }
}

/// Parses a request after removing the source at the end of each header.
fn feed_without_source(request_bytes: &[u8]) -> (Vec<Part>, usize) {
    let mut output = Cursor::new(request_bytes);
    let mut assembler = ReplyAssembler::new(Role::Model);
    loop {
        let mut line = Vec::new();
        output.read_until(b'\n', &mut line).expect("memory can be read");
        let line = line.strip_suffix(b" -\n").expect("the source is empty");
        let Ok(AssemblyStep::ReadBytes(count)) = assembler.push_line(line) else { panic!("announces bytes") };
        let mut bytes = Vec::new();
        output.by_ref().take(count).read_to_end(&mut bytes).expect("memory can be read");
        if let AssemblyStep::Complete(Reply { outcome: ReplyOutcome::Parts(parts), .. }) =
            assembler.push_bytes(bytes.into())
        {
            return (parts, output.position() as usize);
        }
    }
}
