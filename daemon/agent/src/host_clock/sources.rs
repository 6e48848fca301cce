//! The sources of claims about this host's wall clock, queried together.

use std::time::Duration;

use peernet_clock::{SharedClock, Span};

use super::chronyc::{CHRONYC_TIMEOUT, Chronyc};
use super::claim::{ClaimSummary, combine};
use super::{exact_claim, kernel};
use crate::config::{ClaimPolicy, ClaimSource, ClockConfig, ClockFaultConfig};

/// Time for which a claim must hold after the next query is due: the query and the announcement to a peer take time.
const CLAIM_MARGIN: Duration = CHRONYC_TIMEOUT.saturating_add(Duration::from_secs(1));
/// Longest interval between exact claims. It is short, because an injected drift may be fast.
const EXACT_INTERVAL: Duration = Duration::from_secs(1);

/// The configured sources of claims.
#[derive(Debug)]
pub(super) struct ClaimSources {
    clock: SharedClock,
    true_clock: SharedClock,
    /// Interval between two queries.
    period: Duration,
    origin: ClaimOrigin,
    /// `true` if the claims of the last query contradicted each other.
    is_contradictory: bool,
}

/// Origin of the claims.
#[derive(Debug)]
enum ClaimOrigin {
    /// Claims of the host's time daemons.
    Daemons { kernel: bool, chronyc: Option<Chronyc> },
    /// Clock fault injection: the exact error.
    Exact,
    /// Clock fault injection: no claim.
    None,
}

impl ClaimSources {
    /// Creates the configured sources. `true_clock` is the clock without injected faults.
    pub(super) fn new(
        config: &ClockConfig,
        faults: Option<&ClockFaultConfig>,
        clock: SharedClock,
        true_clock: SharedClock,
    ) -> Self {
        let mut period = config.discipline_interval();
        let is_configured = |source| config.discipline.contains(&source);
        let origin = match faults.map(|faults| faults.discipline) {
            Some(ClaimPolicy::None) => ClaimOrigin::None,
            Some(ClaimPolicy::Exact) => {
                period = period.min(EXACT_INTERVAL);
                ClaimOrigin::Exact
            }
            // Daemons that are unaware of injected faults are queried as daemons without injected faults are.
            Some(ClaimPolicy::Unaware) | None => ClaimOrigin::Daemons {
                kernel: is_configured(ClaimSource::Kernel),
                chronyc: is_configured(ClaimSource::Chrony).then(|| Chronyc::new(config, clock.clone())),
            },
        };
        Self { clock, true_clock, period, origin, is_contradictory: false }
    }

    /// Returns the interval at which the sources have to be queried.
    pub(super) const fn interval(&self) -> Duration {
        self.period
    }

    /// Queries all sources. The returned summary holds until the next summary is announced.
    pub(super) async fn query(&mut self) -> ClaimSummary {
        let validity = Span::from(self.period + CLAIM_MARGIN);
        let summary = match &mut self.origin {
            ClaimOrigin::None => ClaimSummary {
                text: "no claim, because clock faults are injected".to_owned(),
                ..ClaimSummary::default()
            },
            ClaimOrigin::Exact => ClaimSummary {
                claim: self
                    .clock
                    .injected_faults()
                    .map(|faults| exact_claim::exact_claim(faults, self.true_clock.wall(), validity)),
                text: "exact claim, because clock faults are injected".to_owned(),
                is_contradictory: false,
            },
            ClaimOrigin::Daemons { kernel, chronyc } => {
                let mut reports = Vec::new();
                if let Some(chronyc) = chronyc {
                    reports.extend(chronyc.query().await);
                }
                // The time is read after chrony has answered, because the answer takes time.
                let now = self.clock.mono();
                if *kernel {
                    reports.push(kernel::query(now));
                }
                combine(&reports, now + validity)
            }
        };
        if summary.is_contradictory && !self.is_contradictory {
            tracing::warn!("this host's clock: {}", summary.text);
        }
        self.is_contradictory = summary.is_contradictory;
        summary
    }
}
