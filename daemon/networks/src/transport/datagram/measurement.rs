//! What is measured of the datagrams of a connection: losses of both directions, and the round trip.

mod round_trip;
mod told_totals;

use peernet_clock::MonoTime;

use self::round_trip::RoundTripEstimator;
use self::told_totals::ToldTotals;
use super::counting::{ArrivalCounter, ArrivalTotals};
use super::false_claim::FalseClaim;
use crate::statistics::{DatagramStatistics, TransportStatistics};

/// The measurements of one end.
#[derive(Debug)]
pub(super) struct PathMeasurement {
    /// Datagrams of the other end.
    arrivals: ArrivalCounter,
    /// Datagrams of this end, by the account of the other one.
    told: ToldTotals,
    round_trip: RoundTripEstimator,
}

impl PathMeasurement {
    pub(super) fn new(now: MonoTime) -> Self {
        Self {
            arrivals: ArrivalCounter::new(now),
            told: ToldTotals::default(),
            round_trip: RoundTripEstimator::default(),
        }
    }

    /// A datagram with data arrived.
    pub(super) fn arrive(&mut self, number: u32, now: MonoTime) {
        self.arrivals.arrive(number, now);
    }

    /// What the other end is told.
    pub(super) fn totals(&mut self, now: MonoTime) -> ArrivalTotals {
        self.arrivals.totals(now)
    }

    /// The other end tells the number of its next datagram and the totals of this end's; `sent` is how many left here.
    ///
    /// # Errors
    /// When they are more than `sent` can have led to.
    pub(super) fn tell(
        &mut self,
        number: u32,
        totals: ArrivalTotals,
        sent: u64,
        now: MonoTime,
    ) -> Result<(), FalseClaim> {
        self.arrivals.expect(number, now);
        self.told.tell(totals, sent)
    }

    /// A sign of life leaves.
    pub(super) fn ask(&mut self, now: MonoTime) {
        self.round_trip.ask(now);
    }

    /// The sign of life that left at a time is answered.
    pub(super) fn answer(&mut self, asked: MonoTime, now: MonoTime) {
        self.round_trip.answer(asked, now);
    }

    /// Datagrams of this end that were lost, as far as the other end has told.
    pub(super) fn told_lost(&self) -> u64 {
        self.told.totals().map_or(0, |told| told.lost)
    }

    /// All that is known; of `sent` datagrams so many were `retransmitted`.
    pub(super) fn statistics(&mut self, sent: u64, retransmitted: u64, now: MonoTime) -> TransportStatistics {
        let told = self.told.totals();
        TransportStatistics {
            sent: DatagramStatistics {
                datagrams: Some(sent),
                lost: told.map(|told| told.lost),
                duplicated: told.map(|told| told.duplicated),
                reordered: told.map(|told| told.reordered),
                retransmitted: Some(retransmitted),
            },
            received: self.arrivals.statistics(now),
            round_trip: self.round_trip.estimate(),
        }
    }
}
