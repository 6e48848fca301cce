//! Simulated clocks of two hosts and a network between them, for tests that know the truth.

use peernet_statistics::SplitMix64;

use crate::{Exchange, ExchangeObservation, RawTime, Span};

/// Pseudo-random numbers; the same for the same seed.
#[derive(Clone, Debug)]
pub(crate) struct RandomSource(SplitMix64);

impl RandomSource {
    pub(crate) const fn new(seed: u64) -> Self {
        Self(SplitMix64::new(seed))
    }

    pub(crate) const fn bits(&mut self) -> u64 {
        self.0.bits()
    }

    /// Returns a number from 0 up to 1.
    pub(crate) fn unit(&mut self) -> f64 {
        self.0.unit()
    }

    pub(crate) fn between(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.unit()
    }

    pub(crate) fn exponential(&mut self, mean: f64) -> f64 {
        mean * self.0.exponential()
    }

    pub(crate) fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }
}

/// A simulated clock, described by its error against true time in consecutive pieces. Times are nanoseconds of true
/// time since the start of the simulation.
#[derive(Clone, Debug)]
pub(crate) struct SimulatedClock {
    /// Pieces in the order of time.
    pieces: Vec<Piece>,
}

/// Piece of a clock's error: from `start` on, the error begins at `error`, and grows with a drift that changes
/// steadily.
#[derive(Clone, Copy, Debug)]
struct Piece {
    start: f64,
    error: f64,
    drift: f64,
    /// Change of the drift per nanosecond.
    change: f64,
}

impl Piece {
    fn error(&self, t: f64) -> f64 {
        let elapsed = t - self.start;
        self.error + elapsed * (self.drift + elapsed * self.change / 2.0)
    }

    fn drift(&self, t: f64) -> f64 {
        self.drift + (t - self.start) * self.change
    }
}

impl SimulatedClock {
    /// Creates a clock that is ahead by `offset` at the start and fast by `ppm`.
    pub(crate) fn drifting(offset: Span, ppm: f64) -> Self {
        let piece = Piece { start: 0.0, error: offset.nanos() as f64, drift: ppm * 1e-6, change: 0.0 };
        Self { pieces: vec![piece] }
    }

    /// Creates a clock whose drift changes for `length`, as it does with temperature: the drift stays within ± `ppm`,
    /// and its rate of change within ± `ppm_per_s`.
    pub(crate) fn warming(
        offset: Span,
        ppm: f64,
        ppm_per_s: f64,
        length: Span,
        random: &mut RandomSource,
    ) -> Self {
        let (mut t, mut drift) = (0.0, random.between(-ppm, ppm));
        let mut clock = Self::drifting(offset, drift);
        while t < length.nanos() as f64 {
            let change = match random.bits() % 4 {
                0 => 0.0,
                1 => ppm_per_s,
                2 => -ppm_per_s,
                _ => random.between(-ppm_per_s, ppm_per_s),
            };
            // Seconds until the drift would leave ± `ppm`.
            let max_duration =
                if change == 0.0 { f64::INFINITY } else { (ppm.copysign(change) - drift) / change };
            let duration = (random.exponential(8.0) + 0.1).min(max_duration);
            // If the drift is at ± `ppm` already, a change outwards has no duration. Another change is then drawn.
            if duration > 1e-3 {
                let error = clock.error(t);
                clock.pieces.push(Piece { start: t, error, drift: drift * 1e-6, change: change * 1e-15 });
                t += duration * 1e9;
                drift += change * duration;
            }
        }
        clock
    }

    /// Makes the clock faster by `ppm` from a time on. From then on the drift is constant: a new piece replaces all
    /// later pieces.
    pub(crate) fn faster(mut self, at: Span, ppm: f64) -> Self {
        let start = at.nanos() as f64;
        let piece = Piece {
            start,
            error: self.error(start),
            drift: self.piece(start).drift(start) + ppm * 1e-6,
            change: 0.0,
        };
        self.pieces.retain(|piece| piece.start < start);
        self.pieces.push(piece);
        self
    }

    /// Creates a clock whose drift wanders within ± `ppm` and changes every few seconds, for `length`.
    pub(crate) fn wandering(offset: Span, ppm: f64, length: Span, random: &mut RandomSource) -> Self {
        let mut clock = Self::drifting(offset, 0.0);
        let (mut t, mut drift) = (0.0, random.between(-ppm, ppm));
        while t < length.nanos() as f64 {
            let error = clock.error(t);
            clock.pieces.push(Piece { start: t, error, drift: drift * 1e-6, change: 0.0 });
            t += random.exponential(4e9) + 1.0;
            drift = (drift + random.between(-0.4, 0.4) * ppm).clamp(-ppm, ppm);
        }
        clock
    }

