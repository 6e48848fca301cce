//! Texts of errors about invalid values of a configuration, without names of Rust types.

use toml::de::Error;

/// Prefixes of serde's names of types, such as `u` of `u64` and `a nonzero ` of `a nonzero u64`, and
/// the words for these types. The words name no largest value: the check of the configuration, which
/// follows, reports the ranges of its values.
const TYPE_WORDS: [(&str, &str); 3] =
    [("a nonzero ", "a whole number above 0"), ("u", "a whole number from 0"), ("i", "a whole number")];

/// Returns the text of the error with words instead of names of Rust types.
pub fn describe_error(error: &Error) -> String {
    let text = error.message();
    let Some((problem, type_name)) = text.rsplit_once(", expected ") else { return text.to_owned() };
    if type_name.starts_with("struct ") {
        return format!("{problem}, expected a table");
    }
    for (prefix, words) in TYPE_WORDS {
        if type_name.strip_prefix(prefix).is_some_and(is_size_or_type) {
            return format!("{problem}, expected {words}");
        }
    }
    if matches!(type_name, "f32" | "f64") { format!("{problem}, expected a number") } else { text.to_owned() }
}

/// Returns whether `rest` is the `64` of `u64`, the `size` of `usize`, or the whole type after `a nonzero`.
fn is_size_or_type(rest: &str) -> bool {
    let size = rest.strip_prefix(['u', 'i']).unwrap_or(rest);
    matches!(size, "8" | "16" | "32" | "64" | "128" | "size")
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;

    use serde::Deserialize;

    use super::*;

    #[derive(Debug, Deserialize)]
    #[expect(dead_code, reason = "the test looks at errors only, and no value is read")]
    struct Numbers {
        threads: Option<NonZeroUsize>,
        milliseconds: Option<u64>,
        offset: Option<i32>,
        hz: Option<f64>,
        name: Option<String>,
        inner: Option<Inner>,
    }

    #[derive(Debug, Deserialize)]
    struct Inner {}

    #[test]
    fn expected_types_are_described_in_words() {
        for (file, expected) in [
            ("threads = 0", "invalid value: integer `0`, expected a whole number above 0"),
            ("threads = 'x'", "invalid type: string \"x\", expected a whole number above 0"),
            ("threads = 1.5", "invalid type: floating point `1.5`, expected a whole number above 0"),
            ("milliseconds = -1", "invalid value: integer `-1`, expected a whole number from 0"),
            ("offset = 5000000000", "invalid value: integer `5000000000`, expected a whole number"),
            ("hz = 'x'", "invalid type: string \"x\", expected a number"),
            ("name = 1", "invalid type: integer `1`, expected a string"),
            ("inner = 1", "invalid type: integer `1`, expected a table"),
            ("name = ", "string values must be quoted, expected literal string"),
        ] {
            let error = toml::from_str::<Numbers>(file).expect_err(file);
            assert_eq!(describe_error(&error), expected, "{file}");
        }
    }
}
