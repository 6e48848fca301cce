//! Round trips that a driving end makes, one after the other, for so many seconds after a warm-up.

use std::collections::BTreeMap;

use anyhow::bail;
use peernet_clock::{Clock, ClockIdentity, MonoTime, Span, SystemClock};
use serde_json::{Map, Value, json};

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
    /// How long each took, and the stages that a driving end knows of each, by name.
    stages: BTreeMap<&'static str, Vec<Span>>,
}

impl RoundTrips {
    /// Begins the warm-up.
    pub(crate) fn new(seconds: u64) -> anyhow::Result<Self> {
        let clock = SystemClock::new(ClockIdentity::of_this_machine(ClockIdentity::SYSTEM)?);
        let (start, limit) = (clock.mono(), Span::from_seconds(i64::try_from(seconds)?));
        Ok(Self { clock, limit, start, begin: None, begun: 0, lost: 0, stages: BTreeMap::new() })
    }

    /// Returns when the next round trip begins, or `None` when the time is over.
    pub(crate) fn next(&mut self) -> Option<MonoTime> {
        let now = self.clock.mono();
        if self.begin.is_none() && (self.begun == WARM_UP || now - self.start > Span::from_seconds(1)) {
            (self.begin, self.lost) = (Some(now), 0);
            self.stages.clear();
        }
        self.begun += 1;
        self.begin.is_none_or(|begin| now - begin < self.limit).then_some(now)
    }

    /// Records the end of the round trip that began at this time: its stages, or `None` where no answer came.
    pub(crate) fn record(&mut self, begin: MonoTime, stages: Option<&[(&'static str, Span)]>) {
        let Some(stages) = stages else {
            self.lost += 1;
            return;
        };
        let total = ("total", self.clock.mono() - begin);
        for (name, span) in stages.iter().copied().chain([total]) {
            self.stages.entry(name).or_default().push(span);
        }
    }

    /// Returns what the benchmarks read, as one JSON object; quantiles are nearest ranks, in seconds.
    pub(crate) fn figures(self) -> anyhow::Result<Value> {
        let elapsed = self.clock.mono() - self.begin.unwrap_or(self.start);
        let Some(answered) = self.stages.get("total").map(Vec::len) else {
            bail!("no message was answered, {} were lost", self.lost)
        };
        let stages: Map<String, Value> =
            self.stages.into_iter().map(|(name, spans)| (name.to_owned(), spread(spans))).collect();
        Ok(json!({
            "iterations": answered,
            "seconds": elapsed.seconds(),
            "lost": self.lost,
            "stages": stages,
        }))
    }
}

fn spread(mut spans: Vec<Span>) -> Value {
    spans.sort_unstable();
    let at = |percent: usize| spans.get(spans.len() * percent / 100).map(|span| span.seconds());
    json!({ "count": spans.len(), "p50": at(50), "p99": at(99) })
}
