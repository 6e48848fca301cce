//! The command that was typed.

/// The command that was typed, in words that a shell takes. It is told, not executed: what is not UTF-8 is replaced.
pub(crate) fn typed() -> String {
    let words = std::env::args_os().map(|word| {
        let word = word.to_string_lossy().into_owned();
        let plain = |char: char| char.is_ascii_alphanumeric() || "-_./:=,@+%".contains(char);
        if !word.is_empty() && word.chars().all(plain) {
            word
        } else {
            format!("'{}'", word.replace('\'', "'\\''"))
        }
    });
    words.collect::<Vec<_>>().join(" ")
}
