//! Tests of steps and of clocks with injected faults.

use std::sync::Arc;

use peernet_clock::{ClockIdentity, FaultyClock, SharedClock, Span, SteppedClock};

use super::{start_watching, system_clock};
use crate::config::{ClaimPolicy, ClockConfig, ClockFaultConfig, ClockFaultStepConfig};

/// Returns the machine's clock with injected faults.
fn faulty_clock(config: &ClockFaultConfig) -> SharedClock {
    let truth = system_clock();
    let injected_faults = config.clock_faults(truth.wall());
    Arc::new(FaultyClock::new(truth, ClockIdentity::new("boot", "faulty"), injected_faults))
}

#[tokio::test]
async fn injected_faults_are_published_and_step_ends_claim() {
    let faults = ClockFaultConfig {
        offset_ms: -1000.0,
        steps: vec![ClockFaultStepConfig { at_s: 0.3, by_ms: 3000.0, clock: SteppedClock::Wall }],
        ..ClockFaultConfig::default()
    };
    let clock = faulty_clock(&faults);
    let (mut published, _running) = start_watching(ClockConfig::default(), Some(faults), &clock);
    let initial_state =
        published.wait_for(|state| state.faults.is_some()).await.expect("the task runs").clone();
    assert_eq!(initial_state.faults.as_ref(), clock.injected_faults());
    let epoch = initial_state.epoch;
    let state_after_step =
        published.wait_for(|state| state.epoch > epoch).await.expect("the task runs").clone();
    assert_eq!(state_after_step.claim, None);
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
    let injected_faults = clock.injected_faults().expect("the clock has faults").clone();
    let (mut published, _running) = start_watching(ClockConfig::default(), Some(exact_claim), &clock);
    let state = published.wait_for(|state| state.claim.is_some()).await.expect("the task runs").clone();
    let error = state.claim.expect("the state has a claim").error;
    let current_error = injected_faults.wall_error_at(injected_faults.true_wall(clock.wall()));
    assert!(error.lo <= current_error && current_error <= error.hi, "{current_error} is not in {error:?}");
    assert!(error.width() < Span::from_millis(1), "{error:?}");
}
