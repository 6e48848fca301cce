//! Lines that are exchanged with a controller: actions are encoded, feedback is decoded. No I/O.

use peernet_external::python::TREE;
use peernet_sample::{ElementType, MediaType, Part, Sample, escaped_line};
use serde::de::Error as _;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{Action, Feedback, SocketError};

/// Longest line in either direction, with its line feed, bytes: the largest payload of a UDP datagram over IPv4.
pub(super) const MAX_LINE_BYTES: usize = 65_507;
/// Longest part of a line that an error quotes, bytes.
const MAX_QUOTED_BYTES: usize = 120;

/// A line to the controller.
#[derive(Serialize)]
struct ActionLine<'a> {
    iteration: u64,
    episode: u32,
    step: u32,
    source: &'a str,
    answer: Value,
}

/// A line of feedback. A missing key or `null` means that the controller did not report this value.
// The line is not read as a `Value`, which would accept a key that occurs twice.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FeedbackLine {
    iteration: Option<u64>,
    episode_ended: Option<bool>,
    success: Option<bool>,
    reward: Option<f64>,
}

/// Returns the line for an action, with its line feed.
pub(super) fn encode(action: &Action<'_>) -> Result<Vec<u8>, SocketError> {
    let Action { answer, source, iteration, episode, step } = *action;
    // An array element takes at most eight bytes in the payload of an answer, and at least one byte in JSON. A payload
    // above this limit cannot become a line, so no memory is spent on its JSON form.
    if answer.payload_bytes() > 8 * MAX_LINE_BYTES as u64 {
        return Err(SocketError::AnswerLength { limit: MAX_LINE_BYTES });
    }
    let action_line = ActionLine { iteration, episode, step, source, answer: answer_value(answer)? };
    let mut line =
        serde_json::to_vec(&action_line).map_err(|error| SocketError::InvalidAnswer(error.to_string()))?;
    line.push(b'\n');
    if line.len() > MAX_LINE_BYTES {
        Err(SocketError::AnswerLength { limit: MAX_LINE_BYTES })
    } else {
        Ok(line)
    }
}

/// Reads a line of feedback: the number of its iteration, if the line has one, and the feedback.
pub(super) fn decode(line: &[u8]) -> Result<(Option<u64>, Feedback), serde_json::Error> {
    if line.trim_ascii_start().first().is_some_and(|byte| *byte != b'{') {
        // Without this check a list would be read as the values of the keys in their order.
        return Err(serde_json::Error::custom("it is not a JSON object"));
    }
    let FeedbackLine { iteration, episode_ended, success, reward } = serde_json::from_slice(line)?;
    Ok((iteration, Feedback { episode_ended: episode_ended.unwrap_or(false), success, reward }))
}

/// Returns the beginning of a line, for messages.
pub(super) fn quote(line: &[u8]) -> String {
    escaped_line(&line[..line.len().min(MAX_QUOTED_BYTES)])
}

/// Returns an answer as JSON: the value of its only part, or a list of the values of its parts.
fn answer_value(answer: &Sample) -> Result<Value, SocketError> {
    match answer.parts.as_slice() {
        [part] => part_value(part),
        parts => Ok(Value::Array(parts.iter().map(part_value).collect::<Result<_, _>>()?)),
    }
}

fn part_value(part: &Part) -> Result<Value, SocketError> {
    let invalid = |error: &dyn std::fmt::Display| SocketError::InvalidAnswer(error.to_string());
    let description = &part.description;
    match (&description.media, description.element) {
        (MediaType::Json, _) => serde_json::from_slice(&part.bytes).map_err(|error| invalid(&error)),
        (MediaType::Text, _) => {
            Ok(Value::from(std::str::from_utf8(&part.bytes).map_err(|error| invalid(&error))?))
        }
        (MediaType::Tensor, Some(element)) => {
            if description.shaped_bytes() != Some(part.bytes.len() as u64) {
                return Err(invalid(&"an array does not match its shape"));
            }
            let shape: Vec<usize> = description.shape.iter().map(|length| *length as usize).collect();
            array(element, &shape, &part.bytes)
        }
        // A value of Python that JSON cannot represent arrives as a tree.
        (media, _) if media.iana() == TREE => match non_finite_number(&part.bytes) {
            Some(number) => Err(SocketError::NotFinite(number)),
            None => Err(SocketError::AnswerType(media.iana().into_owned())),
        },
        (media, _) => Err(SocketError::AnswerType(media.iana().into_owned())),
    }
}

