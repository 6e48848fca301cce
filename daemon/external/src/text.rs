//! Texts of users' code, which end up on terminals and in logs.

use serde::{Deserialize, Deserializer};

/// Control characters but line feeds become spaces.
pub(crate) fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_control() && c != '\n' { ' ' } else { c }).collect()
}

/// Reads a text as [`printable`].
pub(crate) fn words<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    String::deserialize(deserializer).map(|text| printable(&text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_but_line_feeds_controls_a_terminal() {
        assert_eq!(printable("one\ttwo\r\n\u{1b}[31mthrée\u{9b}4m\u{7}"), "one two \n [31mthrée 4m ");
    }
}
