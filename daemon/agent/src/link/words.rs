//! Steps in words for people.

use peernet_logger::Slug;

use super::knowledge::Restart;
use crate::incidents::far_in_words;

/// That a clock was stepped, by how much, and whose.
pub(super) fn restart_in_words(restart: Restart, edge: &Slug, cloud: &Slug) -> String {
    let whose = match (restart.edge, restart.cloud) {
        (true, false) => format!("the clock of {edge} was stepped or ran off"),
        (false, true) => format!("the clock of {cloud} was stepped or ran off"),
        (true, true) => format!("the clocks of {edge} and {cloud} were stepped or ran off"),
        (false, false) => format!("the clock of {edge} or {cloud} was stepped or ran off without notice"),
    };
    let moved = restart.moved.map_or_else(String::new, |moved| {
        // The offset is the cloud's clock less the edge's; it is told of the one that moved.
        let own = restart.edge && !restart.cloud;
        let (moved, mover, other) = if own { (-moved, edge, cloud) } else { (moved, cloud, edge) };
        let way = if moved.is_negative() { "back" } else { "forward" };
        let far = far_in_words(moved);
        format!("; the clock of {mover} went {far} {way} against that of {other}")
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

/// That the wall clock of a cloud was set or ran off, on which delays do not depend.
pub(super) fn wall_set_in_words(cloud: &Slug) -> String {
    format!(
        "the wall clock of {cloud} was stepped or ran off; delays are measured by the free-running clocks and do not change"
    )
}

#[cfg(test)]
mod tests {
    use peernet_clock::Span;

    use super::*;

    #[test]
    fn a_restart_names_the_host_and_the_size() {
        let (edge, cloud): (Slug, Slug) = ("robot".parse().expect("a name"), "desk".parse().expect("a name"));
        let by = |nanos, edge, cloud| Restart {
            moved: Some(Span::from_nanos(nanos)),
            edge,
            cloud,
            beyond_ppm: None,
        };
        for (restart, begin, told) in [
            (
                by(-3_000_007_000, true, false),
                "the clock of robot was",
                "the clock of robot went 3.000 s forward against that of desk;",
            ),
            (
                by(-3_000_007_000, false, true),
                "the clock of desk was",
                "the clock of desk went 3.000 s back against that of robot;",
            ),
            (by(30_000, false, false), "the clock of robot or desk", "desk went 0.030 ms forward"),
        ] {
            let text = restart_in_words(restart, &edge, &cloud);
            assert!(text.starts_with(begin) && text.contains(told), "{text}");
        }
        let unknown = restart_in_words(
            Restart { moved: None, edge: false, cloud: false, beyond_ppm: Some(50.0) },
            &edge,
            &cloud,
        );
        assert!(unknown.contains("robot or desk") && unknown.contains("max_drift_ppm = 50"), "{unknown}");
    }
}
