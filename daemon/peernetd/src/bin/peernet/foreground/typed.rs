//! The command that was typed.

/// The command that was typed, in words that a shell takes.
pub(crate) fn typed() -> String {
    let words = std::env::args().map(|word| {
        let plain = |char: char| char.is_ascii_alphanumeric() || "-_./:=,@+%".contains(char);
        if !word.is_empty() && word.chars().all(plain) {
            word
        } else {
            format!("'{}'", word.replace('\'', "'\\''"))
        }
    });
    words.collect::<Vec<_>>().join(" ")
}
