//! The file `model.onnx`: a check of its format, and the names of the files that contain its weights.
//!
//! ONNX stores a model as a protocol buffer of type `ModelProto`. The numbers of a tensor are in the file itself or
//! in another file ("external data"), for example if a model is larger than 2 GB. The path of that file is relative
//! to the model's folder. This module reads the few fields that lead to tensors and skips all others without reading
//! them, so that a model of 500 MB takes a few milliseconds.
// Sources: https://protobuf.dev/programming-guides/encoding and onnx/onnx.proto3, whose field numbers never change.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Component, Path, PathBuf};

use super::{MODEL, regular_file};
use crate::LoadError;

/// Maximum depth of nested messages. A graph in an attribute of a node, such as the body of a loop, is three levels
/// deeper than the graph of the node.
const MAX_DEPTH: u32 = 100;

/// Beginning of the small file that Git LFS stores in place of a large file until the large file is fetched.
const GIT_LFS_POINTER: &[u8] = b"version https://git-lfs";

/// Maximum length of the path of a data file, bytes.
const MAX_PATH: u64 = 4096;

/// Message of `onnx.proto3` that leads to a tensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Message {
    Model,
    Function,
    Graph,
    Node,
    Attribute,
    SparseTensor,
    Tensor,
    /// Entry of `external_data`: a key and a value.
    Entry,
}

impl Message {
    /// Returns the message in a field of this number; `None` if the field does not lead to a tensor.
    fn in_field(self, number: u64) -> Option<Self> {
        // The numbers of the fields are those of onnx.proto3.
        Some(match (self, number) {
            (Self::Model, 7) | (Self::Attribute, 6 | 11) => Self::Graph,
            (Self::Model, 25) => Self::Function,
            (Self::Function, 7) | (Self::Graph, 1) => Self::Node,
            (Self::Node, 5) => Self::Attribute,
            (Self::Graph, 15) | (Self::Attribute, 22 | 23) => Self::SparseTensor,
            (Self::Graph, 5) | (Self::Attribute, 5 | 10) | (Self::SparseTensor, 1 | 2) => Self::Tensor,
            (Self::Tensor, 13) => Self::Entry,
            _ => return None,
        })
    }
}

/// Reason why a file is not a usable model.
#[derive(Debug, thiserror::Error)]
enum ModelFileError {
    #[error(transparent)]
    Io(#[from] io::Error),
    #[error("it is not an ONNX model, or is incomplete: {0}")]
    Form(&'static str),
    #[error("it is not an ONNX model but a pointer of Git LFS; run `git lfs pull` in its repository")]
    Pointer,
    #[error(
        "its weights are in {0:?}; put that file into the model's folder, and its name alone into the model (onnx.save_model with location=)"
    )]
    Outside(String),
}

/// Returns the ONNX files in a model's folder: `model.onnx`, then the files of its weights in the order of their names.
///
/// # Errors
/// If `model.onnx` is missing or not an ONNX model, or names a file outside the folder.
pub(crate) fn model_files(folder: &Path) -> Result<Vec<PathBuf>, LoadError> {
    let file = folder.join(MODEL);
    match data_files(&file) {
        Ok(names) => Ok([file].into_iter().chain(names.iter().map(|name| folder.join(name))).collect()),
        Err(error) => Err(LoadError::File { file, reason: error.to_string() }),
    }
}

fn data_files(file: &Path) -> Result<BTreeSet<PathBuf>, ModelFileError> {
    let file = regular_file::open(file)?;
    let length = file.metadata()?.len();
    let mut file = BufReader::new(file);
    if file.fill_buf()?.starts_with(GIT_LFS_POINTER) {
        return Err(ModelFileError::Pointer);
    }
    let mut reader = ModelReader { file, position: 0, graphs: 0, data_files: BTreeSet::new() };
    reader.read_message(Message::Model, length, 0)?;
    if reader.graphs == 0 {
        return Err(ModelFileError::Form("it contains no graph"));
    }
    Ok(reader.data_files)
}

/// Reader of `model.onnx`, with the number of graphs and the names of data files that it has found so far.
struct ModelReader {
    file: BufReader<File>,
    /// Position in the file, bytes.
    position: u64,
    graphs: u64,
    data_files: BTreeSet<PathBuf>,
}

impl ModelReader {
    /// Reads the fields of a message that ends at `end`.
    fn read_message(&mut self, message: Message, end: u64, depth: u32) -> Result<(), ModelFileError> {
        if depth > MAX_DEPTH {
            return Err(ModelFileError::Form("messages are nested too deeply"));
        }
        self.graphs += u64::from(message == Message::Graph);
        if message == Message::Entry {
            return self.read_entry(end);
        }
        while self.position < end {
            let (number, field_end) = self.read_field(end)?;
            match message.in_field(number) {
                Some(inner) => self.read_message(inner, field_end, depth + 1)?,
                None => self.skip_to(field_end)?,
            }
        }
        Ok(())
    }

    /// Reads an entry of `external_data`; keeps the value of the key `location`.
    fn read_entry(&mut self, end: u64) -> Result<(), ModelFileError> {
        let (mut key, mut value) = (String::new(), String::new());
        while self.position < end {
            let (number, field_end) = self.read_field(end)?;
            match number {
                1 => key = self.read_text(field_end)?,
                2 => value = self.read_text(field_end)?,
                _ => self.skip_to(field_end)?,
            }
        }
        if key != "location" {
            return Ok(());
        }
        let path = PathBuf::from(&value);
        let is_inside =
            !value.is_empty() && path.components().all(|part| matches!(part, Component::Normal(_)));
        if !is_inside {
            return Err(ModelFileError::Outside(value));
        }
        self.data_files.insert(path);
        Ok(())
    }

