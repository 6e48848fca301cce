//! Data for the scripts of a page, as a JSON block.

use std::fmt;

use peernet_statistics::number::decimals;
use serde::Serialize;

/// Maximum number of decimals of a number for a chart.
const MAX_DECIMALS: usize = 9;

/// JSON text for a `script` element, escaped so that it cannot close the element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct JsonBlock(String);

impl JsonBlock {
    /// Returns the JSON form of a value.
    pub(crate) fn new(value: &impl Serialize) -> Result<Self, serde_json::Error> {
        let text = serde_json::to_string(value)?;
        let mut escaped = String::with_capacity(text.len());
        for character in text.chars() {
            match character {
                '<' => escaped.push_str("\\u003c"),
                '>' => escaped.push_str("\\u003e"),
                '&' => escaped.push_str("\\u0026"),
                '\u{2028}' => escaped.push_str("\\u2028"),
                '\u{2029}' => escaped.push_str("\\u2029"),
                other => escaped.push(other),
            }
        }
        Ok(Self(escaped))
    }
}

impl fmt::Display for JsonBlock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl askama::filters::HtmlSafe for JsonBlock {}

/// A number for a chart; `None` is a gap. The JSON form is rounded to three decimals. A small number is rounded to more
/// decimals, so that four significant digits remain, because tooltips show three. A gap is `null`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RoundedNumber(pub Option<f64>);

impl Serialize for RoundedNumber {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0.filter(|value| value.is_finite()) {
            Some(value) => {
                let power_of_ten = 10f64.powi(decimals(value, 4).clamp(3, MAX_DECIMALS) as i32);
                serializer.serialize_f64((value * power_of_ten).round() / power_of_ten)
            }
            None => serializer.serialize_none(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_text_cannot_close_script_element() {
        let block =
            JsonBlock::new(&["</script><script>alert(1)</script>", "a & b"]).expect("serialises").to_string();
        assert!(!block.contains('<') && !block.contains('&'), "{block}");
        let values: Vec<String> = serde_json::from_str(&block).expect("still JSON");
        assert_eq!(values[1], "a & b");
    }

    #[test]
    fn numbers_are_rounded_and_gaps_are_null() {
        let numbers = [RoundedNumber(Some(1.23456)), RoundedNumber(None), RoundedNumber(Some(f64::INFINITY))];
        assert_eq!(serde_json::to_string(&numbers).expect("serialises"), "[1.235,null,null]");
        let short = [0.0, 0.018_312_3, -0.001_234_56, 1e-12].map(|value| RoundedNumber(Some(value)));
        assert_eq!(serde_json::to_string(&short).expect("serialises"), "[0.0,0.01831,-0.001235,0.0]");
    }
}
