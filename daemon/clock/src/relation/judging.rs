//! Computation of a delay from the known offset.

use super::sources::{Combined, Knowledge};
use super::{Direction, JudgedExchange, LearnResult, Refusal, Relation};
use crate::{DelaySource, Exchange, ExchangeObservation, Interval, OneWayDelay, RawTime, Span, Verdict};

/// Smallest number of exchanges in the window from which a delay is judged at all.
const LEAST_EXCHANGES: u64 = 3;

impl Relation {
    /// Learns a finished exchange of data, then judges its two delays. The delays of an exchange that was refused are
    /// `stepped`.
    pub fn judge(&mut self, observation: &ExchangeObservation) -> JudgedExchange {
        let exchange = &observation.exchange;
        let company = self.presence.near(exchange.sent, exchange.returned, self.settings.fresh);
        // Learnt after the search for recent exchanges, in which this one must not count, and before the judgement,
        // which it narrows.
        let learned = self.learn(observation);
        let Exchange { sent, received, replied, returned, .. } = *exchange;
        if let LearnResult::Refused(why) = learned {
            return JudgedExchange {
                learned,
                up: self.refused(why, Direction::Up, sent, received),
                down: self.refused(why, Direction::Down, replied, returned),
            };
        }
        let [up, down] = self.guesses(sent, returned);
        JudgedExchange {
            learned,
            up: self.delay_in_company(Direction::Up, sent, received, company, up),
            down: self.delay_in_company(Direction::Down, replied, returned, company, down),
        }
    }

    /// Returns the delay of a message stamped `sent` by its sender's clock and `received` by its receiver's, by the
    /// exchanges learnt so far.
    pub fn delay(&self, direction: Direction, sent: RawTime, received: RawTime) -> OneWayDelay {
        let at = edge_time(direction, sent, received);
        let company = self.presence.near(at, at, self.settings.fresh);
        self.delay_in_company(direction, sent, received, company, self.knowledge(at, None).combined())
    }

    /// Returns how much later one receiver got a message than another one on the other host, for a message in each
    /// direction. Each pair contains the stamps of the two receivers, with the one on the sender's host first.
    ///
    /// Nothing is learnt from the stamps, because none of them is a departure: they bound no offset. A difference and
    /// its interval may be negative, because each receiver has its own delay.
    pub fn differences(&self, up: (RawTime, RawTime), down: (RawTime, RawTime)) -> [OneWayDelay; 2] {
        let company = self.presence.near(up.0, down.1, self.settings.fresh);
        let [of_up, of_down] = self.guesses(up.0, down.1);
        [
            self.difference_in_company(Direction::Up, up.0, up.1, company, of_up),
            self.difference_in_company(Direction::Down, down.0, down.1, company, of_down),
        ]
    }

    /// Returns the same difference for one message.
    pub fn difference(&self, direction: Direction, sent: RawTime, received: RawTime) -> OneWayDelay {
        let at = edge_time(direction, sent, received);
        let company = self.presence.near(at, at, self.settings.fresh);
        self.difference_in_company(direction, sent, received, company, self.knowledge(at, None).combined())
    }

    fn difference_in_company(
        &self,
        direction: Direction,
        sent: RawTime,
        received: RawTime,
        company: bool,
        known: Option<Combined>,
    ) -> OneWayDelay {
        let raw = received - sent;
        let Some(known) = known else {
            return OneWayDelay::unsynchronised(raw);
        };
        let (lo, hi, value) = without_offset(direction, raw, &known);
        // Allowance for the drift of the two clocks during the difference, because it may be counted by either.
        let rate = Span::from_nanos(self.windows.limit().over(lo.abs().max(hi.abs()).nanos()));
        // Two stamps of one clock differ by no drift.
        let is_exact = known.source == DelaySource::SameClock && known.agree;
        let bounds =
            if is_exact { Interval::exactly(raw) } else { Interval { lo: lo - rate, hi: hi + rate } };
        self.judged(edge_time(direction, sent, received), raw, (value, bounds), &known, company)
    }

    /// Returns what is known at `sent` and at `returned`. Both directions share one estimate, so that the two delays
    /// add up to the round trip.
    fn guesses(&self, sent: RawTime, returned: RawTime) -> [Option<Combined>; 2] {
        let down = self.knowledge(returned, None).combined();
        let guess = down.map(|down| down.estimate + self.windows.growth(returned, sent));
        [self.knowledge(sent, guess).combined(), down]
    }

