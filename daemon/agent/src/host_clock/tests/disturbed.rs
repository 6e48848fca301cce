//! Tests of steps and of clocks with injected faults.

use std::sync::Arc;

use peernet_clock::{ClockIdentity, FaultyClock, SharedClock, Span, SteppedClock};

use super::{system_clock, watched};
use crate::config::{ClockConfig, RehearsalConfig, RehearsedDiscipline, RehearsedStepConfig};

/// Returns the machine's clock with injected faults.
fn rehearsed(config: &RehearsalConfig) -> SharedClock {
    let truth = system_clock();
    let description = config.description(truth.wall());
    Arc::new(FaultyClock::new(truth, ClockIdentity::new("boot", "rehearsal"), description))
}

#[tokio::test]
async fn step_is_published_with_its_rehearsal() {
    let rehearsal = RehearsalConfig {
        offset_ms: -1000.0,
        steps: vec![RehearsedStepConfig { at_s: 0.3, by_ms: 3000.0, clock: SteppedClock::Wall }],
        ..RehearsalConfig::default()
    };
    let clock = rehearsed(&rehearsal);
    let (mut published, _running) = watched(ClockConfig::default(), Some(rehearsal), &clock);
    let first = published.wait_for(|known| known.rehearsal.is_some()).await.expect("the task runs").clone();
    assert_eq!(first.rehearsal.as_ref(), clock.injected_faults());
    let epoch = first.epoch;
    let after = published.wait_for(|known| known.epoch > epoch).await.expect("the task runs").clone();
    assert_eq!(after.discipline, None);
}

#[tokio::test]
async fn rehearsed_host_claims_nothing_or_exact_error() {
    let silent = RehearsalConfig { offset_ms: 1000.0, ..RehearsalConfig::default() };
    let clock = rehearsed(&silent);
    let (mut published, _running) = watched(ClockConfig::default(), Some(silent.clone()), &clock);
    let known = published.wait_for(|known| known.text.starts_with("rehearsed")).await.expect("the task runs");
    assert_eq!((known.discipline, known.text.as_str()), (None, "rehearsed, claims nothing"));
    drop(known);

    let exact = RehearsalConfig { drift_ppm: -50.0, discipline: RehearsedDiscipline::Exact, ..silent };
    let clock = rehearsed(&exact);
    let description = clock.injected_faults().expect("it is rehearsed").clone();
    let (mut published, _running) = watched(ClockConfig::default(), Some(exact), &clock);
    let known = published.wait_for(|known| known.discipline.is_some()).await.expect("the task runs").clone();
    let error = known.discipline.expect("it was waited for").error;
    let now = description.wall_error_at(description.true_wall(clock.wall()));
    assert!(error.lo <= now && now <= error.hi, "{now} is not in {error:?}");
    assert!(error.width() < Span::from_millis(1), "{error:?}");
}