/// Returns the first non-finite number in a tree, which JSON does not have. Python writes such a number as `NaN`,
/// `Infinity` or `-Infinity`.
fn non_finite_number(tree: &[u8]) -> Option<f64> {
    let (mut is_in_string, mut is_escaped, mut is_negative) = (false, false, false);
    for byte in tree {
        match byte {
            _ if std::mem::take(&mut is_escaped) => {}
            b'\\' => is_escaped = is_in_string,
            b'"' => is_in_string = !is_in_string,
            // Outside of strings, all letters in JSON are lower case.
            b'N' if !is_in_string => return Some(f64::NAN),
            b'I' if !is_in_string => {
                return Some(if is_negative { f64::NEG_INFINITY } else { f64::INFINITY });
            }
            _ => {}
        }
        is_negative = *byte == b'-';
    }
    None
}

/// Returns an array of numbers as nested lists.
fn array(element: ElementType, shape: &[usize], bytes: &[u8]) -> Result<Value, SocketError> {
    let Some((length, inner)) = shape.split_first() else { return number(element, bytes) };
    let row_bytes = bytes.len().checked_div(*length).unwrap_or(0);
    // An array without elements becomes one empty list. The lengths of its other dimensions may be huge, so nested
    // lists could take any amount of memory.
    if row_bytes == 0 {
        return Ok(Value::Array(Vec::new()));
    }
    let rows = bytes.chunks(row_bytes);
    Ok(Value::Array(rows.map(|row| array(element, inner, row)).collect::<Result<_, _>>()?))
}

/// Returns the number that is stored in `bytes`, little-endian.
fn number(element: ElementType, bytes: &[u8]) -> Result<Value, SocketError> {
    let mut padded = [0; 8];
    for (to, from) in padded.iter_mut().zip(bytes) {
        *to = *from;
    }
    let bits = u64::from_le_bytes(padded);
    let [low, ..] = padded;
    let float = |value: f64| {
        if value.is_finite() { Ok(Value::from(value)) } else { Err(SocketError::NotFinite(value)) }
    };
    Ok(match element {
        ElementType::Bool => Value::from(low != 0),
        ElementType::U8 | ElementType::U16 | ElementType::U32 | ElementType::U64 => Value::from(bits),
        ElementType::I8 => Value::from(low.cast_signed()),
        ElementType::I16 => Value::from((bits as u16).cast_signed()),
        ElementType::I32 => Value::from((bits as u32).cast_signed()),
        ElementType::I64 => Value::from(bits.cast_signed()),
        ElementType::F32 => float(f64::from(f32::from_bits(bits as u32)))?,
        ElementType::F64 => float(f64::from_bits(bits))?,
        other @ (ElementType::F16 | ElementType::C64 | ElementType::C128) => {
            return Err(SocketError::AnswerType(format!("array of {other:?}")));
        }
    })
}

#[cfg(test)]
mod tests {
    use peernet_sample::Description;

    use super::*;

    fn encoded(answer: &Sample) -> Result<String, String> {
        let action = Action { iteration: 7, episode: 2, step: 3, ..Action::first(answer, "left \"eye\"") };
        let line = encode(&action).map_err(|error| error.to_string())?;
        Ok(String::from_utf8(line).expect("is JSON"))
    }

    fn tensor(element: ElementType, shape: &[u32], bytes: Vec<u8>) -> Sample {
        let description =
            Description { media: MediaType::Tensor, shape: shape.to_vec(), element: Some(element) };
        Sample::from_part(description, bytes.into())
    }

    fn unshaped(media: MediaType, text: &str) -> Sample {
        Sample::from_part(Description::unshaped(media), text.as_bytes().to_vec().into())
    }

