//! Splitting of lines into words.

use super::error::FramingError;

/// Longest part of a line that an error quotes, bytes.
const MAX_SHOWN_BYTES: usize = 120;

/// Returns a line as text, without a carriage return at its end.
pub(super) fn text(line: &[u8]) -> Result<&str, FramingError> {
    let line = line.strip_suffix(b"\r").unwrap_or(line);
    std::str::from_utf8(line).map_err(|_| FramingError::NotText(shorten(&String::from_utf8_lossy(line))))
}

/// Splits a line into its first word and the rest.
pub(super) fn split_first_word(line: &str) -> (&str, &str) {
    let (word, rest) = line.split_once(' ').unwrap_or((line, ""));
    (word, rest.trim())
}

/// Returns the beginning of a line, for messages.
pub(super) fn shorten(line: &str) -> String {
    let end = line.floor_char_boundary(MAX_SHOWN_BYTES);
    if end < line.len() { format!("{}…", &line[..end]) } else { line.to_owned() }
}
