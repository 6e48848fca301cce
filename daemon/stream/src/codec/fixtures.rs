//! Fixtures in `tests/fixtures/wire/event-stream`: the bytes of every message of the event stream and of every event.
//!
//! The wire form contains the names of variants, and the order of fields determines the meaning of a value. These files
//! detect when a renamed variant or a moved field changes the bytes, which neither the compiler nor a test that encodes
//! and decodes detects.
//!
//! A file is `MESSAGE.bin` or `MESSAGE.DETAIL.bin`. A new message or variant gets a value in [`messages`] or [`events`]
//! with its own `DETAIL`; `write_missing_fixtures` writes its file and never changes an existing file. A file is
//! deleted only together with a new oldest version in [`STREAM_VERSIONS`](super::super::STREAM_VERSIONS), because
//! agents of the old version still send those bytes. Files of hellos and refusals are never deleted, because these
//! messages are the same in all versions.

mod events;
mod messages;
mod trees;
mod variants;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::*;

/// Frames by file name.
type Files = BTreeMap<String, Bytes>;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/wire/event-stream")
}

/// Reads all fixtures.
fn files() -> Files {
    let folder = folder();
    let entries = fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    entries
        .map(|entry| {
            let entry = entry.expect("the folder of the fixtures can be listed");
            let bytes = fs::read(entry.path()).expect("a fixture can be read");
            (entry.file_name().to_string_lossy().into_owned(), bytes.into())
        })
        .collect()
}

/// Decoded content of a file.
enum Content {
    ToAggregator(Box<ToAggregator>),
    ToAgent(ToAgent),
    Batch(BatchHead, Vec<Event>),
    Part(Part),
}

impl Content {
    /// Decodes a frame. Batches and parts are recognised by their first bytes, as in the receiver. The direction of any
    /// other message follows from the file's name; a receiver knows the direction from its connection.
    fn decode(file: &str, frame: &Bytes) -> Self {
        if let Some(head) = decode_batch_head(frame) {
            let body = expect_readable(file, decode_batch_body(frame.clone()));
            return Self::Batch(head, expect_readable(file, decode_events(&body, head.events)));
        }
        if let Some(part) = decode_part(frame) {
            return Self::Part(part);
        }
        if file.starts_with("to-agent-") {
            return Self::ToAgent(expect_readable(file, decode(frame)));
        }
        Self::ToAggregator(Box::new(expect_readable(file, decode(frame))))
    }

    /// Returns the frame without compression.
    fn encode(&self) -> Vec<u8> {
        match self {
            Self::ToAggregator(message) => encode(&**message),
            Self::ToAgent(message) => encode(message),
            Self::Batch(head, events) => encode_batch(head, &body_of(events), false),
            Self::Part(part) => encode_part(part),
        }
    }

    /// Returns the part of the file's name before the first dot.
    fn name(&self) -> &'static str {
        match self {
            Self::ToAggregator(message) => variants::to_aggregator_name(message),
            Self::ToAgent(message) => variants::to_agent_name(message),
            Self::Batch(..) => variants::BATCH_NAME,
            Self::Part(_) => variants::PART_NAME,
        }
    }
}

fn expect_readable<T>(file: &str, result: Result<T, CodecError>) -> T {
    result.unwrap_or_else(|error| panic!("{file} cannot be read any more: {error}"))
}

fn body_of(events: &[Event]) -> Vec<u8> {
    let mut body = Vec::new();
    events.iter().for_each(|event| encode_into(&mut body, event));
    body
}

/// Returns the uncompressed form of a frame.
///
/// Frames are compared in this form, because another version of Zstandard may compress to other bytes, which every
/// version can read.
fn uncompressed(file: &str, frame: &Bytes) -> Vec<u8> {
    if let Some(compressed) = frame.strip_prefix(&[FRAME_MARKER, COMPRESSED]) {
        return expect_readable(file, decompress_message(compressed));
    }
    if !frame.starts_with(&[FRAME_MARKER, ZSTD]) {
        return frame.to_vec();
    }
    let body = expect_readable(file, decode_batch_body(frame.clone()));
    [&[FRAME_MARKER, PLAIN][..], &frame[2..BATCH_HEAD_BYTES], &body[..]].concat()
}

#[test]
#[ignore = "writes the files of new messages"]
fn write_missing_fixtures() {
    fs::create_dir_all(folder()).expect("the folder of the fixtures can be made");
    for (file, frame) in messages::encoded_values() {
        let path = folder().join(file);
        if !path.exists() {
            fs::write(path, frame).expect("a fixture can be written");
        }
    }
}

#[test]
fn decoded_fixture_is_encoded_to_same_bytes() {
    for (file, frame) in files() {
        let content = Content::decode(&file, &frame);
        assert_eq!(
            file.split('.').next(),
            Some(content.name()),
            "the name of {file} is that of another message"
        );
        assert!(
            content.encode() == uncompressed(&file, &frame),
            "{file}: decoding and encoding changes the bytes"
        );
    }
}

/// Detects two fields of the same type that changed places. Decoding and encoding does not detect this change, because
/// both use the new order.
#[test]
fn value_is_encoded_as_in_its_fixture() {
    let files = files();
    let values = messages::encoded_values();
    assert_eq!(
        files.keys().collect::<Vec<_>>(),
        values.keys().collect::<Vec<_>>(),
        "left: files; right: values"
    );
    for (file, frame) in &values {
        assert!(
            uncompressed(file, frame) == uncompressed(file, &files[file]),
            "the bytes of {file} changed: other versions cannot read them"
        );
    }
}

#[test]
fn fixtures_named_compressed_have_compressed_form() {
    let form = |file: &str| files().get(file).map(|frame| [frame[0], frame[1]]);
    assert_eq!(form("batch.filled.bin"), Some([FRAME_MARKER, PLAIN]));
    assert_eq!(form("batch.compressed.bin"), Some([FRAME_MARKER, ZSTD]));
    assert_eq!(form("to-aggregator-live.compressed.bin"), Some([FRAME_MARKER, COMPRESSED]));
}
