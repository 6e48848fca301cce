//! Simulation of an edge and a cloud with their clocks, of the network between them, and of the clock relation. The
//! same code as on a real agent judges the delays. Tests then compute the delays again from the stored data.

use peernet_clock::{
    ClockClaim, Exchange, ExchangeObservation, Interval, JudgedExchange, LearnResult, OneWayDelay, RawTime,
    RelatedClocks, Relation, RelationSettings, Span, WallTime,
};
use peernet_logger::{HostId, Measure, RawStamps, RunId, Transit};
use peernet_stream::{ClockSample, EstimateBasis, Event, Iteration, NetworkName, ProbeCounts};

use super::clocks::micros;
use super::generate::{self, Numbers};

/// Lower limit of the one-way delay of an upload of data.
const MIN_UPLOAD: Span = Span::from_millis(4);
/// Lower limit of the one-way delay of a download of data.
const MIN_DOWNLOAD: Span = Span::from_micros(600);
/// Upper limit of the random time that is added to each delay.
const MAX_JITTER: Span = Span::from_micros(100);

/// An edge and a cloud, with the relation of their clocks over time.
pub(super) struct Simulation {
    hosts: (HostId, HostId),
    clocks: RelatedClocks,
    /// True times at which the free-running clocks of the edge and of the cloud showed zero.
    pub(super) raw_zeros: (Span, Span),
    numbers: Numbers,
    relation: Relation,
    /// True time since the zero of [`generate::at`].
    pub(super) now: Span,
    /// The cloud's wall clock minus true time, without the drift of the cloud's clock, which is 20 ppm.
    pub(super) cloud_ahead: Span,
    /// The edge's wall clock minus true time. The edge's clock has no drift.
    pub(super) edge_ahead: Span,
    /// Numbers of the current epochs of the edge's and of the cloud's clock.
    epochs: (u32, u32),
    /// One-way delay of probes without jitter, if it is longer than 50 µs.
    pub(super) congestion: Span,
    /// `true` if all clock samples have the same relation period, like the samples of agents that did not detect jumps.
    pub(super) is_one_period: bool,
    /// A change that is made once, in the middle of the next simulated second.
    pub(super) at_half_second: Option<fn(&mut Self)>,
    /// The exchange with the lowest upper bound of the offset, and the exchange with the highest lower bound. Only
    /// exchanges in the current relation period since the last clock sample count.
    best_exchanges: (Option<Exchange>, Option<Exchange>),
    /// Number of the first relation period.
    pub(super) first_period: u64,
    /// Number of the current relation period.
    relation_period: u64,
    /// True delays of each iteration: up, down.
    pub(super) true_delays: Vec<(Span, Span)>,
}

impl Simulation {
    /// Makes both hosts, related by these clocks.
    pub(super) fn new(hosts: (HostId, HostId), clocks: RelatedClocks) -> Self {
        let settings = RelationSettings {
            clocks,
            max_drift_ppm: 50.0,
            trust_time_daemons: true,
            ..RelationSettings::default()
        };
        Self {
            hosts,
            clocks,
            raw_zeros: (Span::from_seconds(-3_600), Span::from_seconds(-777_000)),
            numbers: Numbers::new(11),
            relation: Relation::new(settings),
            now: Span::ZERO,
            cloud_ahead: Span::from_millis(1_250),
            edge_ahead: Span::ZERO,
            epochs: (0, 0),
            congestion: Span::ZERO,
            is_one_period: false,
            at_half_second: None,
            best_exchanges: (None, None),
            // Greater than SQLite's greatest integer: agents draw the number of a relation period from all of `u64`.
            first_period: 1 << 63,
            relation_period: 1 << 63,
            true_delays: Vec::new(),
        }
    }

    /// Sets the cloud's clock; the cloud reports the step.
    pub(super) fn step_cloud(&mut self, by: Span) {
        self.cloud_ahead += by;
        self.epochs.1 += 1;
    }

    /// Sets the edge's clock; the edge detects the step.
    pub(super) fn step_edge(&mut self, by: Span) {
        self.edge_ahead += by;
        self.epochs.0 += 1;
    }

