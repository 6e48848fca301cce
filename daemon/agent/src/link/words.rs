//! Steps in words for people.

use peernet_logger::Slug;

use super::knowledge::Restart;

/// That a clock was stepped, by how much, and whose.
pub(super) fn restart_in_words(restart: Restart, edge: &Slug, cloud: &Slug) -> String {
    let whose = match (restart.edge, restart.cloud) {
        (true, false) => format!("the clock of {edge} was stepped or ran off"),
        (false, true) => format!("the clock of {cloud} was stepped or ran off"),
        (true, true) => format!("the clocks of {edge} and {cloud} were stepped or ran off"),
        (false, false) => format!("the clock of {edge} or {cloud} was stepped or ran off without notice"),
    };
    let moved = restart.moved.map_or_else(String::new, |moved| {
        let way = if moved.is_negative() { "back" } else { "forward" };
        format!("; the clock of {cloud} went {:.6} s {way} against that of {edge}", moved.abs().seconds())
    });
    let outlook = match restart.beyond_ppm {
        None => "their relation is learnt anew".to_owned(),
        Some(limit) => format!(
            "not for the first time within a minute: they seem to drift apart faster than [clock] max_drift_ppm = {limit}; \
             nothing is believed until that has ceased"
        ),
    };
    format!("{whose}{moved}; {outlook}")
}

#[cfg(test)]
mod tests {
    use peernet_clock::Span;

    use super::*;

    #[test]
    fn a_restart_names_the_host_and_the_size() {
        let (edge, cloud): (Slug, Slug) = ("robot".parse().expect("a name"), "desk".parse().expect("a name"));
        let restart =
            Restart { moved: Some(Span::from_seconds(-3)), edge: true, cloud: false, beyond_ppm: None };
        let text = restart_in_words(restart, &edge, &cloud);
        assert!(text.contains("the clock of robot was") && text.contains("3.000000 s back"), "{text}");
        let unknown = restart_in_words(
            Restart { moved: None, edge: false, cloud: false, beyond_ppm: Some(50.0) },
            &edge,
            &cloud,
        );
        assert!(unknown.contains("robot or desk") && unknown.contains("max_drift_ppm = 50"), "{unknown}");
    }
}
