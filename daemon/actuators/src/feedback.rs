//! The output of an actuator.

use serde::Deserialize;

/// Report of the controlled system about an action.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Feedback {
    /// `true` if the episode has ended: the task is done, or it cannot be done any more.
    pub episode_ended: bool,
    /// Whether the episode is a success so far; `None` if it is not reported.
    pub success: Option<bool>,
    /// Reward for the action, a finite number; `None` if it is not reported.
    pub reward: Option<f64>,
}

impl Feedback {
    /// Reads feedback from a JSON document: an object with any of the fields, or `null` for no feedback.
    pub(crate) fn from_json(text: &[u8]) -> Result<Self, serde_json::Error> {
        Ok(serde_json::from_slice::<Option<Self>>(text)?.unwrap_or_default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_may_be_missing_but_not_misspelt() {
        let read = |text: &str| Feedback::from_json(text.as_bytes()).map_err(|error| error.to_string());
        assert_eq!(read("null"), Ok(Feedback::default()));
        assert_eq!(read("{}"), Ok(Feedback::default()));
        let all = Feedback { episode_ended: true, success: Some(false), reward: Some(-1.5) };
        assert_eq!(read(r#"{"reward": -1.5, "episode_ended": true, "success": false}"#), Ok(all));
        let error = read(r#"{"sucess": true}"#).expect_err("is misspelt");
        assert!(error.contains("unknown field `sucess`, expected one of `episode_ended`"), "{error}");
        assert_eq!(read(r#"{"reward": null, "success": null}"#), Ok(Feedback::default()));
        for wrong in [
            "",
            "3",
            r#"{"success": 1}"#,
            r#"{"reward": "1"}"#,
            r#"{"reward": true}"#,
            r#"{"reward": 1e999}"#,
            r#"{"reward": NaN}"#,
            "{} {}",
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }
}
