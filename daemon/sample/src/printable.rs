//! Replacement of control characters in untrusted texts, for terminals, logs, tables and pages.

use std::borrow::Cow;

/// Returns the text in one printable line: each character that would control a terminal, break the line or reorder
/// the following text becomes a space. The number of characters stays the same.
pub fn printable_line(text: &str) -> Cow<'_, str> {
    replace_chars(text, is_unprintable)
}

/// Returns the text as [`printable_line`] does, but keeps line feeds; for texts of several lines, such as tracebacks.
pub fn printable_lines(text: &str) -> Cow<'_, str> {
    replace_chars(text, |char| char != '\n' && is_unprintable(char))
}

/// Returns bytes as one line of text. An escape such as `\u{1b}` or `\xff` stands for each byte that is not valid UTF-8
/// and for each character that [`printable_line`] replaces, so that a reader sees which bytes were written.
pub fn escaped_line(bytes: &[u8]) -> String {
    let mut line = String::with_capacity(bytes.len());
    for chunk in bytes.utf8_chunks() {
        for char in chunk.valid().chars() {
            if is_unprintable(char) {
                line.extend(char.escape_default());
            } else {
                line.push(char);
            }
        }
        line.extend(chunk.invalid().iter().flat_map(|byte| byte.escape_ascii()).map(char::from));
    }
    line
}

fn replace_chars(text: &str, is_replaced: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&is_replaced) {
        return Cow::Borrowed(text);
    }
    Cow::Owned(text.chars().map(|char| if is_replaced(char) { ' ' } else { char }).collect())
}

fn is_unprintable(char: char) -> bool {
    match char {
        // Separators of lines and paragraphs.
        '\u{2028}' | '\u{2029}' => true,
        // Embeddings, overrides and isolates of the Unicode Bidirectional Algorithm: the text after them may be shown
        // in another order. Direction marks, which change no other character, stay.
        '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => true,
        _ => char.is_control(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn printable_text_is_not_copied() {
        for text in ["", "a label with ünïcode, 日本語 and \u{200f}marks"] {
            assert!(matches!(printable_line(text), Cow::Borrowed(same) if same == text));
            assert!(matches!(printable_lines(text), Cow::Borrowed(same) if same == text));
        }
    }

    #[test]
    fn control_characters_become_spaces() {
        let text = "one\ttwo\r\n\u{1b}[31mthrée\u{9b}4m\u{7}";
        assert_eq!(printable_line(text), "one two   [31mthrée 4m ");
        assert_eq!(printable_lines(text), "one two \n [31mthrée 4m ");
    }

    #[test]
    fn separators_and_overrides_become_spaces() {
        assert_eq!(printable_line("a\u{2028}b\u{2029}c\u{202e}d\u{2066}e\u{2069}f"), "a b c d e f");
    }

    #[test]
    fn escapes_show_which_bytes_were_written() {
        assert_eq!(escaped_line(b"\x1b[31mred\x07\tend"), "\\u{1b}[31mred\\u{7}\\tend");
        assert_eq!(escaped_line(b"\xff\xc3 \xc3\xa4 C:\\temp"), "\\xff\\xc3 ä C:\\temp");
        let all: Vec<u8> = (0..=u8::MAX).collect();
        assert!(!escaped_line(&all).contains(char::is_control));
    }

    #[test]
    fn output_contains_no_control_characters() {
        let all: String = ('\0'..=char::MAX).collect();
        assert!(!printable_line(&all).contains(char::is_control));
        assert_eq!(printable_line(&all).chars().count(), all.chars().count());
    }
}
