//! Class labels as text: comparison regardless of the spelling, and lists of labels for messages.

use crate::printable::printable_line;

/// Maximum number of texts in a list of examples.
const MAX_EXAMPLES: usize = 5;
/// Longest text that is shown in full, characters.
const MAX_SHOWN_CHARS: usize = 40;

/// Returns the normal form of a label: in lower case, with spaces instead of hyphens and underscores. Labels with the
/// same normal form name the same class.
// Folders are often named `Golden_Retriever` for the class `golden retriever`.
pub fn normalized_label(label: &str) -> String {
    label.trim().chars().map(|c| if matches!(c, '_' | '-') { ' ' } else { c.to_ascii_lowercase() }).collect()
}

/// Returns the first texts as a list for messages: `tench, goldfish, …`.
pub fn list_examples<'a>(texts: impl IntoIterator<Item = &'a str>) -> String {
    let mut texts = texts.into_iter();
    let mut shown: Vec<String> = texts.by_ref().take(MAX_EXAMPLES).map(shorten).collect();
    shown.extend(texts.next().map(|_| "…".to_owned()));
    shown.join(", ")
}

/// Returns a text as one printable line of at most [`MAX_SHOWN_CHARS`] characters.
fn shorten(text: &str) -> String {
    let line = printable_line(text);
    if line.chars().count() <= MAX_SHOWN_CHARS {
        return line.into_owned();
    }
    line.chars().take(MAX_SHOWN_CHARS - 1).chain(['…']).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_ignore_case_and_separators() {
        assert_eq!(normalized_label(" Golden_Retriever"), normalized_label("golden retriever"));
        assert_ne!(normalized_label("golden"), normalized_label("golden retriever"));
    }

    #[test]
    fn long_list_is_shortened() {
        assert_eq!(list_examples(["a", "b"]), "a, b");
        assert_eq!(list_examples(["a", "b", "c", "d", "e"]), "a, b, c, d, e");
        assert_eq!(list_examples(["a", "b", "c", "d", "e", "f"]), "a, b, c, d, e, …");
        let long = list_examples([&*"ä".repeat(41)]);
        assert_eq!(long, format!("{}…", "ä".repeat(39)));
        assert_eq!((list_examples([]), list_examples(["a\nb"])), (String::new(), "a b".to_owned()));
    }
}