    /// Steps the clock forward or back at a time.
    pub(crate) fn stepped(mut self, at: Span, by: Span) -> Self {
        let start = at.nanos() as f64;
        let current = self.piece(start);
        let (error, drift) = (current.error(start), current.drift(start));
        let index = self.pieces.partition_point(|piece| piece.start < start);
        self.pieces.insert(index, Piece { start, error, drift, change: current.change });
        self.pieces[index..].iter_mut().for_each(|piece| piece.error += by.nanos() as f64);
        self
    }

    fn piece(&self, t: f64) -> Piece {
        self.pieces[self.pieces.partition_point(|piece| piece.start <= t).max(1) - 1]
    }

    pub(crate) fn error(&self, t: f64) -> f64 {
        self.piece(t).error(t)
    }

    /// Returns the time that the clock shows, cut to whole nanoseconds as clocks do.
    pub(crate) fn shows(&self, t: f64) -> RawTime {
        RawTime::from_nanos((t + self.error(t)).floor() as i64)
    }

    /// Returns the true time at which the clock showed a time. The clock must not have been stepped.
    fn true_time(&self, shown: RawTime) -> f64 {
        let mut t = shown.nanos() as f64;
        for _ in 0..8 {
            t = shown.nanos() as f64 - self.error(t);
        }
        t
    }
}

/// The clocks of two hosts.
#[derive(Clone, Debug)]
pub(crate) struct HostClocks {
    pub(crate) edge: SimulatedClock,
    pub(crate) cloud: SimulatedClock,
}

/// True times and stamps of a message and its answer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Trip {
    /// True delay of the message.
    pub(crate) up: Span,
    /// True delay of the answer.
    pub(crate) down: Span,
    /// End in nanoseconds of true time.
    pub(crate) end: f64,
    pub(crate) exchange: Exchange,
}

impl Trip {
    pub(crate) fn observation(&self) -> ExchangeObservation {
        ExchangeObservation {
            exchange: self.exchange,
            cloud_elapsed: None,
            edge_epoch: 0,
            cloud_epoch: Some(0),
        }
    }
}

impl HostClocks {
    /// Returns a trip that begins at a true time `t`, with its delays and its service time; all in nanoseconds.
    pub(crate) fn trip(&self, t: f64, up: f64, service: f64, down: f64) -> Trip {
        let (received, replied) = (t + up, t + up + service);
        Trip {
            up: Span::from_nanos(up as i64),
            down: Span::from_nanos(down as i64),
            end: replied + down,
            exchange: Exchange {
                sent: self.edge.shows(t),
                received: self.cloud.shows(received),
                replied: self.cloud.shows(replied),
                returned: self.edge.shows(replied + down),
                uncertainty: Span::ZERO,
            },
        }
    }

    /// Returns the true offset in nanoseconds when the edge showed `at`.
    pub(crate) fn offset(&self, at: RawTime) -> f64 {
        let t = self.edge.true_time(at);
        self.cloud.error(t) - self.edge.error(t)
    }
}

/// A path between two hosts; times in nanoseconds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Path {
    /// Shortest delay of a message.
    pub(crate) up: f64,
    /// Shortest delay of an answer.
    pub(crate) down: f64,
    /// Mean of a message's usual waiting time.
    pub(crate) jitter: f64,
    /// Probability that an exchange is lost.
    pub(crate) loss: f64,
    /// Largest additional waiting time during congestion.
    pub(crate) burst: f64,
}

impl Path {
    /// Path between two network namespaces of one machine (a pair of veth devices).
    pub(crate) const VETH: Self = Self { up: 30e3, down: 30e3, jitter: 15e3, loss: 0.0, burst: 500e3 };

    /// Returns the trips between two true times (seconds) at `hz` per second, in the order in which they end.
    pub(crate) fn trips(
        &self,
        host_clocks: &HostClocks,
        seconds: (f64, f64),
        hz: f64,
        random: &mut RandomSource,
    ) -> Vec<Trip> {
        let mut trips = Vec::new();
        let (mut t, mut is_congested) = (seconds.0 * 1e9, false);
        while t < seconds.1 * 1e9 {
            if random.chance(if is_congested { 0.05 } else { 0.005 }) {
                is_congested = !is_congested;
            }
            let mut waiting_time = || {
                let burst = if is_congested { random.between(0.0, self.burst) } else { 0.0 };
                let tail = if random.chance(0.03) { random.exponential(20.0 * self.jitter) } else { 0.0 };
                burst + tail + random.exponential(self.jitter)
            };
            let (up, down) = (self.up + waiting_time(), self.down + waiting_time());
            let service = random.exponential(100e3);
            if !random.chance(self.loss) {
                trips.push(host_clocks.trip(t, up.floor(), service.floor(), down.floor()));
            }
            t += (1e9 / hz * random.between(0.5, 1.5)).floor();
        }
        trips.sort_by(|a, b| a.end.total_cmp(&b.end));
        trips
    }
}
