//! Judgement of the conditions of the hosts before the run. Each host has one finding about all its good conditions,
//! one finding about all its unknown conditions, and one finding about each doubtful or bad condition.

use peernet_stream::{Condition, Grade};

use super::{finding, with_advice};
use crate::trust::Finding;

pub(super) fn findings(conditions: &[Condition]) -> Vec<Finding> {
    if conditions.is_empty() {
        return vec![finding("hosts", Grade::Unknown, "The hosts were not inspected before the run.")];
    }
    let mut hosts: Vec<&str> = Vec::new();
    for condition in conditions {
        if !hosts.contains(&condition.host.as_str()) {
            hosts.push(&condition.host);
        }
    }
    let mut findings = Vec::new();
    for host in hosts {
        let with_grade = |grade| {
            conditions.iter().filter(move |condition| condition.host == host && condition.grade == grade)
        };
        for condition in with_grade(Grade::Bad).chain(with_grade(Grade::Doubtful)) {
            let text = format!("On {host}, {}: {}.", condition.about, condition.found);
            findings.push(with_advice(
                finding(&condition.about, condition.grade, text),
                condition.advice.as_str(),
            ));
        }
        for (grade, state) in [(Grade::Unknown, "not known"), (Grade::Good, "as it should be")] {
            let texts: Vec<String> = with_grade(grade)
                .map(|condition| format!("{} ({})", condition.about, condition.found))
                .collect();
            if !texts.is_empty() {
                findings.push(finding("hosts", grade, format!("On {host}, {state}: {}.", texts.join("; "))));
            }
        }
    }
    findings
}
