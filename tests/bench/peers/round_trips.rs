//! Round trips that a driving end makes, one after the other, for so many seconds after a warm-up.

use anyhow::bail;
use peernet_clock::{Clock, ClockIdentity, MonoTime, Span, SystemClock};
use serde_json::{Value, json};

/// Round trips before the first that counts, unless they take longer than a second.
const WARM_UP: usize = 200;

/// Round trips of a driving end and how long each took.
pub(crate) struct RoundTrips {
    clock: SystemClock,
    limit: Span,
    start: MonoTime,
    /// When the first that counts began.
    begin: Option<MonoTime>,
    begun: usize,
    lost: usize,
    spans: Vec<Span>,
}

impl RoundTrips {
    /// Begins the warm-up.
    pub(crate) fn new(seconds: u64) -> anyhow::Result<Self> {
        let clock = SystemClock::new(ClockIdentity::of_this_machine(ClockIdentity::SYSTEM)?);
        let (start, limit) = (clock.mono(), Span::from_seconds(i64::try_from(seconds)?));
        Ok(Self { clock, limit, start, begin: None, begun: 0, lost: 0, spans: Vec::new() })
    }

    /// Returns when the next round trip begins, or `None` when the time is over.
    pub(crate) fn next(&mut self) -> Option<MonoTime> {
        let now = self.clock.mono();
        if self.begin.is_none() && (self.begun == WARM_UP || now - self.start > Span::from_seconds(1)) {
            (self.begin, self.lost) = (Some(now), 0);
            self.spans.clear();
        }
        self.begun += 1;
        self.begin.is_none_or(|begin| now - begin < self.limit).then_some(now)
    }

    /// The round trip that began at this time is answered now.
    pub(crate) fn answered(&mut self, begin: MonoTime) {
        self.spans.push(self.clock.mono() - begin);
    }

    /// The current round trip has no answer.
    pub(crate) fn lost(&mut self) {
        self.lost += 1;
    }

    /// Returns what the benchmarks read, as one JSON object; quantiles are nearest ranks, in seconds.
    pub(crate) fn figures(self) -> anyhow::Result<Value> {
        let elapsed = self.clock.mono() - self.begin.unwrap_or(self.start);
        let mut spans = self.spans;
        spans.sort_unstable();
        let at = |percent: usize| spans.get(spans.len() * percent / 100).map(|span| span.seconds());
        let (Some(p50), Some(p99)) = (at(50), at(99)) else {
            bail!("no message was answered, {} were lost", self.lost)
        };
        Ok(json!({
            "iterations": spans.len(),
            "seconds": elapsed.seconds(),
            "lost": self.lost,
            "stages": { "total": { "count": spans.len(), "p50": p50, "p99": p99 } },
        }))
    }
}
