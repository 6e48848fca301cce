//! A reflector that the configuration names for a cloud (`[probes] reflectors`).
//!
//! The clock of the reflector is independent of the cloud's clock. Therefore the reflector has a separate relation,
//! between this host's free-running clock and the reflector's wall clock.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::pin::pin;
use std::sync::Mutex;

use peernet_clock::{
    ExchangeObservation, Interval, Offset, RelatedClocks, Relation, RelationSettings, Span, Stamp,
};
use peernet_logger::Slug;
use peernet_probes::ProbeResult;
use peernet_stream::{ProbeCounts, Probing, ReflectorLive, RoundTrip};
use tokio::sync::mpsc;

use super::answer_monitor::AnswerMonitor;
use super::link_second::count_probe;
use super::probe_pace::ProbePace;
use super::probe_target::{ProbeTarget, RESULT_CAPACITY};
use super::shared::{SharedLinkState, lock};
use crate::config::ReflectorAddress;

/// Maximum number of round trips that are kept, the latest ones.
const MAX_ROUND_TRIPS: usize = 100;

/// A reflector that the configuration names for a cloud.
#[derive(Debug)]
pub(super) struct NamedReflector {
    address: ReflectorAddress,
    probing: Mutex<Probing>,
    answers: Mutex<ReflectorAnswers>,
}

impl NamedReflector {
    /// Creates a reflector that has not been probed.
    pub(super) fn new(address: ReflectorAddress, settings: RelationSettings) -> Self {
        Self {
            address,
            probing: Mutex::new(Probing::Off("not started yet".to_owned())),
            answers: Mutex::new(ReflectorAnswers::new(settings)),
        }
    }

    /// Probes the reflector as long as the future is polled.
    pub(super) async fn probe(&self, shared: &SharedLinkState, peer: &Slug, pace: &ProbePace) -> Infallible {
        let target = ProbeTarget {
            peer: peer.clone(),
            host: self.address.host.clone(),
            port: self.address.port,
            // The configured key is shared with peers, not with this reflector.
            key: None,
            instance: None,
            clocks: RelatedClocks::RawToWall,
        };
        let (results, mut received_results) = mpsc::channel(RESULT_CAPACITY);
        let mut probing = pin!(target.probe(shared, pace, &self.probing, results));
        let mut monitor = AnswerMonitor::new(peer.clone(), target.key.is_some());
        loop {
            tokio::select! {
                Some(result) = received_results.recv() => {
                    lock(&self.answers).record(&result);
                    monitor.record(&result, shared.host.clock.mono(), &mut lock(&self.probing));
                }
                never = &mut probing => match never {},
            }
        }
    }

    /// Returns the live state at `now`. `wall_ahead` is the time by which this host's wall clock is ahead of its
    /// free-running clock.
    pub(super) fn live(&self, rate_hz: f64, now: Stamp, wall_ahead: Interval) -> ReflectorLive {
        let mut probing = lock(&self.probing).clone();
        // The stored rate is the rate at which probing started.
        if let Probing::On { rate_hz: shown_rate_hz, .. } = &mut probing {
            *shown_rate_hz = rate_hz;
        }
        let answers = lock(&self.answers);
        ReflectorLive {
            address: self.address.to_string(),
            probing,
            probes: answers.probes,
            round_trip: answers.round_trip(),
            offset: answers.wall_offset(now, wall_ahead),
        }
    }
}

/// Results of the probes to a reflector. No I/O.
#[derive(Debug)]
struct ReflectorAnswers {
    relation: Relation,
    probes: ProbeCounts,
    /// Latest round trips.
    round_trips: VecDeque<Span>,
}

impl ReflectorAnswers {
    fn new(settings: RelationSettings) -> Self {
        let clocks = RelatedClocks::RawToWall;
        // A reflector announces no claims of time daemons, because it runs no agent.
        let settings = RelationSettings { clocks, trust_time_daemons: false, ..settings };
        let relation = Relation::new(settings);
        Self { relation, probes: ProbeCounts::default(), round_trips: VecDeque::new() }
    }