    /// Sets what the time daemons of both hosts claim. The edge claims no error, so the cloud's claim is about the offset.
    pub(super) fn claim(&mut self, claim: Option<ClockClaim>) {
        let edge_claim = claim.map(|claim| ClockClaim { error: Interval::exactly(Span::ZERO), ..claim });
        self.relation.set_claims(edge_claim, claim, self.edge_stamp(self.now));
    }

    /// Simulates a second with ten probes and, if there is a run, ten iterations. Returns the iterations and the clock
    /// sample at the end of the second.
    pub(super) fn second(&mut self, run: Option<RunId>) -> (Vec<Iteration>, Event) {
        let mut iterations = Vec::new();
        for turn in 0..10 {
            if let Some(change) = self.at_half_second.take_if(|_| turn == 5) {
                change(self);
            }
            let probe = self.exchange((self.congestion, self.congestion), Span::from_micros(20)).stamps;
            let learned = self.relation.learn(&self.observation(probe));
            self.record_exchange(probe, learned);
            self.now += Span::from_millis(37);
            if let Some(run) = run {
                iterations.push(self.iteration(run));
            }
            self.now += Span::from_millis(63);
        }
        (iterations, self.sample())
    }

    fn iteration(&mut self, run: RunId) -> Iteration {
        let started = self.edge_wall(self.now);
        let SimulatedExchange { stamps, wall, delays } =
            self.exchange((MIN_UPLOAD, MIN_DOWNLOAD), Span::from_millis(10));
        self.true_delays.push(delays);
        let number = self.true_delays.len() as u64;
        let JudgedExchange { learn_result, up, down } = self.relation.judge(&self.observation(stamps));
        self.record_exchange(stamps, learn_result);
        let mut random = Numbers::new(number);
        let mut iteration = generate::iteration_at(run, number, self.hosts, started, &mut random);
        let [sent, received, replied, returned] = wall;
        for (stage, (sent, received), delay, raw) in [
            ("upload", (sent, received), up, (stamps.sent, stamps.received)),
            ("download", (replied, returned), down, (stamps.replied, stamps.returned)),
        ] {
            let (node, _) = iteration.tree.find(&[stage]).expect("measured");
            let raw_stamps = RawStamps { sent: raw.0, received: raw.1 };
            let transit = Transit {
                sent,
                received: Some(received),
                delay: Some(delay),
                // Only releases before 0.3 relate wall clocks, and they send no stamps of free-running clocks.
                raw_stamps: (self.clocks != RelatedClocks::Wall).then_some(raw_stamps),
            };
            *iteration.tree.measure_mut(node).expect("found") = Measure::Transit(Box::new(transit));
        }
        iteration
    }

    /// Simulates a message and its answer with these one-way delays, at least 50 µs each, plus jitter.
    fn exchange(&mut self, (up, down): (Span, Span), processing_time: Span) -> SimulatedExchange {
        let min_delay = Span::from_micros(50);
        let mut jitter = |delay: Span| delay + Span::from_nanos(self.numbers.between(0, MAX_JITTER.nanos()));
        let (up, down) = (jitter(up.max(min_delay)), jitter(down.max(min_delay)));
        let received_at = self.now + up;
        let replied_at = received_at + processing_time;
        let returned_at = replied_at + down;
        let stamps = Exchange {
            sent: self.edge_stamp(self.now),
            received: self.cloud_stamp(received_at),
            replied: self.cloud_stamp(replied_at),
            returned: self.edge_stamp(returned_at),
            uncertainty: Span::from_nanos(2),
        };
        let wall = [
            self.edge_wall(self.now),
            self.cloud_wall(received_at),
            self.cloud_wall(replied_at),
            self.edge_wall(returned_at),
        ];
        SimulatedExchange { stamps, wall, delays: (up, down) }
    }

    fn observation(&self, exchange: Exchange) -> ExchangeObservation {
        let (edge_epoch, cloud_epoch) = self.epochs;
        ExchangeObservation { exchange, cloud_elapsed: None, edge_epoch, cloud_epoch: Some(cloud_epoch) }
    }

    /// Returns the reading of the edge's related clock.
    fn edge_stamp(&self, true_time: Span) -> RawTime {
        match self.clocks {
            RelatedClocks::Wall => RawTime::from_wall(self.edge_wall(true_time)),
            RelatedClocks::Raw | RelatedClocks::RawToWall => {
                RawTime::from_nanos((true_time - self.raw_zeros.0).nanos())
            }
        }
    }

