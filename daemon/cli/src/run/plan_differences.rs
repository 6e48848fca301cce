//! Differences between two plans.

use serde_json::Value;

/// Maximum number of reported differences.
const MAX_DIFFERENCES: usize = 8;

/// Returns a line for each difference: path, earlier value and present value. If there are more than
/// [`MAX_DIFFERENCES`], a last line gives the number of the others.
pub(super) fn differences(before: &Value, now: &Value) -> Vec<String> {
    let mut differences = Vec::new();
    compare("", before, now, &mut differences);
    let more = differences.len().saturating_sub(MAX_DIFFERENCES);
    differences.truncate(MAX_DIFFERENCES);
    if more > 0 {
        differences.push(format!("and {more} more"));
    }
    differences
}

fn compare(path: &str, before: &Value, now: &Value, differences: &mut Vec<String>) {
    match (before, now) {
        (Value::Object(before), Value::Object(now)) => {
            let keys = before.keys().chain(now.keys().filter(|key| !before.contains_key(*key)));
            for key in keys {
                let inner_path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                compare(
                    &inner_path,
                    before.get(key).unwrap_or(&Value::Null),
                    now.get(key).unwrap_or(&Value::Null),
                    differences,
                );
            }
        }
        (Value::Array(before), Value::Array(now)) if before.len() == now.len() => {
            for (index, (before, now)) in before.iter().zip(now).enumerate() {
                compare(&format!("{path}[{index}]"), before, now, differences);
            }
        }
        (Value::Array(before), Value::Array(now)) => {
            differences.push(format!("{path}: {} entries before, {} now", before.len(), now.len()));
        }
        (before, now) if before == now => {}
        (before, now) => {
            differences.push(format!("{path}: {} before, {} now", show_value(before), show_value(now)));
        }
    }
}

fn show_value(value: &Value) -> String {
    match value {
        Value::Null => "nothing".to_owned(),
        value => value.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn differences_are_reported_with_paths() {
        let before = json!({ "seed": 1, "runs": [{ "a": 1 }, { "a": 2 }], "axes": [1] });
        let now = json!({ "seed": 2, "runs": [{ "a": 1 }, { "a": 3, "b": true }], "axes": [1, 2] });
        assert_eq!(
            differences(&before, &now),
            [
                "axes: 1 entries before, 2 now",
                "runs[1].a: 2 before, 3 now",
                "runs[1].b: nothing before, true now",
                "seed: 1 before, 2 now",
            ]
        );
        assert!(differences(&now, &now).is_empty());
        let long_list =
            |value: usize| json!((0..20).map(|index| json!({ "a": index * value })).collect::<Vec<_>>());
        // The entries with index 0 are equal, so 19 of the 20 entries differ, and 8 of these are reported.
        assert_eq!(differences(&long_list(1), &long_list(2)).last().map(String::as_str), Some("and 11 more"));
    }
}
