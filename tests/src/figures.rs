//! Output of measured values, which is shown for passing tests as well.

use std::io::Write;

/// Environment variable with the file to which values are appended as rows of a Markdown table.
const FIGURES: &str = "PEERNET_FIGURES";

/// Writes a line to standard error, bypassing the test runner, which shows the output of failed tests only.
pub fn say(line: &str) {
    // A closed standard error is no reason to fail.
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// Prints measured values; `make soak` collects them.
///
/// # Panics
/// If the file named by `PEERNET_FIGURES` cannot be written.
pub fn measured(what: &str, figures: &[(&str, String)]) {
    let list: Vec<String> = figures.iter().map(|(name, value)| format!("{name} {value}")).collect();
    say(&format!("{what}: {}", list.join(", ")));
    let Some(path) = std::env::var_os(FIGURES) else { return };
    let rows: String =
        figures.iter().map(|(name, value)| format!("| {what} | {name} | {value} |\n")).collect();
    let file = std::fs::File::options().create(true).append(true).open(&path);
    file.and_then(|mut file| file.write_all(rows.as_bytes()))
        .unwrap_or_else(|error| panic!("cannot write {}: {error}", path.display()));
}

/// Formats a number with commas: `1234567.8` as `1,234,568`.
pub fn thousands(number: f64) -> String {
    let digits = format!("{number:.0}");
    let mut text = String::new();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at) % 3 == 0 {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_are_grouped_by_three() {
        assert_eq!([0.0, 999.4, 1_000.0, 1_234_567.8].map(thousands), ["0", "999", "1,000", "1,234,568"]);
    }
}