    /// Reads the tag of a field, and the length if the field has one. Returns the number of the field and the position
    /// of the field's end.
    fn read_field(&mut self, end: u64) -> Result<(u64, u64), ModelFileError> {
        let tag = self.read_varint()?;
        // No field has the number 0. If a file was received only in part, the rest often consists of zeros.
        if tag >> 3 == 0 {
            return Err(ModelFileError::Form("it has a field with the number 0"));
        }
        let field_end = match tag & 7 {
            0 => {
                self.read_varint()?;
                Some(self.position)
            }
            1 => self.position.checked_add(8),
            2 => {
                let length = self.read_varint()?;
                self.position.checked_add(length)
            }
            5 => self.position.checked_add(4),
            // Groups (types 3 and 4) do not exist in proto3.
            _ => return Err(ModelFileError::Form("it has a field of an unknown type")),
        };
        match field_end {
            // The tag or the length itself may extend beyond the end of the message.
            Some(field_end) if field_end <= end && self.position <= end => Ok((tag >> 3, field_end)),
            _ => Err(ModelFileError::Form("a field is longer than its message")),
        }
    }

    fn read_varint(&mut self) -> Result<u64, ModelFileError> {
        let mut number = 0_u64;
        for shift in (0..64).step_by(7) {
            let mut byte = [0];
            self.file.read_exact(&mut byte).map_err(|error| match error.kind() {
                io::ErrorKind::UnexpectedEof => ModelFileError::Form("it ends within a field"),
                _ => ModelFileError::Io(error),
            })?;
            self.position += 1;
            number |= u64::from(byte[0] & 0x7f) << shift;
            if byte[0] < 0x80 {
                return Ok(number);
            }
        }
        Err(ModelFileError::Form("it has a number of more than 64 bits"))
    }

    fn read_text(&mut self, end: u64) -> Result<String, ModelFileError> {
        let length = end - self.position;
        if length > MAX_PATH {
            return Err(ModelFileError::Form("the name of a data file is too long"));
        }
        let mut bytes = Vec::new();
        self.file.by_ref().take(length).read_to_end(&mut bytes)?;
        self.position = end;
        String::from_utf8(bytes).map_err(|_| ModelFileError::Form("the name of a data file is not text"))
    }

    fn skip_to(&mut self, end: u64) -> Result<(), ModelFileError> {
        let length = i64::try_from(end - self.position)
            .map_err(|_| ModelFileError::Form("a field is longer than a file can be"))?;
        // `seek` would discard the buffer after each field.
        self.file.seek_relative(length)?;
        self.position = end;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a field with these contents.
    fn field(number: u8, contents: &[u8]) -> Vec<u8> {
        let length = u8::try_from(contents.len()).expect("short");
        [&[number << 3 | 2, length], contents].concat()
    }

    /// Returns a model with a tensor whose numbers are in a file.
    fn model(location: &str) -> Vec<u8> {
        let entry = [field(1, b"location"), field(2, location.as_bytes())].concat();
        let offset = [field(1, b"offset"), field(2, b"0")].concat();
        let tensor = [field(8, b"weights"), field(13, &offset), field(13, &entry)].concat();
        field(7, &field(5, &tensor))
    }

    fn found(bytes: &[u8]) -> Result<Vec<String>, String> {
        let folder = tempfile::tempdir().expect("writable");
        std::fs::write(folder.path().join(MODEL), bytes).expect("written");
        let files = model_files(folder.path()).map_err(|error| error.to_string())?;
        let name = |file: &PathBuf| file.strip_prefix(folder.path()).expect("within").display().to_string();
        Ok(files.iter().map(name).collect())
    }

    #[test]
    fn data_files_of_tensors_are_found() {
        assert_eq!(found(&model("weights.bin")).expect("a model"), [MODEL, "weights.bin"]);
        assert_eq!(found(&field(7, &field(2, b"name"))).expect("a model"), [MODEL]);
        // A constant in the branch of a condition: graph, node, attribute, graph, initialiser. `[2..]`
        // removes the tag and the length of the outer field, so that only the graph of `model` remains.
        let nested = field(7, &field(1, &field(5, &field(6, &model("then.bin")[2..]))));
        assert_eq!(found(&nested).expect("a model"), [MODEL, "then.bin"]);
    }

    #[test]
    fn data_file_outside_the_folder_is_refused() {
        for location in ["../other.bin", "/etc/passwd", "a/../../b", ""] {
            let error = found(&model(location)).expect_err(location);
            assert!(error.contains("put that file into the model's folder"), "{error}");
        }
    }

    #[test]
    fn truncated_or_foreign_file_is_refused() {
        let whole = model("weights.bin");
        for length in 0..whole.len() {
            assert!(found(&whole[..length]).is_err(), "{length} bytes");
        }
        let padded = [field(7, &field(2, b"name")), vec![0; 4096]].concat();
        assert!(found(&padded).expect_err("padded").contains("a field with the number 0"));
        for foreign in [&b"abc"[..], b"\x89PNG\r\n\x1a\n", b"version https://git-lfs.github.com/spec/v1\n"] {
            let error = found(foreign).expect_err("not a model");
            assert!(error.contains("not an ONNX model"), "{error}");
        }
    }
}
