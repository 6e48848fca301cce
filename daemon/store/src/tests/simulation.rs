//! An edge and a cloud with clocks of their own, a network between them, and the relation that a real agent would keep:
//! what is stored was judged by the same code that judges it again.

use peernet_clock::{
    Discipline, Exchange, ExchangeObservation, Interval, JudgedExchange, LearnResult, OneWayDelay, RawTime,
    RelatedClocks, Relation, RelationSettings, Span, WallTime,
};
use peernet_logger::{HostId, Measure, RawStamps, RunId, Transit};
use peernet_stream::{ClockSample, EstimateBasis, Event, Iteration, NetworkName, ProbeCounts};

use super::clocks::micros;
use super::generate::{self, Numbers};

/// Delays of data: the truth, give or take [`JITTER`].
const UP: Span = Span::from_millis(4);
const DOWN: Span = Span::from_micros(600);
const JITTER: Span = Span::from_micros(100);

/// Both hosts and their relation, as time goes on.
pub(super) struct Simulation {
    hosts: (HostId, HostId),
    clocks: RelatedClocks,
    /// The true time at which the free-running clock of the edge, and that of the cloud, showed zero.
    pub(super) raw_zeros: (Span, Span),
    numbers: Numbers,
    relation: Relation,
    /// True time since [`generate::at`]'s zero.
    pub(super) now: Span,
    /// The cloud's wall clock minus true time, without its drift of 20 ppm, and the edge's.
    pub(super) cloud_ahead: Span,
    pub(super) edge_ahead: Span,
    epochs: (u32, u32),
    /// One way of a probe takes so long on top of 50 µs.
    pub(super) congestion: Span,
    /// Samples name one window, as those of agents that suspected no jumps.
    pub(super) is_one_window: bool,
    /// Happens in the middle of a second.
    pub(super) halfway: Option<fn(&mut Self)>,
    best: (Option<Exchange>, Option<Exchange>),
    /// Number of the first window.
    pub(super) first_window: u64,
    window: u64,
    /// The delays of each iteration as they really were: up, down.
    pub(super) truths: Vec<(Span, Span)>,
}

