//! The files in `tests/fixtures/wire/session`: the bytes of every header (frame 0), tree and growth (frame 1) of a session.
//! Frames with payload are sent as they are.
//!
//! Names of variants are on the wire, and so are the names of fields in all headers but requests and replies; in those the
//! order of fields decides. These files notice when a rename or a moved field changes the bytes, which neither the compiler
//! nor a test that encodes and decodes notices.
//!
//! A file is `MESSAGE.bin` or `MESSAGE.DETAIL.bin`. A new message or variant gets a value in [`headers`] with a `DETAIL` of its
//! own; `write_missing_fixtures` writes its file and never changes one that is there. A file is deleted only together with
//! a new oldest version in [`SESSION_VERSIONS`](super::SESSION_VERSIONS), because peers of the old version still send those
//! bytes; those of `open` and `refused` never, because these are the same in all versions.

mod accepted;
mod headers;
mod trees;
mod variants;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use bytes::Bytes;
use peernet_logger::{Tree, TreeDelta};

use super::{Header, decode_tree, decode_tree_delta, encode_tree, encode_tree_delta};

/// Files by name.
type Files = BTreeMap<String, Bytes>;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/wire/session")
}

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

/// What a file holds.
enum Content {
    Header(Header),
    Tree(Tree),
    TreeDelta(TreeDelta),
}

impl Content {
    /// Decodes a frame. Which frame of a message it is, is known from its place in the message, and here from the file's
    /// name.
    fn decode(file: &str, frame: &[u8]) -> Self {
        let content = match file.split('.').next() {
            Some(variants::TREE_NAME) => {
                decode_tree(frame).map(Self::Tree).map_err(|error| error.to_string())
            }
            Some(variants::GROWTH_NAME) => {
                decode_tree_delta(frame).map(Self::TreeDelta).map_err(|error| error.to_string())
            }
            _ => Header::decode(frame).map(Self::Header).map_err(|error| error.to_string()),
        };
        content.unwrap_or_else(|error| panic!("{file} cannot be decoded any more: {error}"))
    }

    fn encode(&self) -> Bytes {
        match self {
            Self::Header(header) => header.encode().expect("the headers of the fixtures are short"),
            Self::Tree(tree) => encode_tree(tree).expect("the trees of the fixtures are small"),
            Self::TreeDelta(delta) => {
                encode_tree_delta(delta).expect("the growths of the fixtures are small")
            }
        }
    }

    /// Returns the part of the file's name that stands before the first dot.
    fn name(&self) -> &'static str {
        match self {
            Self::Header(header) => variants::header_name(header),
            Self::Tree(_) => variants::TREE_NAME,
            Self::TreeDelta(_) => variants::GROWTH_NAME,
        }
    }
}

/// The frames of all values by the names of their files.
fn values() -> Files {
    let headers = headers::headers().into_iter().map(|(detail, header)| (detail, Content::Header(header)));
    let mut files = Files::new();
    for (detail, content) in headers.chain(trees::contents()) {
        let dot = if detail.is_empty() { "" } else { "." };
        let file = format!("{}{dot}{detail}.bin", content.name());
        assert!(files.insert(file.clone(), content.encode()).is_none(), "two values have the file {file}");
    }
    files
}

#[test]
#[ignore = "writes the files of new messages"]
fn write_missing_fixtures() {
    fs::create_dir_all(folder()).expect("the folder of the fixtures can be made");
    for (file, frame) in values() {
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
        assert_eq!(file.split('.').next(), Some(content.name()), "{file} holds another message");
        assert!(content.encode() == frame, "{file}: decoding loses or changes something");
    }
}

/// Notices two fields of one type that changed places: those are encoded to the bytes that were decoded all the same.
#[test]
fn value_is_encoded_as_in_its_fixture() {
    let files = files();
    let values = values();
    assert_eq!(
        files.keys().collect::<Vec<_>>(),
        values.keys().collect::<Vec<_>>(),
        "a file or a value is missing"
    );
    for (file, frame) in &values {
        assert!(*frame == files[file], "the bytes of {file} changed: other versions cannot read them");
    }
}
