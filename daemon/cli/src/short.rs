//! Shortening of texts that quote a value from the command line or a file. Such a value may have thousands of
//! characters and lines.

use std::borrow::Cow;

use peernet_sample::{escaped_line, printable_line};

/// Maximum length of a line in characters. Longer lines are shortened.
const MAX_LINE_CHARS: usize = 600;
/// Maximum length of a value in characters. Longer values are shortened.
const MAX_VALUE_CHARS: usize = 200;

/// Shortens the overlong lines of a text in their middle.
pub fn shorten_lines(text: &str) -> Cow<'_, str> {
    // A line has at most as many characters as bytes, so this quick check finds every overlong line.
    if text.lines().all(|line| line.len() <= MAX_LINE_CHARS) {
        return Cow::Borrowed(text);
    }
    let lines: Vec<Cow<'_, str>> = text.lines().map(|line| shorten(line, MAX_LINE_CHARS)).collect();
    Cow::Owned(lines.join("\n"))
}

/// Converts a value of a command line to one line, shortened in its middle if it is overlong.
pub fn shorten_value(text: &str) -> Cow<'_, str> {
    match printable_line(text) {
        Cow::Borrowed(text) => shorten(text, MAX_VALUE_CHARS),
        Cow::Owned(text) => Cow::Owned(shorten(&text, MAX_VALUE_CHARS).into_owned()),
    }
}

/// Converts labels of an experiment, which its file can fill with any characters, to one line for a terminal: control
/// characters and characters that reorder text are shown as escapes, and the middle of an overlong text is left out.
pub fn shorten_label(text: &str) -> String {
    shorten(&escaped_line(text.as_bytes()), MAX_VALUE_CHARS).into_owned()
}

/// Shortens a text in its middle, because its start names the subject and its end the expected value.
fn shorten(text: &str, max_chars: usize) -> Cow<'_, str> {
    let length = text.chars().count();
    if length <= max_chars {
        return Cow::Borrowed(text);
    }
    // The note in the middle fits into the remaining sixth.
    let (start_chars, end_chars) = (max_chars / 2, max_chars / 3);
    let start: String = text.chars().take(start_chars).collect();
    let end: String = text.chars().skip(length - end_chars).collect();
    Cow::Owned(format!("{start} […{} characters…] {end}", length - start_chars - end_chars))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn middle_of_overlong_line_is_left_out() {
        assert_eq!(shorten_lines("one\ntwo\n"), "one\ntwo\n");
        let text = format!("e.toml: \"{}\", expected u64\nthe second line", "ü".repeat(5000));
        let long = shorten_lines(&text);
        assert!(
            long.starts_with("e.toml: \"üü") && long.ends_with(", expected u64\nthe second line"),
            "{long}"
        );
        assert!(long.chars().count() < MAX_LINE_CHARS && long.contains(" characters…]"), "{long}");
    }

    #[test]
    fn label_is_shown_escaped_and_short() {
        assert_eq!(shorten_label("Model = yolo, größe = 1"), "Model = yolo, größe = 1");
        assert_eq!(shorten_label("a\u{202e}b\u{1b}[2Jc\n"), "a\\u{202e}b\\u{1b}[2Jc\\n");
        assert!(shorten_label(&"x".repeat(5_000)).chars().count() <= MAX_VALUE_CHARS);
    }

    #[test]
    fn value_is_shown_in_one_line() {
        assert_eq!(shorten_value("random string"), "random string");
        assert_eq!(shorten_value("a = 1\nb\t\u{1b}[31m"), "a = 1 b  [31m");
        let long = "x = 1\n".repeat(1000);
        let shortened = shorten_value(&long);
        assert!(shortened.starts_with("x = 1 x = 1") && shortened.ends_with("x = 1 "), "{shortened}");
        assert!(shortened.chars().count() <= MAX_VALUE_CHARS && !shortened.contains('\n'), "{shortened}");
    }
}
