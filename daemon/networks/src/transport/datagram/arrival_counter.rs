//! Counts the datagrams of one direction of a connection: how many arrived, were duplicated, were reordered and were
//! lost.
//!
//! Every datagram with data has a number, the next number of its connection and direction. A retransmission gets a new
//! number (as packet numbers in RFC 9000, section 12.3). A missing number counts as lost only after a delay, so that a
//! late datagram does not decrease a total.

mod gap_check;

use peernet_clock::{MonoTime, Span};

pub(super) use self::gap_check::MAX_GAP;
use self::gap_check::{GapCheck, NewNumber};
use crate::statistics::DatagramStatistics;

/// Shortest time after which a missing number counts as lost. The longest is about twice that, because the wait for a
/// number begins when the wait for earlier numbers ends.
const LOSS_DELAY: Span = Span::from_seconds(1);

/// Number of remembered datagram numbers, which are the latest ones. For each, one bit says whether its datagram has
/// arrived. A datagram with an older number counts neither as duplicated nor as reordered, because it may be either.
const REMEMBERED_NUMBERS: u64 = 4_096;

/// Totals that the receiving end of a direction reports to its sending end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ArrivalTotals {
    /// Datagrams that never arrived.
    pub(crate) lost: u64,
    /// Datagrams that arrived more than once.
    pub(crate) duplicated: u64,
    /// Datagrams that arrived after a datagram that was sent later.
    pub(crate) reordered: u64,
}

impl ArrivalTotals {
    /// Returns the larger value of each total. Reports may arrive out of order.
    pub(crate) fn max(self, other: Self) -> Self {
        self.map_totals(other, u64::max)
    }

    /// Returns the smaller value of each total.
    pub(crate) fn min(self, other: Self) -> Self {
        self.map_totals(other, u64::min)
    }

    fn map_totals(self, other: Self, select: fn(u64, u64) -> u64) -> Self {
        Self {
            lost: select(self.lost, other.lost),
            duplicated: select(self.duplicated, other.duplicated),
            reordered: select(self.reordered, other.reordered),
        }
    }
}

/// Counts arriving datagrams by their numbers.
#[derive(Debug)]
pub(crate) struct ArrivalCounter {
    /// Number of datagrams that arrived, including duplicates.
    datagrams: u64,
    totals: ArrivalTotals,
    /// Numbers below this one are known to have been sent.
    next_number: u64,
    /// One bit for each remembered number, at the number modulo [`REMEMBERED_NUMBERS`].
    arrival_bits: Vec<u64>,
    /// Numbers below this one have been counted: they have arrived or are lost.
    counted_below: u64,
    /// The numbers from `counted_below` on that are below this one are pending: they were sent, and count as lost if they
    /// are missing for [`LOSS_DELAY`].
    pending_below: u64,
    /// Time since which these numbers are pending.
    pending_since: MonoTime,
    /// Count of the numbers from `counted_below` to `pending_below` that have arrived.
    arrived_pending: u64,
    /// Count of the numbers from `pending_below` on that have arrived.
    arrived_later: u64,
    gap_check: GapCheck,
}

impl ArrivalCounter {
    pub(crate) fn new(now: MonoTime) -> Self {
        Self {
            datagrams: 0,
            totals: ArrivalTotals::default(),
            next_number: 0,
            arrival_bits: vec![0; (REMEMBERED_NUMBERS / 64) as usize],
            counted_below: 0,
            pending_below: 0,
            pending_since: now,
            arrived_pending: 0,
            arrived_later: 0,
            gap_check: GapCheck::new(now),
        }
    }

    /// Counts a datagram that arrived. `number` is the lower 32 bits of its number.
    pub(crate) fn record_arrival(&mut self, number: u32, now: MonoTime) {
        self.count_losses(now);
        self.datagrams += 1;
        let distance = self.distance_to(number);
        if distance >= 0 {
            let number = self.next_number + distance.unsigned_abs();
            self.record_if_plausible(NewNumber { number, has_arrived: true }, now);
            return;
        }
        let Some(number) = self.next_number.checked_add_signed(distance) else { return };
        // The number is not remembered any more: its bit belongs to a newer number.
        if self.next_number - number > REMEMBERED_NUMBERS {
            return;
        }
        if !self.set_arrived(number) {
            self.totals.duplicated += 1;
            return;
        }
        self.totals.reordered += 1;
        if number >= self.pending_below {
            self.arrived_later += 1;
        } else if number >= self.counted_below {
            self.arrived_pending += 1;
        }
    }

    /// Notes that the other end has sent all numbers below a certain number. `next` is the lower 32 bits of that
    /// number.
    pub(crate) fn note_sent(&mut self, next: u32, now: MonoTime) {
        self.count_losses(now);
        // The distance is negative if an older heartbeat arrives late.
        let number = self.next_number + self.distance_to(next).max(0).unsigned_abs();
        self.record_if_plausible(NewNumber { number, has_arrived: false }, now);
    }

