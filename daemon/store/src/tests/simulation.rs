//! An edge and a cloud with clocks of their own, a network between them, and the relation that a real agent would keep:
//! what is stored was judged by the same code that judges it again.

use peernet_clock::{
    ClockIdentity, Discipline, Exchange, Interval, Judged, Learned, OneWayDelay, RawTime, Relation,
    RelationSettings, Span, WallTime, Witnessed,
};
use peernet_logger::{HostId, Measure, RunId, Transit};
use peernet_stream::{ClockSample, Event, Iteration, NetworkName, ProbeCounts};

use super::clocks::micros;
use super::generate::{self, Numbers};

/// Delays of data: the truth, give or take [`JITTER`].
const UP: Span = Span::from_millis(4);
const DOWN: Span = Span::from_micros(600);
const JITTER: Span = Span::from_micros(100);

/// Both hosts and their relation, as time goes on.
pub(super) struct Simulation {
    hosts: (HostId, HostId),
    numbers: Numbers,
    relation: Relation,
    /// True time since [`generate::at`]'s zero.
    now: Span,
    /// The cloud's clock minus true time, without its drift of 20 ppm, and the edge's.
    pub(super) cloud_ahead: Span,
    pub(super) edge_ahead: Span,
    epochs: (u32, u32),
    /// One way of a probe takes so long on top of 50 µs.
    pub(super) congestion: Span,
    /// Happens in the middle of a second.
    pub(super) halfway: Option<fn(&mut Self)>,
    best: (Option<Exchange>, Option<Exchange>),
    window: u64,
    /// The delays of each iteration as they really were: up, down.
    pub(super) truths: Vec<(Span, Span)>,
}

impl Simulation {
    pub(super) fn new(hosts: (HostId, HostId)) -> Self {
        let clock = |name| ClockIdentity::new("boot", name);
        let settings = RelationSettings { trust_time_daemons: true, ..RelationSettings::default() };
        Self {
            hosts,
            numbers: Numbers(11),
            relation: Relation::new(&clock("edge"), &clock("cloud"), settings),
            now: Span::ZERO,
            cloud_ahead: Span::from_millis(1_250),
            edge_ahead: Span::ZERO,
            epochs: (0, 0),
            congestion: Span::ZERO,
            halfway: None,
            best: (None, None),
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
            let (probe, _) = self.exchange((self.congestion, self.congestion), Span::from_micros(20));
            let learned = self.relation.learn(&self.witnessed(probe));
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
        let (stamps, truth) = self.exchange((UP, DOWN), Span::from_millis(10));
        self.truths.push(truth);
        let number = self.truths.len() as u64;
        let Judged { learned, up, down } = self.relation.judge(&self.witnessed(stamps));
        self.note(stamps, learned);
        let mut random = Numbers(number);
        let mut iteration = generate::iteration_at(run, number, self.hosts, started, &mut random);
        for (stage, sent, received, delay) in [
            ("upload", stamps.sent, stamps.received, up),
            ("download", stamps.replied, stamps.returned, down),
        ] {
            let (node, _) = iteration.tree.find(&[stage]).expect("measured");
            let transit = Transit {
                sent: wall(sent),
                received: Some(wall(received)),
                delay: Some(delay),
                raw_stamps: None,
            };
            *iteration.tree.measure_mut(node).expect("found") = Measure::Transit(Box::new(transit));
        }
        iteration
    }

    /// A message and its answer, with so much delay and some jitter each, and what that came to.
    fn exchange(&mut self, (up, down): (Span, Span), at_cloud: Span) -> (Exchange, (Span, Span)) {
        let base = Span::from_micros(50);
        let mut jitter = |of: Span| of + Span::from_nanos(self.numbers.between(0, JITTER.nanos()));
        let (up, down) = (jitter(up.max(base)), jitter(down.max(base)));
        let (arrived, left) = (self.now + up, self.now + up + at_cloud);
        let exchange = Exchange {
            sent: RawTime::of_wall(self.edge(self.now)),
            received: RawTime::of_wall(self.cloud(arrived)),
            replied: RawTime::of_wall(self.cloud(left)),
            returned: RawTime::of_wall(self.edge(left + down)),
            uncertainty: Span::from_nanos(2),
        };
        (exchange, (up, down))
    }

    fn witnessed(&self, exchange: Exchange) -> Witnessed {
        let (edge_epoch, cloud_epoch) = self.epochs;
        Witnessed {
            exchange,
            edge_elapsed: None,
            cloud_elapsed: None,
            edge_epoch,
            cloud_epoch: Some(cloud_epoch),
        }
    }

    fn edge(&self, truth: Span) -> WallTime {
        generate::at(0.0) + truth + self.edge_ahead
    }

    fn cloud(&self, truth: Span) -> WallTime {
        generate::at(0.0) + truth + self.cloud_ahead + Span::from_nanos(truth.nanos() / 50_000)
    }

    fn note(&mut self, exchange: Exchange, learned: Learned) {
        let window = (1 << 63) + u64::from(self.relation.counts().restarts);
        if window != self.window {
            (self.window, self.best) = (window, (None, None));
        }
        if let Learned::Refused(_) = learned {
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
        let at = self.edge(self.now);
        let (upper, lower) = std::mem::take(&mut self.best);
        Event::Clock(Box::new(ClockSample {
            peer: self.hosts.1,
            peer_name: "cloud".parse().expect("a name"),
            at,
            window: self.window,
            max_drift_ppm: self.relation.settings().max_drift_ppm,
            upper,
            lower,
            offset: self.relation.offset(RawTime::of_wall(at), at),
            probes: ProbeCounts { sent: 10, answered: 10, lost: 0 },
            exchanges: self.relation.counts(),
            round_trip: None,
            up: None,
            down: None,
            network: NetworkName::default(),
            basis: None,
        }))
    }

    /// A claim around the true offset of now, that far to each side.
    pub(super) fn offset_within(&self, micros_around: i64) -> Interval {
        let offset = self.cloud(self.now) - self.edge(self.now);
        let around = micros(-micros_around, micros_around);
        Interval { lo: offset + around.lo, hi: offset + around.hi }
    }
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

/// The wall clock's time that an exchange of wall clocks has.
fn wall(stamp: RawTime) -> WallTime {
    WallTime::from_unix_nanos(stamp.nanos())
}
