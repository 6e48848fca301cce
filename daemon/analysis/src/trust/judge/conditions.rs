//! Judgement of the conditions of the hosts before the run: one sentence per host for all that are as they should be, one sentence for each
//! other condition.

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
    let mut all = Vec::new();
    for host in hosts {
        let of = |grade| conditions.iter().filter(move |known| known.host == host && known.grade == grade);
        for condition in of(Grade::Bad).chain(of(Grade::Doubtful)) {
            let text = format!("On {host}, {}: {}.", condition.about, condition.found);
            all.push(with_advice(
                finding(&condition.about, condition.grade, text),
                condition.advice.as_str(),
            ));
        }
        for (grade, words) in [(Grade::Unknown, "not known"), (Grade::Good, "as it should be")] {
            let listed: Vec<String> =
                of(grade).map(|known| format!("{} ({})", known.about, known.found)).collect();
            if !listed.is_empty() {
                all.push(finding("hosts", grade, format!("On {host}, {words}: {}.", listed.join("; "))));
            }
        }
    }
    all
}
