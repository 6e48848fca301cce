//! The sources of claims about this host's wall clock, queried together.

use std::time::Duration;

use peernet_clock::{SharedClock, Span};

use super::chronyc::{CHRONYC_TIMEOUT, Chronyc};
use super::claim::{Summary, combine};
use super::{exact_claim, kernel};
use crate::config::{ClaimedDiscipline, ClockConfig, ClockFaultConfig, DisciplineSource};

/// Time that a claim must hold after the next query is due, because the query takes time, and so does the
/// announcement to a peer.
const CLAIM_MARGIN: Duration = CHRONYC_TIMEOUT.saturating_add(Duration::from_secs(1));
/// Longest interval between exact claims. It is short, because the clock may drift fast.
const EXACT_PERIOD: Duration = Duration::from_secs(1);

/// The sources that are queried.
#[derive(Debug)]
pub(super) struct Sources {
    clock: SharedClock,
    truth: SharedClock,
    period: Duration,
    claims: Claims,
    is_contradictory: bool,
}

#[derive(Debug)]
enum Claims {
    /// Claims of the host's time daemons.
    Daemons { kernel: bool, chronyc: Option<Chronyc> },
    /// Clock fault injection: the exact error.
    Exact,
    /// Clock fault injection: no claim.
    None,
}

impl Sources {
    /// Creates the configured sources. `truth` is the clock without injected faults.
    pub(super) fn new(
        config: &ClockConfig,
        faults: Option<&ClockFaultConfig>,
        clock: SharedClock,
        truth: SharedClock,
    ) -> Self {
        let mut period = config.discipline_interval();
        let is_configured = |source| config.discipline.contains(&source);
        let claims = match faults.map(|faults| faults.discipline) {
            Some(ClaimedDiscipline::None) => Claims::None,
            Some(ClaimedDiscipline::Exact) => {
                period = period.min(EXACT_PERIOD);
                Claims::Exact
            }
            Some(ClaimedDiscipline::Unaware) | None => Claims::Daemons {
                kernel: is_configured(DisciplineSource::Kernel),
                chronyc: is_configured(DisciplineSource::Chrony).then(|| Chronyc::new(config, clock.clone())),
            },
        };
        Self { clock, truth, period, claims, is_contradictory: false }
    }

    /// Returns the interval at which to query.
    pub(super) const fn period(&self) -> Duration {
        self.period
    }

    /// Queries all sources. The summary holds until the next query, and for the time that its announcement may take.
    pub(super) async fn ask(&mut self) -> Summary {
        let ahead = Span::from(self.period + CLAIM_MARGIN);
        let summary = match &mut self.claims {
            Claims::None => {
                Summary { text: "clock fault injection, claims nothing".to_owned(), ..Summary::default() }
            }
            Claims::Exact => Summary {
                discipline: self
                    .clock
                    .faults()
                    .map(|description| exact_claim::exact_claim(description, self.truth.wall(), ahead)),
                text: "clock fault injection, claims its error exactly".to_owned(),
                is_contradictory: false,
            },
            Claims::Daemons { kernel, chronyc } => {
                let mut reports = Vec::new();
                if let Some(chronyc) = chronyc {
                    reports.extend(chronyc.ask().await);
                }
                let now = self.clock.mono();
                if *kernel {
                    reports.push(kernel::ask(now));
                }
                combine(&reports, now + ahead)
            }
        };
        if summary.is_contradictory && !self.is_contradictory {
            tracing::warn!("this host's clock: {}", summary.text);
        }
        self.is_contradictory = summary.is_contradictory;
        summary
    }
}
