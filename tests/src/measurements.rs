//! Output of measured values, which appears for passing tests, too.

use std::io::Write;

/// Environment variable with the file to which values are appended as rows of a Markdown table.
const MEASUREMENTS_FILE: &str = "PEERNET_FIGURES";

/// Writes a line to standard error, bypassing the test runner, which hides the output of passing tests.
pub fn print_line(line: &str) {
    // A closed standard error is no reason to fail.
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// Prints measured values, and appends them to the file that `PEERNET_FIGURES` names; `make soak` collects them.
///
/// # Panics
/// If the file named by `PEERNET_FIGURES` cannot be written.
pub fn record_measurements(title: &str, figures: &[(&str, String)]) {
    let list: Vec<String> = figures.iter().map(|(name, value)| format!("{name} {value}")).collect();
    print_line(&format!("{title}: {}", list.join(", ")));
    let Some(path) = std::env::var_os(MEASUREMENTS_FILE) else { return };
    let rows: String =
        figures.iter().map(|(name, value)| format!("| {title} | {name} | {value} |\n")).collect();
    let file = std::fs::File::options().create(true).append(true).open(&path);
    file.and_then(|mut file| file.write_all(rows.as_bytes()))
        .unwrap_or_else(|error| panic!("cannot write {}: {error}", path.display()));
}

/// Formats a number with commas: `1234567.8` as `1,234,568`.
pub fn thousands(number: f64) -> String {
    let digits = format!("{number:.0}");
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index) % 3 == 0 {
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
