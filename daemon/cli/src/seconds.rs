//! Durations on the command line, in seconds.

use std::num::ParseFloatError;

/// Longest duration in seconds: a day.
const MAX_SECONDS: f64 = 86_400.0;

/// Reason why a text is not a duration within the limits.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum SecondsError {
    /// The text is not a number.
    #[error(transparent)]
    NotANumber(#[from] ParseFloatError),
    /// The duration is outside the range.
    #[error("must be from {min_seconds} to {MAX_SECONDS} seconds")]
    OutOfRange {
        /// Shortest duration in seconds.
        min_seconds: f64,
    },
}

/// Reads a duration between `min_seconds` seconds and a day.
pub(crate) fn seconds(text: &str, min_seconds: f64) -> Result<f64, SecondsError> {
    let seconds = text.parse::<f64>()?;
    if (min_seconds..=MAX_SECONDS).contains(&seconds) {
        Ok(seconds)
    } else {
        Err(SecondsError::OutOfRange { min_seconds })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_outside_range_are_refused() {
        assert_eq!((seconds("0", 0.0), seconds("86400", 1.0)), (Ok(0.0), Ok(86_400.0)));
        for (text, expected) in [
            ("0.5", "must be from 1 to 86400 seconds"),
            ("1e9", "must be from 1 to 86400 seconds"),
            ("x", "invalid float literal"),
        ] {
            assert_eq!(seconds(text, 1.0).expect_err(text).to_string(), expected);
        }
        assert_eq!(
            seconds("nan", 0.0).expect_err("it is not a number").to_string(),
            "must be from 0 to 86400 seconds"
        );
    }
}
