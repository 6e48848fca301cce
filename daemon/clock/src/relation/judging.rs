//! Computation of one-way delays from the offset, and their verdicts.

use super::sources::{CombinedOffset, OffsetSources};
use super::{Direction, JudgedExchange, LearnResult, Refusal, Relation};
use crate::{DelaySource, Exchange, ExchangeObservation, Interval, OneWayDelay, RawTime, Span, Verdict};

/// Minimum number of exchanges. As long as there are fewer exchanges, delays that are corrected by exchanges are
/// `stale`.
pub const MIN_EXCHANGES_FOR_FRESHNESS: u64 = 3;

impl Relation {
    /// Learns a finished exchange of data, and returns its two delays. If the exchange is refused, its delays are
    /// `stepped`, or `unsynchronised` if the clocks were never related.
    pub fn judge(&mut self, observation: &ExchangeObservation) -> JudgedExchange {
        let exchange = &observation.exchange;
        let is_fresh = self.exchange_times.has_exchange_near(
            exchange.sent,
            exchange.returned,
            self.settings.max_fresh_age,
        );
        // `is_fresh` is computed before the exchange is learned: the exchange must not count as a recent exchange for
        // its own delays. The exchange is learned before its delays are computed, so that it narrows their intervals.
        let learn_result = self.learn(observation);
        let Exchange { sent, received, replied, returned, .. } = *exchange;
        if let LearnResult::Refused(refusal) = learn_result {
            return JudgedExchange {
                learn_result,
                up: self.refused_delay(refusal, Direction::Up, sent, received),
                down: self.refused_delay(refusal, Direction::Down, replied, returned),
            };
        }
        let [up_offset, down_offset] = self.offsets_of_exchange(sent, returned);
        JudgedExchange {
            learn_result,
            up: self.corrected_delay(Direction::Up, sent, received, up_offset, is_fresh),
            down: self.corrected_delay(Direction::Down, replied, returned, down_offset, is_fresh),
        }
    }

    /// Returns the delay of a message stamped `sent` by its sender's clock and `received` by its receiver's clock. Uses
    /// the exchanges learnt so far.
    pub fn delay(&self, direction: Direction, sent: RawTime, received: RawTime) -> OneWayDelay {
        let at = edge_time(direction, sent, received);
        let is_fresh = self.exchange_times.has_exchange_near(at, at, self.settings.max_fresh_age);
        self.corrected_delay(direction, sent, received, self.combined_offset(at), is_fresh)
    }

    /// Returns the reception differences of two messages, one in each direction. Each message had a receiver on both
    /// hosts. The reception difference of a message is the time at which the receiver on the other host got the
    /// message, minus the time at which the receiver on the sender's host got the message. `up` and `down` contain the
    /// two stamps of each message; the first stamp is that of the receiver on the sender's host.
    ///
    /// A difference and its interval may be negative, because each receiver has its own delay.
    // The relation learns nothing from these stamps: none of them is the stamp of a departure, so that they do not
    // bound the offset.
    pub fn reception_differences(
        &self,
        up: (RawTime, RawTime),
        down: (RawTime, RawTime),
    ) -> [OneWayDelay; 2] {
        // `up.0` and `down.1` are the stamps of the edge's clock.
        let is_fresh = self.exchange_times.has_exchange_near(up.0, down.1, self.settings.max_fresh_age);
        let [up_offset, down_offset] = self.offsets_of_exchange(up.0, down.1);
        [
            self.corrected_difference(Direction::Up, up.0, up.1, up_offset, is_fresh),
            self.corrected_difference(Direction::Down, down.0, down.1, down_offset, is_fresh),
        ]
    }