    /// Records a number if it is plausible. If it confirms the number of a datagram beyond a gap, this datagram is
    /// counted now, because it was not counted when it arrived.
    fn record_if_plausible(&mut self, candidate: NewNumber, now: MonoTime) {
        let Some(confirmed) = self.gap_check.check(self.next_number, candidate, now) else { return };
        match confirmed.filter(|earlier| earlier.has_arrived) {
            Some(earlier) if earlier.number < candidate.number => {
                self.record_new(earlier);
                self.record_new(candidate);
            }
            Some(overtaking) => {
                // Numbers are recorded in ascending order. The candidate has the lower number, or reports the same
                // number.
                self.record_new(candidate);
                self.record_new(overtaking);
                self.totals.reordered += u64::from(candidate.has_arrived);
            }
            None => self.record_new(candidate),
        }
    }

    /// Records a plausible number.
    fn record_new(&mut self, NewNumber { number, has_arrived }: NewNumber) {
        if has_arrived {
            self.advance(number + 1 - self.next_number);
            self.set_arrived(number);
            self.arrived_later += 1;
        } else {
            self.advance(number.saturating_sub(self.next_number));
        }
    }

    /// Notes that `count` more numbers were sent. None of them has arrived.
    fn advance(&mut self, count: u64) {
        self.next_number += count;
        // A jump by more than the remembered numbers reuses all bits. Each bit needs to be cleared only once.
        for number in self.next_number - count.min(REMEMBERED_NUMBERS)..self.next_number {
            let (word, bit) = bit_position(number);
            self.arrival_bits[word] &= !bit;
        }
    }

    /// Returns the totals that are reported to the other end.
    pub(crate) fn totals(&mut self, now: MonoTime) -> ArrivalTotals {
        self.count_losses(now);
        self.totals
    }

    /// Returns the statistics of this direction at this end.
    pub(crate) fn statistics(&mut self, now: MonoTime) -> DatagramStatistics {
        let ArrivalTotals { lost, duplicated, reordered } = self.totals(now);
        DatagramStatistics {
            datagrams: Some(self.datagrams),
            lost: Some(lost),
            duplicated: Some(duplicated),
            reordered: Some(reordered),
            // Only the sending end knows which datagrams it retransmitted.
            retransmitted: None,
        }
    }

    /// Returns the distance from the next number to `number`; negative for lower numbers. Its absolute value is at most
    /// half of the 32-bit range.
    fn distance_to(&self, number: u32) -> i64 {
        // Serial number arithmetic (RFC 1982): the difference of the lower 32 bits tells whether a number is newer.
        i64::from(number.wrapping_sub(self.next_number as u32) as i32)
    }

    /// Notes that a remembered number arrived. Returns whether it had not arrived before.
    fn set_arrived(&mut self, number: u64) -> bool {
        let (word, bit) = bit_position(number);
        let is_new = self.arrival_bits[word] & bit == 0;
        self.arrival_bits[word] |= bit;
        is_new
    }

    /// Counts, as lost, the numbers that have been missing for longer than [`LOSS_DELAY`].
    fn count_losses(&mut self, now: MonoTime) {
        if now - self.pending_since < LOSS_DELAY {
            return;
        }
        self.totals.lost += (self.pending_below - self.counted_below).saturating_sub(self.arrived_pending);
        (self.counted_below, self.pending_below) = (self.pending_below, self.next_number);
        (self.arrived_pending, self.arrived_later) = (self.arrived_later, 0);
        self.pending_since = now;
    }
}

