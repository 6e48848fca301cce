//! Everyone who may say something about this host's clock, asked in turn.

use std::time::Duration;

use peernet_clock::{SharedClock, Span};

use super::chronyc::{Chronyc, PATIENCE};
use super::claim::{Summary, combine};
use super::{kernel, rehearsed};
use crate::config::{ClockConfig, DisciplineSource, RehearsalConfig, RehearsedDiscipline};

/// A claim must hold until the next one replaces it: asking takes time, and so does the way to a peer.
const ON_THE_WAY: Duration = PATIENCE.saturating_add(Duration::from_secs(1));
/// A host that knows exactly how wrong its clock is says so often, because the clock may drift fast.
const EXACT_PERIOD: Duration = Duration::from_secs(1);

/// Who is asked.
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
    /// Those of the host's time daemons.
    Daemons { kernel: bool, chronyc: Option<Chronyc> },
    /// Rehearsed: the error itself.
    Exact,
    /// Rehearsed: none.
    None,
}

impl Sources {
    /// `truth` is the clock that a rehearsal starts from.
    pub(super) fn new(
        config: &ClockConfig,
        rehearsal: Option<&RehearsalConfig>,
        clock: SharedClock,
        truth: SharedClock,
    ) -> Self {
        let mut period = config.discipline_interval();
        let asked = |source| config.discipline.contains(&source);
        let claims = match rehearsal.map(|rehearsal| rehearsal.discipline) {
            Some(RehearsedDiscipline::None) => Claims::None,
            Some(RehearsedDiscipline::Exact) => {
                period = period.min(EXACT_PERIOD);
                Claims::Exact
            }
            Some(RehearsedDiscipline::Unaware) | None => Claims::Daemons {
                kernel: asked(DisciplineSource::Kernel),
                chronyc: asked(DisciplineSource::Chrony).then(|| Chronyc::new(config, clock.clone())),
            },
        };
        Self { clock, truth, period, claims, is_contradictory: false }
    }

    /// How often to ask.
    pub(super) const fn period(&self) -> Duration {
        self.period
    }

    /// Asks everyone. The summary holds until it is time to ask again, and for as long as it may be on the way.
    pub(super) async fn ask(&mut self) -> Summary {
        let ahead = Span::from(self.period + ON_THE_WAY);
        let summary = match &mut self.claims {
            Claims::None => Summary { text: "rehearsed, claims nothing".to_owned(), ..Summary::default() },
            Claims::Exact => Summary {
                discipline: self
                    .clock
                    .rehearsal()
                    .map(|description| rehearsed::exactly(description, self.truth.wall(), ahead)),
                text: "rehearsed, claims its error exactly".to_owned(),
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
