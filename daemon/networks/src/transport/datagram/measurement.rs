//! Measurements of a connection's path: losses of both directions, and the round trip.

mod reported_totals;
mod round_trip;

use peernet_clock::MonoTime;

use self::reported_totals::ReportedTotals;
use self::round_trip::RoundTripEstimator;
use super::arrival_counter::{ArrivalCounter, ArrivalTotals};
use super::false_claim::FalseClaim;
use crate::statistics::{DatagramStatistics, TransportStatistics};

/// Measurements of a connection's path at one end.
#[derive(Debug)]
pub(super) struct PathMeasurement {
    /// Counter of the other end's datagrams that arrive at this end.
    arrivals: ArrivalCounter,
    /// Totals of this end's datagrams, as the other end reports them.
    reported: ReportedTotals,
    round_trip: RoundTripEstimator,
}

impl PathMeasurement {
    pub(super) fn new(now: MonoTime) -> Self {
        Self {
            arrivals: ArrivalCounter::new(now),
            reported: ReportedTotals::default(),
            round_trip: RoundTripEstimator::default(),
        }
    }

    /// Counts a datagram with data that arrived.
    pub(super) fn record_arrival(&mut self, number: u32, now: MonoTime) {
        self.arrivals.record_arrival(number, now);
    }

    /// Returns the totals that are reported to the other end.
    pub(super) fn totals(&mut self, now: MonoTime) -> ArrivalTotals {
        self.arrivals.totals(now)
    }

    /// Handles a report of the other end: the number of its next datagram, and the totals of the datagrams of
    /// this end. `sent` is the number of datagrams that this end has sent.
    ///
    /// # Errors
    /// If the totals are higher than `sent` allows.
    pub(super) fn receive_report(
        &mut self,
        number: u32,
        totals: ArrivalTotals,
        sent: u64,
        now: MonoTime,
    ) -> Result<(), FalseClaim> {
        self.arrivals.note_sent(number, now);
        self.reported.receive(totals, sent)
    }

    /// Notes that a heartbeat is sent.
    pub(super) fn record_ping(&mut self, now: MonoTime) {
        self.round_trip.record_ping(now);
    }

    /// Notes that the heartbeat that was sent at `sent_at` is answered.
    pub(super) fn record_pong(&mut self, sent_at: MonoTime, now: MonoTime) {
        self.round_trip.record_pong(sent_at, now);
    }

    /// Returns the number of this end's datagrams that the other end reports as lost.
    pub(super) fn reported_lost(&self) -> u64 {
        self.reported.totals().map_or(0, |totals| totals.lost)
    }

    /// Returns all totals. `sent` datagrams were sent, of which `retransmitted` were retransmissions.
    pub(super) fn statistics(&mut self, sent: u64, retransmitted: u64, now: MonoTime) -> TransportStatistics {
        let totals = self.reported.totals();
        TransportStatistics {
            sent: DatagramStatistics {
                datagrams: Some(sent),
                lost: totals.map(|totals| totals.lost),
                duplicated: totals.map(|totals| totals.duplicated),
                reordered: totals.map(|totals| totals.reordered),
                retransmitted: Some(retransmitted),
            },
            received: self.arrivals.statistics(now),
            round_trip: self.round_trip.estimate(),
        }
    }
}