    #[test]
    fn line_contains_position_source_and_answer() {
        let answer = unshaped(MediaType::Json, r#"{"label": "go", "x": [1, 2.5]}"#);
        let expected = "{\"iteration\":7,\"episode\":2,\"step\":3,\"source\":\"left \\\"eye\\\"\",\
                        \"answer\":{\"label\":\"go\",\"x\":[1,2.5]}}\n";
        assert_eq!(encoded(&answer).as_deref(), Ok(expected));
        let text = encoded(&unshaped(MediaType::Text, "stop\n")).expect("is text");
        assert!(text.ends_with("\"answer\":\"stop\\n\"}\n"), "{text}");
    }

    #[test]
    fn arrays_are_nested_lists_of_numbers() {
        let floats: Vec<u8> =
            [0.5_f32, -1.0, 2.0, 3.0].iter().flat_map(|value| value.to_le_bytes()).collect();
        let expect_answer = |answer: &Sample, end: &str| {
            let line = encoded(answer).expect("is encoded");
            assert!(line.ends_with(&format!("\"answer\":{end}}}\n")), "{line}");
        };
        expect_answer(&tensor(ElementType::F32, &[2, 2], floats.clone()), "[[0.5,-1.0],[2.0,3.0]]");
        expect_answer(&tensor(ElementType::F32, &[4, 1], floats), "[[0.5],[-1.0],[2.0],[3.0]]");
        expect_answer(&tensor(ElementType::I16, &[2], vec![255, 255, 1, 0]), "[-1,1]");
        expect_answer(&tensor(ElementType::U8, &[], vec![200]), "200");
        expect_answer(&tensor(ElementType::Bool, &[2], vec![1, 0]), "[true,false]");
        expect_answer(&tensor(ElementType::F64, &[2, 0], Vec::new()), "[]");
        let mut two_parts = tensor(ElementType::U8, &[1], vec![1]);
        two_parts.parts.extend(unshaped(MediaType::Text, "b").parts);
        expect_answer(&two_parts, "[[1],\"b\"]");
    }

    #[test]
    fn feedback_line_may_name_its_iteration() {
        let feedback = Feedback { success: Some(true), ..Feedback::default() };
        let read = |line: &str| decode(line.as_bytes()).map_err(|error| error.to_string());
        assert_eq!(read(r#"{"iteration": 7, "success": true}"#), Ok((Some(7), feedback)));
        assert_eq!(read(r#"{"success": true}"#), Ok((None, feedback)));
        let nothing = r#"{"iteration":null,"reward":null,"success":null,"episode_ended":null}"#;
        assert_eq!(read(nothing), Ok((None, Feedback::default())));
        assert_eq!(read("{}"), Ok((None, Feedback::default())));
        for wrong in [r#"{"iteration": "7"}"#, r#"{"succes": true}"#, "null", "[]", "[7]", "3", "", "{} {}"] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
        let error = read(r#"{"reward":1,"reward":2}"#).expect_err("has two rewards");
        assert!(error.contains("duplicate field `reward`"), "{error}");
    }

    #[test]
    fn answers_without_json_form_are_refused() {
        let expect_error = |answer: &Sample, part: &str| {
            let error = encoded(answer).expect_err(part);
            assert!(error.contains(part), "{error}");
        };
        expect_error(&tensor(ElementType::F32, &[1], f32::NAN.to_le_bytes().to_vec()), "contains NaN");
        let tree = |json: &str| unshaped(MediaType::from_iana(TREE), json);
        expect_error(
            &tree(r#"{"dict":[["x",NaN]]}"#),
            "the model's answer contains NaN, which JSON does not have",
        );
        expect_error(&tree("[1.5,-Infinity]"), "the model's answer contains -inf, which JSON does not have");
        // `NaN` in a string is not a number, so the error names the type.
        expect_error(&tree(r#"{"dict":[[1,"NaN \"N"]]}"#), "type application/x-python-tree");
        expect_error(&tensor(ElementType::F16, &[1], vec![0, 0]), "type array of F16");
        expect_error(&tensor(ElementType::F32, &[3], vec![0; 4]), "does not match its shape");
        expect_error(&unshaped(MediaType::Jpeg, "abc"), "type image/jpeg");
        expect_error(&unshaped(MediaType::Json, "{"), "is not valid");
        expect_error(&unshaped(MediaType::Text, &"x".repeat(MAX_LINE_BYTES)), "more than 65507 bytes");
        // This payload is refused before it is converted to JSON.
        expect_error(&tensor(ElementType::U8, &[600_000], vec![0; 600_000]), "more than 65507 bytes");
    }
}
