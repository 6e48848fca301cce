//! Probes, exchanges and delays of a link within one second. No I/O.

use std::collections::BTreeMap;

use peernet_analysis::delays::{VerdictCounts, median_delay};
use peernet_clock::{Direction, Exchange, OneWayDelay, Span, Verdict, WallTime};
use peernet_probes::ProbeResult;
use peernet_stream::{DelayPoint, DelaySecond, NetworkName, ProbeCounts, RoundTrip};

use super::correction::rate;
use super::downsampled::DownsampledValues;

/// Events on a link within one second of the edge's wall clock, or within a part of that second.
#[derive(Debug)]
pub(super) struct LinkSecond {
    /// Start of the second in seconds since the Unix epoch.
    pub(super) start_s: i64,
    pub(super) probes: ProbeCounts,
    /// `true` if all probes are authenticated; `None` without probes.
    pub(super) authenticated: Option<bool>,
    /// Exchange with the best upper bound of the offset.
    pub(super) upper: Option<Exchange>,
    /// Exchange with the best lower bound of the offset.
    pub(super) lower: Option<Exchange>,
    round_trips: DownsampledValues<Span>,
    min_round_trip: Option<Span>,
    /// Delays of data by network.
    delays: BTreeMap<NetworkName, DelaysByDirection>,
}

/// Delays of both directions.
#[derive(Debug, Default)]
struct DelaysByDirection {
    up: Delays,
    down: Delays,
}

/// Delays of one direction.
#[derive(Debug, Default)]
struct Delays {
    verdicts: VerdictCounts,
    points: DownsampledValues<DelayPoint>,
}

impl LinkSecond {
    pub(super) fn new(start_s: i64) -> Self {
        Self {
            start_s,
            probes: ProbeCounts::default(),
            authenticated: None,
            upper: None,
            lower: None,
            round_trips: DownsampledValues::default(),
            min_round_trip: None,
            delays: BTreeMap::new(),
        }
    }

    /// Returns the end of the second.
    pub(super) const fn end(&self) -> WallTime {
        WallTime::from_unix_nanos(self.start_s.saturating_add(1).saturating_mul(1_000_000_000))
    }

    /// Returns whether there were neither probes nor exchanges nor delays.
    pub(super) fn is_empty(&self) -> bool {
        // The first exchange sets both bounds.
        self.upper.is_none() && self.probes == ProbeCounts::default() && self.delays.is_empty()
    }

    /// Adds an accepted exchange. Which of two bounds is better at the end of the second also depends on their ages,
    /// because a bound widens with its age.
    pub(super) fn add_exchange(&mut self, exchange: &Exchange, max_drift_ppm: f64) {
        // By the time of the newer exchange, the older bound has widened by the drift. If `exchange` is older than
        // `best`, the drift is negative: this narrows the bound of `best` instead of widening the bound of `exchange`,
        // with the same result.
        let improves_upper = |best: &Exchange| {
            exchange.upper() < best.upper() + (exchange.sent - best.sent).drift(max_drift_ppm)
        };
        if self.upper.as_ref().is_none_or(improves_upper) {
            self.upper = Some(*exchange);
        }
        let improves_lower = |best: &Exchange| {
            exchange.lower() > best.lower() - (exchange.returned - best.returned).drift(max_drift_ppm)
        };
        if self.lower.as_ref().is_none_or(improves_lower) {
            self.lower = Some(*exchange);
        }
    }

    /// Removes the exchanges. Probes, round trips and delays stay.
    pub(super) fn remove_exchanges(&mut self) {
        (self.upper, self.lower) = (None, None);
    }

    /// Adds the round trip of a probe.
    pub(super) fn add_round_trip(&mut self, round_trip: Span) {
        self.min_round_trip =
            Some(self.min_round_trip.map_or(round_trip, |min_round_trip| min_round_trip.min(round_trip)));
        self.round_trips.push(round_trip);
    }

    /// Adds the judged delay of data over a network.
    pub(super) fn add_delay(
        &mut self,
        network: &NetworkName,
        direction: Direction,
        delay: &OneWayDelay,
        bits: Option<f64>,
    ) {
        let by_direction = self.delays.entry(network.clone()).or_default();
        match direction {
            Direction::Up => by_direction.up.add(delay, bits),
            Direction::Down => by_direction.down.add(delay, bits),
        }
    }

    /// Returns the networks that carried data.
    pub(super) fn networks(&self) -> impl Iterator<Item = &NetworkName> {
        self.delays.keys()
    }

    /// Removes the delays of a network. Called after the network's last clock sample was taken.
    pub(super) fn remove_network(&mut self, network: &NetworkName) {
        self.delays.remove(network);
    }

    /// Returns the round trips of probes.
    pub(super) fn round_trips(&self) -> Option<RoundTrip> {
        Some(RoundTrip {
            min: self.min_round_trip?,
            median: self.round_trips.median(|round_trip| *round_trip)?,
        })
    }

