//! What spoils measurements, as it is told before or while they are made.

use peernet_stream::Condition;

/// What was found of a host, and what can be done about it.
pub(crate) fn remark(condition: &Condition) -> String {
    let Condition { host, about, found, advice, .. } = condition;
    let advice = if advice.is_empty() { String::new() } else { format!("; {advice}") };
    format!("on {host}, {about}: {found}{advice}")
}