impl Simulation {
    /// Both hosts, related by these clocks.
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
            is_one_window: false,
            halfway: None,
            best: (None, None),
            first_window: 1 << 63,
            window: 1 << 63,
            truths: Vec::new(),
        }
    }

    /// The cloud's clock is set, and the cloud says so.
    pub(super) fn step_cloud(&mut self, by: Span) {
        self.cloud_ahead += by;
        self.epochs.1 += 1;
    }

    /// The edge's clock is set, and the edge notices.
    pub(super) fn step_edge(&mut self, by: Span) {
        self.edge_ahead += by;
        self.epochs.0 += 1;
    }

    /// Both hosts' time daemons speak: together they claim this of the offset.
    pub(super) fn claim(&mut self, claim: Option<Discipline>) {
        let exact = claim.map(|claim| Discipline { error: Interval::exactly(Span::ZERO), ..claim });
        self.relation.set_disciplines(exact, claim);
    }

    /// A second with ten probes, ten iterations of `run` if there is one, and the sample at its end.
    pub(super) fn second(&mut self, run: Option<RunId>) -> (Vec<Iteration>, Event) {
        let mut iterations = Vec::new();
        for turn in 0..10 {
            if let Some(change) = self.halfway.take_if(|_| turn == 5) {
                change(self);
            }
            let probe = self.exchange((self.congestion, self.congestion), Span::from_micros(20)).stamps;
            let learned = self.relation.learn(&self.observation(probe));
            self.note(probe, learned);
            self.now += Span::from_millis(37);
            if let Some(run) = run {
                iterations.push(self.iteration(run));
            }
            self.now += Span::from_millis(63);
        }
        (iterations, self.sample())
    }

    fn iteration(&mut self, run: RunId) -> Iteration {
        let started = self.edge(self.now);
        let Passage { stamps, wall, delays } = self.exchange((UP, DOWN), Span::from_millis(10));
        self.truths.push(delays);
        let number = self.truths.len() as u64;
        let JudgedExchange { learned, up, down } = self.relation.judge(&self.observation(stamps));
        self.note(stamps, learned);
        let mut random = Numbers::new(number);
        let mut iteration = generate::iteration_at(run, number, self.hosts, started, &mut random);
        let [left, arrived, answered, back] = wall;
        for (stage, (sent, received), delay, raw) in [
            ("upload", (left, arrived), up, (stamps.sent, stamps.received)),
            ("download", (answered, back), down, (stamps.replied, stamps.returned)),
        ] {
            let (node, _) = iteration.tree.find(&[stage]).expect("measured");
            let raw_stamps = RawStamps { sent: raw.0, received: raw.1 };
            let transit = Transit {
                sent,
                received: Some(received),
                delay: Some(delay),
                raw_stamps: (self.clocks != RelatedClocks::Wall).then_some(raw_stamps),
            };
            *iteration.tree.measure_mut(node).expect("found") = Measure::Transit(Box::new(transit));
        }
        iteration
    }

    /// A message and its answer, with so much delay and some jitter each, and what that came to.
    fn exchange(&mut self, (up, down): (Span, Span), at_cloud: Span) -> Passage {
        let base = Span::from_micros(50);
        let mut jitter = |of: Span| of + Span::from_nanos(self.numbers.between(0, JITTER.nanos()));
        let (up, down) = (jitter(up.max(base)), jitter(down.max(base)));
        let (arrived, left) = (self.now + up, self.now + up + at_cloud);
        let stamps = Exchange {
            sent: self.edge_stamp(self.now),
            received: self.cloud_stamp(arrived),
            replied: self.cloud_stamp(left),
            returned: self.edge_stamp(left + down),
            uncertainty: Span::from_nanos(2),
        };
        let wall = [self.edge(self.now), self.cloud(arrived), self.cloud(left), self.edge(left + down)];
        Passage { stamps, wall, delays: (up, down) }
    }

    fn observation(&self, exchange: Exchange) -> ExchangeObservation {
        let (edge_epoch, cloud_epoch) = self.epochs;
        ExchangeObservation { exchange, cloud_elapsed: None, edge_epoch, cloud_epoch: Some(cloud_epoch) }
    }

    /// What the edge's clock of the two that are related shows.
    fn edge_stamp(&self, truth: Span) -> RawTime {
        match self.clocks {
            RelatedClocks::Wall => RawTime::of_wall(self.edge(truth)),
            RelatedClocks::Raw | RelatedClocks::RawToWall => {
                RawTime::from_nanos((truth - self.raw_zeros.0).nanos())
            }
        }
    }

    /// What the cloud's shows. Its free-running clock drifts as its wall clock does.
    fn cloud_stamp(&self, truth: Span) -> RawTime {
        match self.clocks {
            RelatedClocks::Wall | RelatedClocks::RawToWall => RawTime::of_wall(self.cloud(truth)),
            RelatedClocks::Raw => RawTime::from_nanos(
                (truth - self.raw_zeros.1 + Span::from_nanos(truth.nanos() / 50_000)).nanos(),
            ),
        }
    }

    fn edge(&self, truth: Span) -> WallTime {
        generate::at(0.0) + truth + self.edge_ahead
    }

    fn cloud(&self, truth: Span) -> WallTime {
        generate::at(0.0) + truth + self.cloud_ahead + Span::from_nanos(truth.nanos() / 50_000)
    }

    fn note(&mut self, exchange: Exchange, learned: LearnResult) {
        let restarts = if self.is_one_window { 0 } else { self.relation.counts().restarts };
        let window = self.first_window + u64::from(restarts);
        if window != self.window {
            (self.window, self.best) = (window, (None, None));
        }
        if let LearnResult::Refused(_) = learned {
            return;
        }
        let (upper, lower) = &mut self.best;
        if upper.is_none_or(|best| exchange.upper() < best.upper()) {
            *upper = Some(exchange);
        }
        if lower.is_none_or(|best| exchange.lower() > best.lower()) {
            *lower = Some(exchange);
        }
    }

    fn sample(&mut self) -> Event {
        let (at, at_raw) = (self.edge(self.now), self.edge_stamp(self.now));
        let basis = EstimateBasis {
            clocks: self.clocks,
            at_raw: Some(at_raw),
            max_drift_change_ppm_per_s: Some(1.0),
            proven_skew_ppm: Some((19.0, 21.0)),
            grown_window: None,
            claims_trusted: true,
            probes_authenticated: Some(true),
        };
        let (upper, lower) = std::mem::take(&mut self.best);
        Event::Clock(Box::new(ClockSample {
            peer: self.hosts.1,
            peer_name: "cloud".parse().expect("a name"),
            at,
            window: self.window,
            max_drift_ppm: self.relation.settings().max_drift_ppm,
            upper,
            lower,
            offset: self.relation.offset(at_raw, at),
            probes: ProbeCounts { sent: 10, answered: 10, lost: 0, refused: 0 },
            exchanges: self.relation.counts(),
            round_trip: None,
            up: None,
            down: None,
            network: NetworkName::default(),
            // As a release before 0.3 sends it.
            basis: (self.clocks != RelatedClocks::Wall).then_some(basis),
        }))
    }

    /// A claim around the true offset of now, that far to each side.
    pub(super) fn offset_within(&self, micros_around: i64) -> Interval {
        let offset = self.cloud_stamp(self.now) - self.edge_stamp(self.now);
        let around = micros(-micros_around, micros_around);
        Interval { lo: offset + around.lo, hi: offset + around.hi }
    }
}

/// A message and its answer.
struct Passage {
    stamps: Exchange,
    /// The four moments by the wall clocks: left, arrived, answered, back.
    wall: [WallTime; 4],
    /// The true delays: up, down.
    delays: (Span, Span),
}

/// The delays of an iteration as it was judged.
pub(super) fn delays(iteration: &Iteration) -> [OneWayDelay; 2] {
    ["upload", "download"].map(|stage| {
        let (_, node) = iteration.tree.find(&[stage]).expect("measured");
        match &node.measure {
            Measure::Transit(transit) => transit.delay.expect("judged"),
            other => panic!("{other:?}"),
        }
    })
}
