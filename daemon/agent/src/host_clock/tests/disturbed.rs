//! Tests of steps and of clocks with injected faults.

use std::sync::Arc;

use peernet_clock::{ClockIdentity, FaultyClock, SharedClock, Span, SteppedClock};

use super::{start_watching, system_clock};
use crate::config::{ClaimPolicy, ClockConfig, ClockFaultConfig, ClockFaultStepConfig};

/// Returns the machine's clock with injected faults.
fn faulty_clock(config: &ClockFaultConfig) -> SharedClock {
    let truth = system_clock();
    let description = config.description(truth.wall());
    Arc::new(FaultyClock::new(truth, ClockIdentity::new("boot", "faulty"), description))
}

#[tokio::test]
async fn step_is_published_with_its_clock_fault() {
    let faults = ClockFaultConfig {
        offset_ms: -1000.0,
        steps: vec![ClockFaultStepConfig { at_s: 0.3, by_ms: 3000.0, clock: SteppedClock::Wall }],
        ..ClockFaultConfig::default()
    };
    let clock = faulty_clock(&faults);
    let (mut published, _running) = start_watching(ClockConfig::default(), Some(faults), &clock);
    let first = published.wait_for(|state| state.faults.is_some()).await.expect("the task runs").clone();
    assert_eq!(first.faults.as_ref(), clock.injected_faults());
    let epoch = first.epoch;
    let after = published.wait_for(|state| state.epoch > epoch).await.expect("the task runs").clone();
    assert_eq!(after.claim, None);
}

#[tokio::test]
async fn host_with_clock_fault_claims_nothing_or_exact_error() {
    let without_claim = ClockFaultConfig { offset_ms: 1000.0, ..ClockFaultConfig::default() };
    let clock = faulty_clock(&without_claim);
    let (mut published, _running) =
        start_watching(ClockConfig::default(), Some(without_claim.clone()), &clock);
    let state = published
        .wait_for(|state| state.text.ends_with("clock faults are injected"))
        .await
        .expect("the task runs");
    assert_eq!((state.claim, state.text.as_str()), (None, "no claim, because clock faults are injected"));
    drop(state);

    let exact_claim = ClockFaultConfig { drift_ppm: -50.0, discipline: ClaimPolicy::Exact, ..without_claim };
    let clock = faulty_clock(&exact_claim);
    let description = clock.injected_faults().expect("it has faults").clone();
    let (mut published, _running) = start_watching(ClockConfig::default(), Some(exact_claim), &clock);
    let state = published.wait_for(|state| state.claim.is_some()).await.expect("the task runs").clone();
    let error = state.claim.expect("it was waited for").error;
    let now = description.wall_error_at(description.true_wall(clock.wall()));
    assert!(error.lo <= now && now <= error.hi, "{now} is not in {error:?}");
    assert!(error.width() < Span::from_millis(1), "{error:?}");
}