    /// Returns what each source states at a time. `guess`, if given, replaces the band's estimate.
    pub(super) fn knowledge(&self, at: RawTime, guess: Option<Span>) -> Knowledge {
        let known = self.windows.interval(at);
        let in_band = known.map(|known| {
            let estimate = match guess {
                Some(guess) => guess.clamp(known.interval.lo, known.interval.hi),
                None => self.windows.estimate(at, known),
            };
            (known.interval, estimate)
        });
        let same = self.same_clock.then_some((DelaySource::SameClock, Interval::exactly(Span::ZERO)));
        let claimed = || self.claims.offset().filter(|_| self.settings.trust_time_daemons);
        Knowledge {
            in_band,
            is_consistent: known.is_none_or(|known| known.is_consistent),
            other: same.or_else(claimed),
        }
    }

    /// Returns `ok`, `stale` or `inconsistent`. Exchanges must be recent, and their assumptions not in doubt, only
    /// where they narrow the interval.
    pub(super) fn verdict_of(&self, combined: &Combined, fresh: bool) -> Verdict {
        let in_band = matches!(combined.source, DelaySource::InBand | DelaySource::Intersection);
        if !combined.agree || (in_band && self.in_doubt()) {
            return Verdict::Inconsistent;
        }
        if in_band
            && (!fresh
                || self.windows.exchanges() < LEAST_EXCHANGES
                || !self.contradictions.suspects.is_empty())
        {
            return Verdict::Stale;
        }
        Verdict::Ok
    }

    /// Returns the delay of a refused exchange. After a step nothing is known yet, but the step remains the reason for
    /// the refusal.
    fn refused(&self, why: Refusal, direction: Direction, sent: RawTime, received: RawTime) -> OneWayDelay {
        let raw = received - sent;
        let at = edge_time(direction, sent, received);
        let stepped = why == Refusal::Stepped || self.restarted.is_some();
        if stepped || self.knowledge(at, Some(Span::ZERO)).combined().is_some() {
            OneWayDelay::stepped(raw, DelaySource::None)
        } else {
            OneWayDelay::unsynchronised(raw)
        }
    }

    /// Computes a delay from the offset at the edge's own stamp, which is exact.
    ///
    /// The other stamp minus what the cloud showed at that moment is the delay by the cloud's clock. By the edge's
    /// clock it may differ by ρ × delay. The interval contains both, and the value by any clock between the two.
    fn delay_in_company(
        &self,
        direction: Direction,
        sent: RawTime,
        received: RawTime,
        company: bool,
        known: Option<Combined>,
    ) -> OneWayDelay {
        let raw = received - sent;
        let at = edge_time(direction, sent, received);
        let Some(known) = known else {
            return OneWayDelay::unsynchronised(raw);
        };
        if known.source == DelaySource::SameClock && known.agree {
            return OneWayDelay::same_clock(raw);
        }
        let (lo, hi, value) = without_offset(direction, raw, &known);
        // No delay is negative, so a clock was stepped near this message.
        if hi.is_negative() {
            return OneWayDelay::stepped(raw, known.source);
        }
        let rate = Span::from_nanos(self.windows.limit().over(hi.nanos()));
        let bounds = Interval { lo: (lo - rate).max(Span::ZERO), hi: hi + rate };
        // The estimate assumes a symmetric path, so it may lie outside of what is proven.
        let value = value.clamp(lo.max(Span::ZERO), hi);
        self.judged(at, raw, (value, bounds), &known, company)
    }

    /// Builds the result with its source and verdict.
    fn judged(
        &self,
        at: RawTime,
        raw: Span,
        (value, bounds): (Span, Interval),
        known: &Combined,
        company: bool,
    ) -> OneWayDelay {
        let is_wide = bounds.width() > Span::from_nanos(value.abs().nanos() / 2);
        let verdict = match self.verdict_of(known, company) {
            Verdict::Ok if is_wide || self.windows.is_unsettled(at) => Verdict::Limited,
            verdict => verdict,
        };
        // One of the sources is wrong and it is unknown which, so that no interval can be stated.
        let is_known = verdict != Verdict::Inconsistent;
        OneWayDelay {
            raw,
            value: is_known.then_some(value),
            bounds: is_known.then_some(bounds),
            source: known.source,
            verdict,
        }
    }
}

/// Returns the stamp that is the edge's.
fn edge_time(direction: Direction, sent: RawTime, received: RawTime) -> RawTime {
    match direction {
        Direction::Up => sent,
        Direction::Down => received,
    }
}

/// Returns the lower bound, the upper bound and the estimate of a raw difference after the clocks' offset is removed.
fn without_offset(direction: Direction, raw: Span, known: &Combined) -> (Span, Span, Span) {
    match direction {
        Direction::Up => (raw - known.bounds.hi, raw - known.bounds.lo, raw - known.estimate),
        Direction::Down => (raw + known.bounds.lo, raw + known.bounds.hi, raw + known.estimate),
    }
}