    /// Returns the difference between the times at which two receivers got one message, as
    /// [`reception_differences`](Self::reception_differences) does for a pair of messages. `sent` is the stamp of the
    /// receiver on the sender's host, `received` that of the receiver on the other host.
    pub fn reception_difference(
        &self,
        direction: Direction,
        sent: RawTime,
        received: RawTime,
    ) -> OneWayDelay {
        let at = edge_time(direction, sent, received);
        let is_fresh = self.exchange_times.has_exchange_near(at, at, self.settings.max_fresh_age);
        self.corrected_difference(direction, sent, received, self.combined_offset(at), is_fresh)
    }

    /// Computes a difference between two receivers from the offset at the time of the edge's stamp.
    fn corrected_difference(
        &self,
        direction: Direction,
        sent: RawTime,
        received: RawTime,
        offset: Option<CombinedOffset>,
        is_fresh: bool,
    ) -> OneWayDelay {
        let raw = received - sent;
        let Some(offset) = offset else {
            return OneWayDelay::unsynchronised(raw);
        };
        let (lo, hi, value) = subtract_offset(direction, raw, &offset);
        // The difference has a slightly different length by each of the two clocks, because the clocks drift apart.
        let drift = Span::from_nanos(self.bands.limit().max_change_over(lo.abs().max(hi.abs()).nanos()));
        // There is no drift between two stamps of one clock.
        let is_exact = offset.source == DelaySource::SameClock && offset.is_consistent;
        let bounds =
            if is_exact { Interval::exactly(raw) } else { Interval { lo: lo - drift, hi: hi + drift } };
        self.with_verdict(edge_time(direction, sent, received), raw, (value, bounds), &offset, is_fresh)
    }

    /// Returns the offsets at the times at which an exchange was sent and returned.
    // Both directions share one estimate, so that the two delays add up to the round trip.
    fn offsets_of_exchange(&self, sent: RawTime, returned: RawTime) -> [Option<CombinedOffset>; 2] {
        let down = self.combined_offset(returned);
        let up_estimate = down.map(|down| down.estimate + self.bands.offset_change(returned, sent));
        [self.offset_sources(sent, up_estimate).combine(), down]
    }

    /// Returns the offset at a time that follows from all sources together; `None` if there is no source.
    fn combined_offset(&self, at: RawTime) -> Option<CombinedOffset> {
        self.offset_sources(at, None).combine()
    }

    /// Returns the interval of each source at a time. `estimate`, if given, replaces the band's own estimate.
    pub(super) fn offset_sources(&self, at: RawTime, estimate: Option<Span>) -> OffsetSources {
        let band = self.bands.interval(at);
        let band_offset = band.map(|band| {
            let estimate = match estimate {
                Some(estimate) => estimate.clamp(band.interval.lo, band.interval.hi),
                None => self.bands.estimate(at, band),
            };
            (band.interval, estimate)
        });
        let same_clock = self.same_clock.then_some((DelaySource::SameClock, Interval::exactly(Span::ZERO)));
        let claimed_offset = || {
            let offset = self.claims.offset_at(at, self.bands.limit());
            offset.filter(|_| self.settings.trust_time_daemons)
        };
        OffsetSources {
            band_offset,
            is_consistent: band.is_none_or(|band| band.is_consistent),
            proof_or_claims: same_clock.or_else(claimed_offset),
        }
    }

    /// Returns the verdict on an offset: `ok`, `stale` or `inconsistent`. `is_fresh` says whether there are recent
    /// exchanges.
    // The age of exchanges and violated limits matter only if exchanges narrow the interval of the offset.
    pub(super) fn verdict_of(&self, offset: &CombinedOffset, is_fresh: bool) -> Verdict {
        let uses_exchanges = matches!(offset.source, DelaySource::InBand | DelaySource::Intersection);
        if !offset.is_consistent || (uses_exchanges && self.violates_limit()) {
            return Verdict::Inconsistent;
        }
        // Suspects may be the first exchanges after a step. Until this is decided, the offset may be outdated.
        if uses_exchanges
            && (!is_fresh
                || self.bands.exchange_count() < MIN_EXCHANGES_FOR_FRESHNESS
                || !self.contradictions.suspects.is_empty())
        {
            return Verdict::Stale;
        }
        Verdict::Ok
    }

