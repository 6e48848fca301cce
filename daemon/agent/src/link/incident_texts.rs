//! Texts for people about steps, jumps, lost proofs and violated assumptions.

use peernet_clock::ViolatedLimit;
use peernet_logger::Slug;

use super::reports::{ExcessSkew, LostProof, Restart, SuspectedJump};
use crate::incidents::format_step_size;

/// Returns the text of a restart. It names the host whose clock was stepped and the size of the step.
pub(super) fn restart_text(restart: Restart, edge: &Slug, cloud: &Slug) -> String {
    let cause = match (restart.edge_stepped, restart.cloud_stepped) {
        (true, false) => format!("the clock of {edge} was stepped or slewed"),
        (false, true) => format!("the clock of {cloud} was stepped or slewed"),
        (true, true) => format!("the clocks of {edge} and {cloud} were stepped or slewed"),
        (false, false) => {
            format!("the clock of {edge} or {cloud} was stepped or slewed, which neither host reported")
        }
    };
    let movement_text = restart.movement.map_or_else(String::new, |movement| {
        // `movement` is the change of the cloud's clock minus the change of the edge's clock. The text names the clock
        // that moved.
        let is_edge = restart.edge_stepped && !restart.cloud_stepped;
        let (movement, moved_host, other_host) =
            if is_edge { (-movement, edge, cloud) } else { (movement, cloud, edge) };
        let direction = if movement.is_negative() { "back" } else { "forward" };
        let size = format_step_size(movement);
        format!("; the clock of {moved_host} moved {size} {direction} against that of {other_host}")
    });
    let consequence = match restart.violation {
        None => "the clock relation is estimated again".to_owned(),
        Some((violation, limit)) => {
            let violation_text = match violation {
                ViolatedLimit::Drift => "drift apart faster than [clock] max_drift_ppm",
                ViolatedLimit::DriftChange => {
                    "change their drift faster than [clock] max_drift_change_ppm_per_s"
                }
            };
            format!(
                "this happened repeatedly within a minute: the clocks seem to {violation_text} = {limit}; delays have no value until this \
                 has stopped"
            )
        }
    };
    format!("{cause}{movement_text}; {consequence}")
}

/// Returns the text about a step or slew of a cloud's wall clock. No delay depends on that clock.
pub(super) fn wall_set_text(cloud: &Slug) -> String {
    format!(
        "the wall clock of {cloud} was stepped or slewed; delays are not affected, because they are measured with the \
         free-running clocks"
    )
}

/// Returns the text of a suspected jump, with both possible causes.
pub(super) fn jump_text(jump: SuspectedJump, edge: &Slug, cloud: &Slug) -> String {
    let direction = if jump.movement.is_negative() { "back" } else { "forward" };
    let size = format_step_size(jump.movement);
    let unreported = unreported_text(jump.unreported);
    format!(
        "the clock of {cloud} seems to have jumped {size} {direction} against that of {edge}{unreported}: either the path between \
         them changed, or a clock jumped without a detected step, as when a virtual machine is paused or moved; the intervals \
         of delays allow for both, and are wider until the window of exchanges is full again"
    )
}

/// Returns the text of a lost proof that both processes read one clock, with the reason.
pub(super) fn lost_proof_text(lost_proof: &LostProof, edge: &Slug, cloud: &Slug) -> String {
    let unreported = unreported_text(lost_proof.unreported);
    format!(
        "it is no longer proven that the processes of {edge} and {cloud} read the same clock{unreported}: {}; delays between them \
         are estimated until the same clock is proven again",
        lost_proof.reason
    )
}

/// Returns the text about the number of jumps or lost proofs that were not reported since the last report.
fn unreported_text(unreported: u32) -> String {
    match unreported {
        0 => String::new(),
        1 => ", and once more since the last report".to_owned(),
        times => format!(", and {times} times more since the last report"),
    }
}

/// Returns the text of a proven skew beyond the limit.
pub(super) fn excess_text(excess: ExcessSkew, edge: &Slug, cloud: &Slug) -> String {
    let ExcessSkew { proven, limit_ppm } = excess;
    let (min, max) = proven.ordered_ppm();
    format!(
        "the exchanges prove that the clock of {cloud} gains {min:.1} to {max:.1} ppm on that of {edge}, more than [clock] \
         max_drift_ppm = {limit_ppm} allows: delays have no value; raise max_drift_ppm on {edge}"
    )
}

#[cfg(test)]
mod tests {
    use peernet_clock::{ProvenSkew, Span};

    use super::*;
    use crate::same_clock::NotProven;

    #[test]
    fn lost_proof_names_both_hosts_and_reason() {
        let (edge, cloud): (Slug, Slug) = ("robot".parse().expect("a name"), "desk".parse().expect("a name"));
        let text = lost_proof_text(&LostProof { reason: NotProven::PeerTime, unreported: 1 }, &edge, &cloud);
        for part in ["the processes of robot and desk", "once more", "a preloaded library", "estimated"] {
            assert!(text.contains(part), "{text}");
        }
    }

    #[test]
    fn restart_names_host_and_size() {
        let (edge, cloud): (Slug, Slug) = ("robot".parse().expect("a name"), "desk".parse().expect("a name"));
        let restart_by = |nanos, edge_stepped, cloud_stepped| Restart {
            movement: Some(Span::from_nanos(nanos)),
            edge_stepped,
            cloud_stepped,
            violation: None,
        };
        for (restart, begin, expected) in [
            (
                restart_by(-3_000_007_000, true, false),
                "the clock of robot was",
                "the clock of robot moved 3.000 s forward against that of desk;",
            ),
            (
                restart_by(-3_000_007_000, false, true),
                "the clock of desk was",
                "the clock of desk moved 3.000 s back against that of robot;",
            ),
            (restart_by(30_000, false, false), "the clock of robot or desk", "desk moved 0.030 ms forward"),
        ] {
            let text = restart_text(restart, &edge, &cloud);
            assert!(text.starts_with(begin) && text.contains(expected), "{text}");
        }
        for (violation, key) in [
            ((ViolatedLimit::Drift, 50.0), "max_drift_ppm = 50;"),
            ((ViolatedLimit::DriftChange, 1.0), "max_drift_change_ppm_per_s = 1;"),
        ] {
            let restart = Restart {
                movement: None,
                edge_stepped: false,
                cloud_stepped: false,
                violation: Some(violation),
            };
            let text = restart_text(restart, &edge, &cloud);
            assert!(text.contains("robot or desk") && text.contains(key), "{text}");
        }
    }

    #[test]
    fn jump_text_names_causes_and_unreported_jumps() {
        let (edge, cloud): (Slug, Slug) = ("robot".parse().expect("a name"), "desk".parse().expect("a name"));
        let text =
            jump_text(SuspectedJump { movement: Span::from_millis(-39), unreported: 11 }, &edge, &cloud);
        for part in ["desk seems to have jumped 0.039 s back", "11 times more", "path", "clock jumped"] {
            assert!(text.contains(part), "{text}");
        }
    }

    #[test]
    fn excess_text_names_range_and_limit() {
        let (edge, cloud): (Slug, Slug) = ("robot".parse().expect("a name"), "desk".parse().expect("a name"));
        let proven = ProvenSkew { min_ppm: 61.25, max_ppm: 140.0 };
        let text = excess_text(ExcessSkew { proven, limit_ppm: 50.0 }, &edge, &cloud);
        assert!(text.contains("61.2 to 140.0 ppm") && text.contains("max_drift_ppm = 50 "), "{text}");
    }
}