    fn record(&mut self, result: &ProbeResult) {
        count_probe(&mut self.probes, result);
        match result {
            ProbeResult::ClockInterrupted(epoch) => self.relation.restart_after_edge_step(*epoch),
            ProbeResult::Answered(observation) => {
                self.learn(observation);
                if self.round_trips.len() >= MAX_ROUND_TRIPS {
                    self.round_trips.pop_front();
                }
                self.round_trips.push_back(observation.exchange.round_trip());
            }
            ProbeResult::Refined(observation) => _ = self.relation.refine(observation),
            ProbeResult::Sent | ProbeResult::Lost | ProbeResult::Late | ProbeResult::Refused(_) => {}
        }
    }

    /// Adds an exchange to the relation. The result is not needed: if the relation refuses exchanges, the offset
    /// becomes stale or contradictory.
    fn learn(&mut self, observation: &ExchangeObservation) {
        let _ = self.relation.learn(observation);
    }

    /// Returns minimum and median of the latest round trips; `None` before the first answer.
    fn round_trip(&self) -> Option<RoundTrip> {
        let mut round_trips: Vec<Span> = self.round_trips.iter().copied().collect();
        round_trips.sort_unstable();
        Some(RoundTrip { min: *round_trips.first()?, median: *round_trips.get(round_trips.len() / 2)? })
    }

    /// Returns the offset of the reflector's wall clock from this host's wall clock. This is the relation's offset
    /// minus `wall_ahead`, the time by which this host's wall clock is ahead of its free-running clock.
    fn wall_offset(&self, now: Stamp, wall_ahead: Interval) -> Option<Offset> {
        let offset = self.relation.offset(now.raw, now.wall)?;
        let between_wall_clocks =
            |from: Interval| Interval { lo: from.lo - wall_ahead.hi, hi: from.hi - wall_ahead.lo };
        Some(Offset {
            estimate: offset.estimate - wall_ahead.middle(),
            bounds: between_wall_clocks(offset.bounds),
            sources: offset
                .sources
                .iter()
                .map(|(source, interval)| (*source, between_wall_clocks(*interval)))
                .collect(),
            // The relation's skew is relative to the free-running clock. The skew relative to the wall clock differs,
            // and changes when the wall clock is slewed.
            skew_ppm: None,
            ..offset
        })
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{Exchange, RawTime, Verdict, WallTime};

    use super::*;

    /// Returns an exchange that begins at `at`, with a reflector whose wall clock is `wall_ahead` ahead of this host's
    /// free-running clock. The delays are 2 ms to the reflector and 1 ms back. All times are in milliseconds.
    fn exchange(at: i64, wall_ahead: i64) -> ProbeResult {
        let raw = |millis: i64| RawTime::from_nanos(millis * 1_000_000);
        ProbeResult::Answered(ExchangeObservation {
            exchange: Exchange {
                sent: raw(at),
                received: raw(at + wall_ahead + 2),
                replied: raw(at + wall_ahead + 2),
                returned: raw(at + 3),
                uncertainty: Span::ZERO,
            },
            cloud_elapsed: None,
            edge_epoch: 0,
            cloud_epoch: None,
        })
    }

    #[test]
    fn wall_offset_is_relation_offset_minus_wall_ahead() {
        let mut answers = ReflectorAnswers::new(RelationSettings::default());
        let millis = Span::from_millis;
        let now = Stamp {
            raw: RawTime::from_nanos(0) + millis(1_000),
            wall: WallTime::from_unix_nanos(0) + millis(5_000 + 1_000),
            ..Stamp::default()
        };
        // This host's wall clock is 5 s ahead of its free-running clock, to a millisecond.
        let wall_ahead = Interval { lo: millis(5_000), hi: millis(5_001) };
        assert_eq!(answers.wall_offset(now, wall_ahead), None);
        for at in [100, 400, 700, 990] {
            answers.record(&ProbeResult::Sent);
            answers.record(&exchange(at, 5_000 + 70));
        }
        answers.record(&ProbeResult::Refused("shorter than a reply"));
        answers.record(&ProbeResult::Lost);
        let offset = answers.wall_offset(now, wall_ahead).expect("known");
        assert_eq!(offset.verdict, Verdict::Ok);
        assert!(offset.bounds.contains(millis(70)) && offset.bounds.contains(offset.estimate), "{offset:?}");
        assert!(offset.bounds.width() < millis(5), "{offset:?}");
        assert_eq!(answers.probes, ProbeCounts { sent: 4, answered: 4, lost: 1, refused: 1 });
        assert_eq!(answers.round_trip(), Some(RoundTrip { min: millis(3), median: millis(3) }));
    }
}
