//! Round trips of a driving end, one after the other, for a number of seconds after a warm-up.

use std::collections::BTreeMap;

use anyhow::bail;
use peernet_clock::{Clock, ClockIdentity, MonoTime, Span, SystemClock};
use serde_json::{Map, Value, json};

/// Number of round trips before the first that counts; the warm-up takes at most a second.
const WARM_UP: usize = 200;

/// Round trips of a driving end, with their durations.
pub(crate) struct RoundTrips {
    clock: SystemClock,
    limit: Span,
    warm_up_start: MonoTime,
    /// Beginning of the first round trip that counts.
    first_counted: Option<MonoTime>,
    /// Number of round trips that have begun, warm-up included.
    begun: usize,
    lost: usize,
    /// Durations of the round trips, and of the stages that a driving end knows, by name.
    stages: BTreeMap<&'static str, Vec<Span>>,
}

impl RoundTrips {
    /// Begins the warm-up.
    pub(crate) fn new(seconds: u64) -> anyhow::Result<Self> {
        let clock = SystemClock::new(ClockIdentity::from_system(ClockIdentity::SYSTEM)?);
        let (warm_up_start, limit) = (clock.mono(), Span::from_seconds(i64::try_from(seconds)?));
        Ok(Self {
            clock,
            limit,
            warm_up_start,
            first_counted: None,
            begun: 0,
            lost: 0,
            stages: BTreeMap::new(),
        })
    }

    /// Returns the beginning of the next round trip; `None` if the time is over.
    pub(crate) fn next(&mut self) -> Option<MonoTime> {
        let now = self.clock.mono();
        let is_warm = self.begun == WARM_UP || now - self.warm_up_start > Span::from_seconds(1);
        if self.first_counted.is_none() && is_warm {
            (self.first_counted, self.lost) = (Some(now), 0);
            self.stages.clear();
        }
        self.begun += 1;
        self.first_counted.is_none_or(|first| now - first < self.limit).then_some(now)
    }

    /// Records the end of the round trip that began at this time: its stages, or `None` if no answer came.
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

    /// Returns the results as one JSON object; quantiles are nearest ranks, in seconds.
    pub(crate) fn figures(self) -> anyhow::Result<Value> {
        let elapsed = self.clock.mono() - self.first_counted.unwrap_or(self.warm_up_start);
        let Some(answered) = self.stages.get("total").map(Vec::len) else {
            bail!("no message was answered, {} were lost", self.lost)
        };
        let stages: Map<String, Value> =
            self.stages.into_iter().map(|(name, spans)| (name.to_owned(), summarize(spans))).collect();
        Ok(json!({
            "iterations": answered,
            "seconds": elapsed.seconds(),
            "lost": self.lost,
            "stages": stages,
        }))
    }
}

fn summarize(mut spans: Vec<Span>) -> Value {
    spans.sort_unstable();
    let quantile = |percent: usize| spans.get(spans.len() * percent / 100).map(|span| span.seconds());
    json!({ "count": spans.len(), "p50": quantile(50), "p99": quantile(99) })
}