    /// Returns the reading of the cloud's related clock. The cloud's free-running clock drifts like its wall clock.
    fn cloud_stamp(&self, true_time: Span) -> RawTime {
        match self.clocks {
            RelatedClocks::Wall | RelatedClocks::RawToWall => RawTime::from_wall(self.cloud_wall(true_time)),
            RelatedClocks::Raw => RawTime::from_nanos(
                (true_time - self.raw_zeros.1 + Span::from_nanos(true_time.nanos() / 50_000)).nanos(),
            ),
        }
    }

    fn edge_wall(&self, true_time: Span) -> WallTime {
        generate::at(0.0) + true_time + self.edge_ahead
    }

    fn cloud_wall(&self, true_time: Span) -> WallTime {
        generate::at(0.0) + true_time + self.cloud_ahead + Span::from_nanos(true_time.nanos() / 50_000)
    }

    /// Begins a new relation period if the relation has restarted, and keeps the exchange if it is among the best ones.
    fn record_exchange(&mut self, exchange: Exchange, learned: LearnResult) {
        let restarts = if self.is_one_period { 0 } else { self.relation.exchange_counts().restarts };
        let relation_period = self.first_period + u64::from(restarts);
        if relation_period != self.relation_period {
            (self.relation_period, self.best_exchanges) = (relation_period, (None, None));
        }
        if matches!(learned, LearnResult::Refused(_) | LearnResult::Ignored) {
            return;
        }
        let (upper, lower) = &mut self.best_exchanges;
        if upper.is_none_or(|best| exchange.upper() < best.upper()) {
            *upper = Some(exchange);
        }
        if lower.is_none_or(|best| exchange.lower() > best.lower()) {
            *lower = Some(exchange);
        }
    }

    /// Makes the clock sample of the second that ends now.
    fn sample(&mut self) -> Event {
        let (at, at_raw) = (self.edge_wall(self.now), self.edge_stamp(self.now));
        let basis = EstimateBasis {
            clocks: self.clocks,
            at_raw: Some(at_raw),
            max_drift_change_ppm_per_s: Some(1.0),
            proven_skew_ppm: Some((19.0, 21.0)),
            oldest_exchange_age: None,
            claims_trusted: true,
            probes_authenticated: Some(true),
        };
        let (upper, lower) = std::mem::take(&mut self.best_exchanges);
        Event::Clock(Box::new(ClockSample {
            peer: self.hosts.1,
            peer_name: "cloud".parse().expect("a name"),
            at,
            relation_period: self.relation_period,
            max_drift_ppm: self.relation.settings().max_drift_ppm,
            upper,
            lower,
            offset: self.relation.offset(at_raw, at),
            probes: ProbeCounts { sent: 10, answered: 10, lost: 0, refused: 0 },
            exchanges: self.relation.exchange_counts(),
            round_trip: None,
            up: None,
            down: None,
            network: NetworkName::default(),
            // Only releases before 0.3 relate wall clocks, and they send no basis.
            basis: (self.clocks != RelatedClocks::Wall).then_some(basis),
        }))
    }

    /// Returns the interval of this half width around the current true offset.
    pub(super) fn offset_within(&self, half_width_us: i64) -> Interval {
        let offset = self.cloud_stamp(self.now) - self.edge_stamp(self.now);
        let margin = micros(-half_width_us, half_width_us);
        Interval { lo: offset + margin.lo, hi: offset + margin.hi }
    }
}

/// A message and its answer.
struct SimulatedExchange {
    /// Stamps by the related clocks.
    stamps: Exchange,
    /// Stamps by the wall clocks: sent, received, replied, returned.
    wall: [WallTime; 4],
    /// True delays: up, down.
    delays: (Span, Span),
}

/// Returns the judged delays of an iteration.
pub(super) fn delays(iteration: &Iteration) -> [OneWayDelay; 2] {
    ["upload", "download"].map(|stage| {
        let (_, node) = iteration.tree.find(&[stage]).expect("measured");
        match &node.measure {
            Measure::Transit(transit) => transit.delay.expect("judged"),
            other => panic!("{other:?}"),
        }
    })
}
