//! Texts about conditions that impair measurements.

use peernet_stream::Condition;

/// Describes a condition of a host, with the advice.
pub(crate) fn describe_condition(condition: &Condition) -> String {
    let Condition { host, about, found, advice, .. } = condition;
    let advice = if advice.is_empty() { String::new() } else { format!("; {advice}") };
    format!("on {host}, {about}: {found}{advice}")
}
