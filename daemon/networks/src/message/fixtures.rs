//! Tests that compare the wire form of the session protocol with the files in `tests/fixtures/wire/session`.
//!
//! A file holds the bytes of a header (frame 0), or of a tree or a tree delta (frame 1). Payload frames have no
//! fixtures because they are sent unchanged.
//!
//! The names of variants are on the wire. So are the names of fields in all headers except requests and replies, whose
//! fields are identified by their order. The files detect a rename or a moved field that changes the bytes. Neither the
//! compiler nor a test that encodes and decodes detects such a change.
//!
//! A file is called `MESSAGE.bin` or `MESSAGE.DETAIL.bin`. A new message or variant gets a value in [`headers`] with a
//! new `DETAIL`; `write_missing_fixtures` writes its file and never changes an existing one. A file is deleted only
//! when [`SESSION_VERSIONS`](super::SESSION_VERSIONS) gets a new oldest version, because peers of the old version still
//! send those bytes. The files of `open` and `refused` are never deleted, because these messages are the same in all
//! versions.

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

/// Contents of fixture files by file name.
type FixtureFiles = BTreeMap<String, Bytes>;

fn fixture_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/wire/session")
}

/// Reads all fixture files.
fn files() -> FixtureFiles {
    let fixture_folder = fixture_folder();
    let entries =
        fs::read_dir(&fixture_folder).unwrap_or_else(|error| panic!("{}: {error}", fixture_folder.display()));
    entries
        .map(|entry| {
            let entry = entry.expect("the folder of the fixtures can be listed");
            let bytes = fs::read(entry.path()).expect("a fixture can be read");
            (entry.file_name().to_string_lossy().into_owned(), bytes.into())
        })
        .collect()
}

/// The decoded content of a fixture file.
enum Content {
    Header(Header),
    Tree(Tree),
    TreeDelta(TreeDelta),
}

impl Content {
    /// Decodes a frame. A frame does not say which kind it is: a peer knows the kind from the frame's position in
    /// the message, and this function from the file's name.
    fn decode(file: &str, frame: &[u8]) -> Self {
        let content = match file.split('.').next() {
            Some(variants::TREE_NAME) => {
                decode_tree(frame).map(Self::Tree).map_err(|error| error.to_string())
            }
            Some(variants::DELTA_NAME) => {
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
                encode_tree_delta(delta).expect("the tree deltas of the fixtures are small")
            }
        }
    }

    /// Returns the message that the content belongs to: the part of the file name before the first dot.
    fn name(&self) -> &'static str {
        match self {
            Self::Header(header) => variants::header_name(header),
            Self::Tree(_) => variants::TREE_NAME,
            Self::TreeDelta(_) => variants::DELTA_NAME,
        }
    }
}

/// Returns the encoded frames of all values by file name.
fn values() -> FixtureFiles {
    let headers = headers::headers().into_iter().map(|(detail, header)| (detail, Content::Header(header)));
    let mut files = FixtureFiles::new();
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
    fs::create_dir_all(fixture_folder()).expect("the folder of the fixtures can be made");
    for (file, frame) in values() {
        let path = fixture_folder().join(file);
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
            "the name of {file} does not fit the message in it"
        );
        assert!(content.encode() == frame, "{file}: decoding loses or changes something");
    }
}

/// Detects two fields of one type that changed places: decoding and encoding again would give the same bytes.
#[test]
fn value_is_encoded_as_in_its_fixture() {
    let files = files();
    let values = values();
    assert_eq!(
        files.keys().collect::<Vec<_>>(),
        values.keys().collect::<Vec<_>>(),
        "each value needs a file, and each file a value"
    );
    for (file, frame) in &values {
        assert!(*frame == files[file], "the bytes of {file} changed: other versions cannot read them");
    }
}
