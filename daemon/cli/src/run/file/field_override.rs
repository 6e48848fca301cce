//! `--set`: a value that replaces a value of the file.

use std::num::IntErrorKind;

use toml::{Table, Value};

use super::axis::Axis;
use super::field::{Field, FieldError};

/// A field with its new value.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::run) struct FieldOverride {
    field: Field,
    value: Value,
}

/// A value of `--set` that cannot be set in the file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(in crate::run) enum SetError {
    #[error("write FIELD=VALUE, such as experiment.iterations=100")]
    Form,
    #[error(transparent)]
    Field(#[from] FieldError),
    #[error("change axes in the file; --only executes some of the runs")]
    Axis,
    #[error("the number is not between {} and {}", i64::MIN, i64::MAX)]
    Number,
    /// Each value of an axis sets the field itself.
    #[error("{field} has no effect: the axis {axis} sets it in all runs; change it in the file")]
    Ineffective { field: Field, axis: String },
}

impl FieldOverride {
    /// Reads `FIELD=VALUE`. A value that is not TOML is a text, so that shells need no second pair of quotes.
    ///
    /// # Errors
    /// When the text has another form, or its field cannot be set.
    pub(in crate::run) fn read(text: &str) -> Result<Self, SetError> {
        let (field, value) = text.split_once('=').ok_or(SetError::Form)?;
        let field = Field::read(field.trim())?;
        if field.table() == "axis" {
            return Err(SetError::Axis);
        }
        let value = value.trim();
        let document = format!("value = {value}").parse::<Table>().ok();
        if document.is_none() && is_out_of_range(value) {
            return Err(SetError::Number);
        }
        // A document with more than one key comes from a text with a line feed, which is not a single TOML value.
        let parsed =
            document.filter(|document| document.len() == 1).and_then(|mut document| document.remove("value"));
        Ok(Self { field, value: parsed.unwrap_or_else(|| Value::String(value.to_owned())) })
    }

    /// Sets the value in the document.
    ///
    /// # Errors
    /// When the path does not exist.
    pub(super) fn apply(&self, document: &mut Table) -> Result<(), SetError> {
        Ok(self.field.set(document, self.value.clone())?)
    }

    /// Checks that the new value has an effect.
    ///
    /// # Errors
    /// When each value of an axis sets the field itself.
    pub(super) fn check(&self, axes: &[Axis]) -> Result<(), SetError> {
        match axes.iter().find(|axis| axis.always_covers(&self.field)) {
            Some(axis) => Err(SetError::Ineffective { field: self.field.clone(), axis: axis.name.clone() }),
            None => Ok(()),
        }
    }
}

/// Returns whether the text is a whole number outside TOML's range, which would cause a confusing error as a text.
fn is_out_of_range(value: &str) -> bool {
    let number = value.replace('_', "").parse::<i64>();
    number.is_err_and(|error| matches!(error.kind(), IntErrorKind::PosOverflow | IntErrorKind::NegOverflow))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn value_that_is_no_toml_is_text() {
        let value = |text: &str| FieldOverride::read(text).expect("reads").value;
        assert_eq!(value("experiment.iterations=100"), Value::Integer(100));
        assert_eq!(value("a.b = true"), Value::Boolean(true));
        assert_eq!(value("a.b=tcp://10.0.0.2:5551"), Value::String("tcp://10.0.0.2:5551".to_owned()));
        assert_eq!(value("a.b=\"100\""), Value::String("100".to_owned()));
        assert_eq!(value("bank.devices=[\"cpu\"]"), Value::Array(vec![Value::String("cpu".to_owned())]));
        assert_eq!(value("a.b=9223372036854775807"), Value::Integer(i64::MAX));
        assert_eq!(value("a.b='18446744073709551615'"), Value::String("18446744073709551615".to_owned()));
        assert_eq!(value("a.b="), Value::String(String::new()));
        assert_eq!(value("a.b=1\nc = 2"), Value::String("1\nc = 2".to_owned()));
    }

    #[test]
    fn invalid_override_is_refused_with_reason() {
        for (text, message) in [
            ("a.b", "FIELD=VALUE"),
            ("a..b=1", "not the path"),
            ("axis[0].values=[1]", "in the file"),
            ("a.b=18446744073709551615", "not between -9223372036854775808 and 9223372036854775807"),
            ("a.b=-99_999_999_999_999_999_999", "the number is not between"),
        ] {
            let error = FieldOverride::read(text).expect_err(text);
            assert!(error.to_string().contains(message), "{error}");
        }
    }
}
