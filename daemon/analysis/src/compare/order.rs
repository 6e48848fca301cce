//! Order of the configurations of an experiment. Runs are executed in random order, but readers expect the order of the
//! experiment's file.

use std::cmp::Ordering;

use peernet_stream::ExperimentPosition;

/// Units of labels in lower case, each with its size in the base unit of its kind: bytes, seconds or hertz.
const UNITS: [(&str, f64); 16] = [
    ("b", 1.0),
    ("kb", 1e3),
    ("mb", 1e6),
    ("gb", 1e9),
    ("tb", 1e12),
    ("kib", 1_024.0),
    ("mib", 1_048_576.0),
    ("gib", 1_073_741_824.0),
    ("ns", 1e-9),
    ("µs", 1e-6),
    ("us", 1e-6),
    ("ms", 1e-3),
    ("s", 1.0),
    ("hz", 1.0),
    ("khz", 1e3),
    ("mhz", 1e6),
];

/// Compares the positions of two runs in an experiment: by the index of the configuration in the experiment's file,
/// then by its labels, then by the repeat. A configuration whose index is not known, because an earlier version ran
/// it, follows the configurations with an index.
pub fn compare_positions(a: &ExperimentPosition, b: &ExperimentPosition) -> Ordering {
    let index = |position: &ExperimentPosition| {
        (position.configuration_index.is_none(), position.configuration_index)
    };
    let labels = || compare_labels(&a.configuration, &b.configuration);
    index(a).cmp(&index(b)).then_with(labels).then(a.repeat.cmp(&b.repeat))
}

/// Compares the labels of two configurations axis by axis, each in its natural order: the first axis in which they
/// differ decides.
fn compare_labels(a: &[(String, String)], b: &[(String, String)]) -> Ordering {
    let pairs = a.iter().zip(b);
    let first_difference = pairs.map(|((_, a), (_, b))| compare_label(a, b)).find(|order| order.is_ne());
    first_difference.unwrap_or_else(|| a.len().cmp(&b.len()))
}

/// Compares two labels in their natural order. Labels that begin with a number come first, ordered by value and unit.
/// Other labels follow in alphabetical order, except that numbers within them are ordered by value: `run 9` before `run
/// 10`.
pub fn compare_label(a: &str, b: &str) -> Ordering {
    match (quantity(a), quantity(b)) {
        (Some(x), Some(y)) => x.total_cmp(&y).then_with(|| a.cmp(b)),
        (Some(_), None) => Ordering::Less,
        (None, Some(_)) => Ordering::Greater,
        (None, None) => split_numbers(a).cmp(&split_numbers(b)).then_with(|| a.cmp(b)),
    }
}

/// Returns the numeric value of a label such as `30`, `-1.5`, `1,000`, `1e6`, `30 kB` or `50 Hz`. The value of
/// `224x224` is the first number. `None` if the label does not begin with a number.
fn quantity(label: &str) -> Option<f64> {
    let text = label.trim().replace(',', "");
    let finite_number = |text: &str| text.parse::<f64>().ok().filter(|value| value.is_finite());
    // The longest beginning that is a number: `1e6` is not 1.
    let ends = (1..=text.len()).rev().filter(|end| text.is_char_boundary(*end));
    let (value, rest) =
        ends.into_iter().find_map(|end| Some((finite_number(&text[..end])?, &text[end..])))?;
    let unit = rest.trim().to_lowercase();
    Some(value * UNITS.iter().find(|(name, _)| *name == unit).map_or(1.0, |(_, size)| *size))
}

/// Part of a label. Numbers come before words.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
enum LabelPiece {
    Number(u128),
    Word(String),
}

/// Splits a label into words and whole numbers.
fn split_numbers(label: &str) -> Vec<LabelPiece> {
    // Each piece: whether it consists of digits, and its text.
    let mut pieces: Vec<(bool, String)> = Vec::new();
    for letter in label.to_lowercase().chars() {
        let is_digit = letter.is_ascii_digit();
        match pieces.last_mut().filter(|(has_digits, _)| *has_digits == is_digit) {
            Some((_, text)) => text.push(letter),
            None => pieces.push((is_digit, letter.to_string())),
        }
    }
    let piece = |(is_digit, text): (bool, String)| match text.parse() {
        Ok(number) if is_digit => LabelPiece::Number(number),
        _ => LabelPiece::Word(text),
    };
    pieces.into_iter().map(piece).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sorted(rows: &[&[&str]]) -> Vec<Vec<String>> {
        let mut positions: Vec<ExperimentPosition> = rows.iter().map(|row| position(None, row, 0)).collect();
        positions.sort_by(compare_positions);
        let labels = |position: ExperimentPosition| {
            position.configuration.into_iter().map(|(_, label)| label).collect()
        };
        positions.into_iter().map(labels).collect()
    }

    fn position(configuration_index: Option<u32>, labels: &[&str], repeat: u32) -> ExperimentPosition {
        let configuration = labels.iter().map(|label| ("axis".to_owned(), (*label).to_owned())).collect();
        ExperimentPosition { configuration, configuration_index, repeat, ..ExperimentPosition::default() }
    }

    #[test]
    fn order_follows_index_in_file_before_labels() {
        let mut positions = [
            position(None, &["a"], 0),
            position(Some(1), &["m"], 1),
            position(Some(0), &["s"], 0),
            position(Some(2), &["l"], 0),
            position(Some(1), &["m"], 0),
        ];
        positions.sort_by(compare_positions);
        let sorted = positions.map(|position| (position.configuration[0].1.clone(), position.repeat));
        assert_eq!(
            sorted,
            [("s", 0), ("m", 0), ("m", 1), ("l", 0), ("a", 0)].map(|(a, b)| (a.to_owned(), b))
        );
    }

    #[test]
    fn configurations_are_sorted_by_axes_and_numeric_value() {
        let rows = sorted(&[
            &["1000000", "closed"],
            &["1000", "closed"],
            &["100000", "50 Hz"],
            &["1000", "50 Hz"],
            &["100000", "closed"],
        ]);
        let rows: Vec<String> = rows.iter().map(|row| row.join(" ")).collect();
        assert_eq!(rows, ["1000 50 Hz", "1000 closed", "100000 50 Hz", "100000 closed", "1000000 closed"]);
    }

    #[test]
    fn labels_are_sorted_by_unit_and_embedded_number() {
        let rows = sorted(&[&["2 MB"], &["30 kB"], &["800 B"], &["net-10"], &["1,000"], &["net-9"], &["—"]]);
        assert_eq!(rows.concat(), ["800 B", "1,000", "30 kB", "2 MB", "net-9", "net-10", "—"]);
        let sizes = sorted(&[&["1 TB"], &["1.05 GB"], &["1 GiB"], &["1 MiB"]]);
        assert_eq!(sizes.concat(), ["1 MiB", "1.05 GB", "1 GiB", "1 TB"]);
        assert_eq!(sorted(&[&["no"], &["-1"], &["0.5"], &["inf"]]).concat(), ["-1", "0.5", "inf", "no"]);
    }
}
