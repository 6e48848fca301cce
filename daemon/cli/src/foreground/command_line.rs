//! The command line of this process, for display.

/// Returns the command line, quoted for a shell. It is for display only: parts that are not UTF-8 are replaced.
pub(crate) fn command_line() -> String {
    let words = std::env::args_os().map(|word| {
        let word = word.to_string_lossy().into_owned();
        let is_plain = |char: char| char.is_ascii_alphanumeric() || "-_./:=,@+%".contains(char);
        if !word.is_empty() && word.chars().all(is_plain) {
            word
        } else {
            format!("'{}'", word.replace('\'', "'\\''"))
        }
    });
    words.collect::<Vec<_>>().join(" ")
}