    /// Returns the delay of a refused exchange: `stepped` after a step or if the clocks were related, otherwise
    /// `unsynchronised`.
    fn refused_delay(
        &self,
        refusal: Refusal,
        direction: Direction,
        sent: RawTime,
        received: RawTime,
    ) -> OneWayDelay {
        let raw = received - sent;
        let at = edge_time(direction, sent, received);
        // After a restart there is no offset until an exchange is accepted, although the clocks were related
        // before.
        let were_related = self.estimate_before_restart.is_some() || self.combined_offset(at).is_some();
        if refusal == Refusal::Stepped || were_related {
            OneWayDelay::stepped(raw, DelaySource::None)
        } else {
            OneWayDelay::unsynchronised(raw)
        }
    }

    /// Computes a delay from the offset at the time of the edge's stamp.
    ///
    /// A delay has a slightly different length by each of the two clocks: the lengths differ by up to ρ × delay, where
    /// ρ is the limit of drift. The interval contains both lengths.
    fn corrected_delay(
        &self,
        direction: Direction,
        sent: RawTime,
        received: RawTime,
        offset: Option<CombinedOffset>,
        is_fresh: bool,
    ) -> OneWayDelay {
        let raw = received - sent;
        let at = edge_time(direction, sent, received);
        let Some(offset) = offset else {
            return OneWayDelay::unsynchronised(raw);
        };
        if offset.source == DelaySource::SameClock && offset.is_consistent {
            return OneWayDelay::same_clock(raw);
        }
        let (lo, hi, value) = subtract_offset(direction, raw, &offset);
        // A delay cannot be negative. If even the upper bound is negative, a clock was stepped near this message.
        if hi.is_negative() {
            return OneWayDelay::stepped(raw, offset.source);
        }
        let drift = Span::from_nanos(self.bands.limit().max_change_over(hi.nanos()));
        let bounds = Interval { lo: (lo - drift).max(Span::ZERO), hi: hi + drift };
        // The estimate of the offset assumes a symmetric path, so the value may be negative, which a delay cannot be.
        let value = value.clamp(lo.max(Span::ZERO), hi);
        self.with_verdict(at, raw, (value, bounds), &offset, is_fresh)
    }

    /// Returns a delay or a difference with its source and verdict.
    fn with_verdict(
        &self,
        at: RawTime,
        raw: Span,
        (value, bounds): (Span, Interval),
        offset: &CombinedOffset,
        is_fresh: bool,
    ) -> OneWayDelay {
        let verdict = match self.verdict_of(offset, is_fresh) {
            Verdict::Ok if bounds.is_wide_for(value) || self.bands.is_near_suspected_jump(at) => {
                Verdict::Limited
            }
            verdict => verdict,
        };
        // If the verdict is `inconsistent`, one of the sources is wrong. It is not known which source, so there is no
        // valid interval.
        let is_valid = verdict != Verdict::Inconsistent;
        OneWayDelay {
            raw,
            value: is_valid.then_some(value),
            bounds: is_valid.then_some(bounds),
            source: offset.source,
            verdict,
        }
    }
}

/// Returns the stamp of the edge's clock: `sent` upwards, `received` downwards.
fn edge_time(direction: Direction, sent: RawTime, received: RawTime) -> RawTime {
    match direction {
        Direction::Up => sent,
        Direction::Down => received,
    }
}

/// Returns the lower bound, the upper bound and the estimate of a raw difference after the clocks' offset is removed.
fn subtract_offset(direction: Direction, raw: Span, offset: &CombinedOffset) -> (Span, Span, Span) {
    match direction {
        Direction::Up => (raw - offset.bounds.hi, raw - offset.bounds.lo, raw - offset.estimate),
        Direction::Down => (raw + offset.bounds.lo, raw + offset.bounds.hi, raw + offset.estimate),
    }
}