/// Returns the word and the bit of a remembered number.
const fn bit_position(number: u64) -> (usize, u64) {
    let index = number % REMEMBERED_NUMBERS;
    ((index / 64) as usize, 1 << (index % 64))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn at(millis: i64) -> MonoTime {
        MonoTime::default() + Span::from_millis(millis)
    }

    fn totals(lost: u64, duplicated: u64, reordered: u64) -> ArrivalTotals {
        ArrivalTotals { lost, duplicated, reordered }
    }

    #[test]
    fn number_missing_after_delay_counts_as_lost() {
        let mut counter = ArrivalCounter::new(at(0));
        for number in [0, 1, 4, 5, 4] {
            counter.record_arrival(number, at(10));
        }
        assert_eq!(counter.totals(at(900)), totals(0, 1, 0));
        counter.record_arrival(2, at(950));
        // The first call starts the delay for the numbers that were sent before this call. The second call ends the
        // delay.
        assert_eq!(counter.totals(at(1_000)), totals(0, 1, 1));
        assert_eq!(counter.totals(at(2_000)), totals(1, 1, 1));
        counter.record_arrival(3, at(2_100));
        assert_eq!(
            counter.totals(at(9_000)),
            totals(1, 1, 2),
            "the datagram that arrives too late decreases no total"
        );
        assert_eq!(counter.statistics(at(9_000)).datagrams, Some(7));
    }

    #[test]
    fn losses_at_end_are_counted_from_reported_number() {
        let mut counter = ArrivalCounter::new(at(0));
        counter.record_arrival(0, at(0));
        counter.note_sent(10, at(10));
        counter.note_sent(3, at(10));
        counter.totals(at(1_000));
        assert_eq!(counter.totals(at(2_000)), totals(9, 0, 0));
    }

    #[test]
    fn single_number_far_ahead_counts_nothing_as_lost() {
        for far_number in [100, 1 << 20, i32::MAX as u32] {
            let mut counter = ArrivalCounter::new(at(0));
            for number in [0, 1, far_number, far_number, 3, 2, 4] {
                counter.record_arrival(number, at(10));
            }
            counter.note_sent(far_number, at(20));
            counter.note_sent(5, at(30));
            counter.totals(at(1_000));
            counter.totals(at(2_000));
            assert_eq!(counter.totals(at(3_000)), totals(0, 0, 1), "{far_number}");
        }
    }

    #[test]
    fn long_gap_is_counted_when_next_packet_confirms_it() {
        let mut counter = ArrivalCounter::new(at(0));
        for number in [0, 2_000, 2_001, 2_003] {
            counter.record_arrival(number, at(10));
        }
        for _ in 0..2 {
            counter.note_sent(3_000, at(20));
        }
        counter.totals(at(1_000));
        assert_eq!(counter.totals(at(2_000)), totals(3_000 - 4, 0, 0));
    }

    #[test]
    fn datagram_overtaking_in_long_gap_is_not_lost() {
        let mut counter = ArrivalCounter::new(at(0));
        for number in [0, 2_001, 2_000, 2_002] {
            counter.record_arrival(number, at(10));
        }
        // The report of the number 4,000 was sent before the datagram with this number, and arrives after it.
        counter.record_arrival(4_000, at(20));
        counter.note_sent(4_000, at(20));
        counter.totals(at(1_000));
        assert_eq!(counter.totals(at(2_000)), totals(4_001 - 5, 0, 1));
    }

    #[test]
    fn counting_continues_after_32_bits() {
        let mut counter = ArrivalCounter::new(at(0));
        let numbers = [i32::MAX as u32 - 1, i32::MAX as u32, u32::MAX - 2, u32::MAX - 1, u32::MAX, 0, 2];
        // The numbers are a day apart, so the peer can have sent all datagrams in between.
        for (day, number) in numbers.into_iter().enumerate() {
            counter.record_arrival(number, at(day as i64 * 86_400_000));
        }
        assert_eq!(counter.next_number, (1 << 32) + 3);
        let reordered = |counter: &ArrivalCounter| counter.totals.reordered;
        assert_eq!(reordered(&counter), 0);
        counter.record_arrival(1, at(0));
        assert_eq!(reordered(&counter), 1);
    }

    #[test]
    fn number_slightly_ahead_distorts_totals_by_at_most_gap() {
        let mut counter = ArrivalCounter::new(at(0));
        for number in [0, 1, 1 + MAX_GAP as u32] {
            counter.record_arrival(number, at(10));
        }
        for number in 2..100 {
            counter.record_arrival(number, at(i64::from(number) * 100));
        }
        let totals = counter.totals(at(20_000));
        assert!(
            totals.lost <= MAX_GAP && totals.reordered <= MAX_GAP && totals.duplicated <= 1,
            "{totals:?}"
        );
    }

    proptest! {
        #[test]
        fn counted_datagrams_and_losses_add_up(
            loss in 0_u64..50, doubled in 0_u64..30, late in 0_usize..40, count in 1_u32..9_000, seed: u64,
        ) {
            let mut random = seed | 1;
            let mut chance = |percent: u64| {
                random ^= random << 13;
                random ^= random >> 7;
                random ^= random << 17;
                random % 100 < percent
            };
            let (mut arrivals, mut lost) = (Vec::new(), 0);
            for number in 0..count {
                if chance(loss) {
                    lost += 1;
                    continue;
                }
                for _ in 0..=u8::from(chance(doubled)) {
                    arrivals.push((number as usize + if chance(20) { late } else { 0 }, number));
                }
            }
            arrivals.sort_by_key(|(when, _)| *when);
            let mut counter = ArrivalCounter::new(at(0));
            for (when, number) in &arrivals {
                counter.record_arrival(*number, at(*when as i64 / 10));
            }
            counter.note_sent(count, at(1_000));
            counter.totals(at(2_000));
            let totals = counter.totals(at(3_000));
            prop_assert_eq!(totals.lost, lost);
            prop_assert_eq!(counter.datagrams, arrivals.len() as u64);
            prop_assert_eq!(counter.datagrams + lost, u64::from(count) + totals.duplicated);
            prop_assert!(late > 0 || totals.reordered == 0);
        }

        #[test]
        fn any_numbers_are_counted_without_panic(numbers in proptest::collection::vec((any::<u32>(), any::<bool>()), 0..60)) {
            let mut counter = ArrivalCounter::new(at(0));
            let mut earlier_totals = counter.totals(at(0));
            for (now, (number, arrives)) in numbers.into_iter().enumerate() {
                let now = at(now as i64 * 300);
                if arrives { counter.record_arrival(number, now) } else { counter.note_sent(number, now) }
                let totals = counter.totals(now);
                prop_assert_eq!(totals.max(earlier_totals), totals);
                earlier_totals = totals;
            }
        }
    }
}