    /// Returns the delays of one direction over a network.
    pub(super) fn delays(&self, network: &NetworkName, direction: Direction) -> Option<DelaySecond> {
        let by_direction = self.delays.get(network)?;
        match direction {
            Direction::Up => by_direction.up.summary(),
            Direction::Down => by_direction.down.summary(),
        }
    }
}

/// Adds the result of a probe to the counts.
pub(super) fn count_probe(counts: &mut ProbeCounts, result: &ProbeResult) {
    let count = match result {
        ProbeResult::Sent => &mut counts.sent,
        ProbeResult::Answered(_) | ProbeResult::ClockInterrupted(_) => &mut counts.answered,
        ProbeResult::Lost => &mut counts.lost,
        ProbeResult::Refused(_) => &mut counts.refused,
        // The probe was counted before, as answered or as lost.
        ProbeResult::Refined(_) | ProbeResult::Late => return,
    };
    *count = count.saturating_add(1);
}

impl Delays {
    fn add(&mut self, delay: &OneWayDelay, bits: Option<f64>) {
        self.verdicts.add(delay.verdict, 1);
        if let (Some(value), Some(bounds)) = (delay.value, delay.bounds) {
            let bits_per_second = bits.and_then(|bits| rate(bits, delay).value);
            self.points.push(DelayPoint { value, bounds, bits_per_second });
        }
    }

    /// Returns the number, the median and the verdict of the delays ([`Verdict::summarise`]); `None` without delays.
    fn summary(&self) -> Option<DelaySecond> {
        let verdict = Verdict::summarise(self.verdicts.counts())?;
        let count = u32::try_from(self.verdicts.total()).unwrap_or(u32::MAX);
        let median = median_delay(|key| self.points.median(key));
        Some(DelaySecond { count, median, verdict })
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{Interval, RawTime};

    use super::*;

    fn at(millis: i64) -> RawTime {
        RawTime::from_nanos(millis * 1_000_000)
    }

    /// Returns an exchange that began at `sent`, with these one-way delays, between clocks that agree; all in
    /// milliseconds.
    fn exchange(sent: i64, up: i64, down: i64) -> Exchange {
        Exchange {
            sent: at(sent),
            received: at(sent + up),
            replied: at(sent + up),
            returned: at(sent + up + down),
            uncertainty: Span::ZERO,
        }
    }

    #[test]
    fn best_exchange_of_each_bound_is_kept() {
        let mut second = LinkSecond::new(0);
        for exchange in [exchange(0, 5, 1), exchange(100, 2, 7), exchange(200, 6, 6)] {
            second.add_exchange(&exchange, 50.0);
        }
        assert_eq!(second.upper, Some(exchange(100, 2, 7)));
        assert_eq!(second.lower, Some(exchange(0, 5, 1)));
    }

    #[test]
    fn older_exchange_must_be_better_by_drift() {
        // 900 ms at 10,000 ppm are 9 ms. At 900 ms the bounds of the older exchange are therefore about 10 ms.
        for (delay, best) in [(9, exchange(900, 9, 9)), (11, exchange(0, 1, 1))] {
            let mut second = LinkSecond::new(0);
            second.add_exchange(&exchange(0, 1, 1), 10_000.0);
            second.add_exchange(&exchange(900, delay, delay), 10_000.0);
            assert_eq!((second.upper, second.lower), (Some(best), Some(best)));
        }
        let mut second_of_steady_clocks = LinkSecond::new(0);
        second_of_steady_clocks.add_exchange(&exchange(0, 1, 1), 50.0);
        second_of_steady_clocks.add_exchange(&exchange(900, 3, 3), 50.0);
        assert_eq!(second_of_steady_clocks.upper, Some(exchange(0, 1, 1)));
    }

    #[test]
    fn worst_verdict_counts_unless_rare() {
        let same_clock = |millis| OneWayDelay::same_clock(Span::from_millis(millis));
        // A negative delay between stamps of one clock shows a step.
        let stepped = same_clock(-1);
        let (mut second, network) = (LinkSecond::new(0), NetworkName::default());
        assert_eq!(second.delays(&network, Direction::Up), None);
        for millis in 1..=20 {
            second.add_delay(&network, Direction::Up, &same_clock(millis), Some(1e6));
        }
        second.add_delay(&network, Direction::Up, &stepped, None);
        let up = second.delays(&network, Direction::Up).expect("judged");
        assert_eq!((up.count, up.verdict), (21, Verdict::Ok), "one of twenty-one is rare");
        let median = up.median.expect("the delays have values");
        assert_eq!(
            (median.value, median.bounds),
            (Span::from_millis(11), Interval::exactly(Span::from_millis(11)))
        );
        assert!(median.bits_per_second.is_some_and(|rate| (rate * 0.011 - 1e6).abs() < 1.0), "{median:?}");

        second.add_delay(&network, Direction::Up, &stepped, None);
        assert_eq!(second.delays(&network, Direction::Up).map(|up| up.verdict), Some(Verdict::Stepped));
        second.add_delay(&network, Direction::Down, &stepped, None);
        let down = second.delays(&network, Direction::Down).expect("judged");
        assert_eq!((down.count, down.median), (1, None), "a stepped delay has no value for the median");
    }
}
