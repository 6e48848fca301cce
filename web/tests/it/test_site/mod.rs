//! A simulated site: an agent of a camera for each pipeline, and an agent of a rack that serves models. All data passes
//! through the aggregator's socket, so that pages and API receive the same as in a real deployment.

mod agent;
mod backlog;
mod clocks;
mod episodes;
mod overloaded;
mod pipeline;
mod tree;

pub(crate) use agent::Agent;
pub(crate) use pipeline::{Clocks, TestPipeline};

use peernet_clock::{ClockIdentity, SharedClock, Span, WallTime};
use peernet_logger::{HostId, Name, RunId, stage};
use peernet_statistics::SplitMix64;
use peernet_stream::{
    Condition, EndReason, Event, ExperimentPosition, Gap, Grade, Hardware, HostDescription, HostMetrics,
    Incident, IncidentKind, Iteration, LiveUpdate, ModelMetrics, Outcome, PipelineLive, PipelineState,
    RunDescription, RunEnded, ToAggregator,
};

/// Number of iterations at the start of each run that are the warm-up.
pub(crate) const WARM_UP_ITERATIONS: u64 = 20;

/// The cameras' pipelines, and the rack that serves those of them that are remote.
pub(crate) struct TestSite {
    /// The pipelines, each on its own camera.
    pub(crate) pipelines: Vec<TestPipeline>,
    /// Agents of the cameras in the order of the pipelines, then the agent of the rack.
    pub(crate) agents: Vec<Agent>,
    /// Time since which the second agent catches up with a backlog and the third has a failing disk; `None` for agents
    /// without these problems.
    pub(crate) backlog: Option<WallTime>,
    clock: SharedClock,
    random: SplitMix64,
}

fn slug(name: &str) -> peernet_logger::Slug {
    name.parse().expect("a name")
}

/// Returns the description of a host.
pub(crate) fn host(name: &str, gpu: &str, clock: ClockIdentity) -> HostDescription {
    HostDescription {
        id: HostId::random(),
        name: slug(name),
        clock,
        version: "0.1.0".into(),
        hardware: Hardware {
            cpu: "ARM Cortex-A78AE".into(),
            cores: 8,
            memory_bytes: 16_000_000_000,
            gpus: vec![gpu.into()],
            system: "Debian GNU/Linux 12".into(),
            architecture: "aarch64".into(),
        },
        serves: (name == "rack-a").then(|| "tcp://192.0.2.5:5551".into()),
        models: if name == "rack-a" { vec![slug("quality-control")] } else { Vec::new() },
    }
}

impl TestSite {
    /// Connects all agents to an aggregator.
    pub(crate) async fn new(address: &str, clock: SharedClock, pipelines: Vec<TestPipeline>) -> Self {
        let mut agents = Vec::new();
        for pipeline in &pipelines {
            let identity = ClockIdentity::new(pipeline.host, "system");
            agents.push(
                Agent::new(host(pipeline.host, "NVIDIA Jetson Orin NX", identity), address, &clock).await,
            );
        }
        let rack = host("rack-a", "NVIDIA GeForce RTX 3090", clock.identity().clone());
        agents.push(Agent::new(rack, address, &clock).await);
        for agent in &mut agents {
            agent.wait_until_connected().await;
        }
        Self { pipelines, agents, backlog: None, clock, random: SplitMix64::new(7) }
    }

    fn rack_id(&self) -> HostId {
        self.agents.last().expect("there is a rack").id()
    }

    /// Stores a finished run of each pipeline with `iterations` iterations, the last of which ends now.
    pub(crate) async fn store_run_of_each_pipeline(&mut self, iterations: u64) {
        for index in 0..self.pipelines.len() {
            let run = RunId::random();
            let events = self.run(index, run, iterations, None);
            self.store_current_run(index, run, events).await;
        }
    }

    /// Stores a run of each pipeline with `iterations` iterations, whose end is not reported yet.
    pub(crate) async fn store_unfinished_run_of_each_pipeline(&mut self, iterations: u64) {
        for index in 0..self.pipelines.len() {
            let run = RunId::random();
            let mut events = self.run(index, run, iterations, None);
            // The last event is the end of the run.
            events.pop();
            self.store_current_run(index, run, events).await;
        }
    }

    /// Stores the events of a run, and makes it the current run of its pipeline.
    async fn store_current_run(&mut self, index: usize, run: RunId, events: Vec<Event>) {
        self.pipelines[index].run = Some(run);
        self.agents[index].offer(events);
        self.agents[index].wait_until_stored().await;
    }

    /// Stores an experiment with `repeats` runs of each pipeline.
    pub(crate) async fn store_experiment(&mut self, iterations: u64, repeats: u32) {
        let id = RunId::random().to_string();
        for repeat in 0..repeats {
            for index in 0..self.pipelines.len() {
                let pipeline = &self.pipelines[index];
                let place = if pipeline.is_remote { "cloud" } else { "on board" };
                let configuration = vec![
                    ("picture".to_owned(), pipeline.name.to_owned()),
                    ("where".to_owned(), place.to_owned()),
                ];
                let position = ExperimentPosition {
                    name: "pictures".to_owned(),
                    id: id.clone(),
                    configuration,
                    repeat,
                    ..ExperimentPosition::default()
                };
                self.store_at_position(index, iterations, position).await;
            }
        }
    }

    /// Stores an experiment with a run of one pipeline for each element of `sizes`: the sample size, and the index of
    /// the configuration in the experiment's file. The upload time is proportional to the size.
    pub(crate) async fn store_run_of_each_size(
        &mut self,
        index: usize,
        iterations: u64,
        sizes: &[(f64, Option<u32>)],
    ) {
        let (id, original) = (RunId::random().to_string(), self.pipelines[index].clone());
        for (bytes, configuration_index) in sizes {
            let pipeline = &mut self.pipelines[index];
            for (name, mean, _) in &mut pipeline.stages {
                if *name == stage::UPLOAD {
                    *mean *= bytes / pipeline.bytes;
                }
            }
            pipeline.bytes = *bytes;
            let configuration = vec![("size".to_owned(), format!("{} kB", bytes / 1e3))];
            let position = ExperimentPosition {
                name: "sizes".to_owned(),
                id: id.clone(),
                configuration,
                repeat: 0,
                configuration_index: *configuration_index,
                edges: None,
            };
            self.store_at_position(index, iterations, position).await;
        }
        self.pipelines[index] = original;
    }

    /// Stores an experiment with a configuration for each number of concurrent users. The first pipelines are the
    /// users. The more users there are, the longer they wait in the queue.
    pub(crate) async fn store_runs_with_users(&mut self, iterations: u64, numbers: &[usize]) {
        let (id, original) = (RunId::random().to_string(), self.pipelines.clone());
        for users in numbers {
            for (index, camera_pipeline) in original.iter().enumerate().take(*users) {
                // All users have equal pipelines, and wait for one another in the queue of the model.
                let pipeline = TestPipeline::resized();
                // Each of the other users occupies the model for one inference, 3.5 ms.
                let queue = |(name, mean, spread): &(Name, f64, f64)| {
                    let waits = if *name == stage::QUEUE { 3.5 * (*users as f64 - 1.0) } else { 0.0 };
                    (name.clone(), mean + waits, *spread)
                };
                self.pipelines[index] = TestPipeline {
                    stages: pipeline.stages.iter().map(queue).collect(),
                    name: camera_pipeline.name,
                    host: camera_pipeline.host,
                    ..pipeline
                };
                let configuration = vec![("Users".to_owned(), users.to_string())];
                let position = ExperimentPosition {
                    name: "users".to_owned(),
                    id: id.clone(),
                    configuration,
                    repeat: 0,
                    ..ExperimentPosition::default()
                };
                self.store_at_position(index, iterations, position).await;
            }
        }
        self.pipelines = original;
    }

    /// Stores an experiment of many configurations with long labels, and one run of each.
    pub(crate) async fn store_run_of_each_configuration(&mut self, iterations: u64, configurations: usize) {
        let id = RunId::random().to_string();
        for at in 0..configurations {
            let configuration = vec![
                (
                    "Model".to_owned(),
                    format!("efficientnet_v2_{}-quantised-int8-static", ["s", "m", "l"][at % 3]),
                ),
                ("Resize, then crop".to_owned(), format!("{} × {} px", 224 + at * 8, 224 + at * 8)),
                ("Network".to_owned(), ["zmq-tcp", "zmq-udp", "quic"][at / 3 % 3].to_owned()),
            ];
            let name = "every-model-at-every-size-over-every-network".to_owned();
            let position = ExperimentPosition {
                name,
                id: id.clone(),
                configuration,
                repeat: 0,
                ..ExperimentPosition::default()
            };
            self.store_at_position(at % self.pipelines.len(), iterations, position).await;
        }
    }

    /// Stores an experiment of one configuration on the first pipeline, with one run for each end reason.
    pub(crate) async fn store_run_with_each_end_reason(&mut self, iterations: u64, reasons: &[&str]) {
        let id = RunId::random().to_string();
        for reason in reasons {
            let configuration = vec![("rate".to_owned(), "20 Hz".to_owned())];
            let position = ExperimentPosition {
                name: "rates".to_owned(),
                id: id.clone(),
                configuration,
                repeat: 0,
                ..ExperimentPosition::default()
            };
            let mut events = self.run(0, RunId::random(), iterations, Some(position));
            for event in &mut events {
                if let Event::RunEnded(ended) = event {
                    ended.reason = (*reason).into();
                }
            }
            self.agents[0].offer(events);
            self.agents[0].wait_until_stored().await;
        }
    }

    /// Stores a run of a pipeline at a position in an experiment.
    async fn store_at_position(&mut self, index: usize, iterations: u64, position: ExperimentPosition) {
        let events = self.run(index, RunId::random(), iterations, Some(position));
        self.agents[index].offer(events);
        self.agents[index].wait_until_stored().await;
    }

    /// Returns the events of a run that ends now. The first [`WARM_UP_ITERATIONS`] iterations are the warm-up. The last
    /// event is the end of the run.
    fn run(
        &mut self,
        index: usize,
        run: RunId,
        iterations: u64,
        experiment: Option<ExperimentPosition>,
    ) -> Vec<Event> {
        let (edge, rack) = (self.agents[index].id(), self.rack_id());
        let pipeline = &self.pipelines[index];
        let step = Span::from_seconds_f64(1.0 / pipeline.hz);
        let now = self.clock.wall();
        let started = now - Span::from_seconds_f64(iterations as f64 / pipeline.hz);
        // Only runs of experiments have a doubtful condition, so that pages are tested with it and without it.
        let has_slow_governor = experiment.is_some();
        let mut events = vec![Event::RunStarted(RunDescription {
            run,
            pipeline: slug(pipeline.name),
            started,
            placement: pipeline.placement(),
            facts: pipeline.facts(),
            configuration: pipeline.configuration(),
            version: "0.1.0".into(),
            conditions: conditions(pipeline.host, has_slow_governor),
            experiment: experiment.map(Box::new),
        })];
        let mut at = started;
        for number in 1..=iterations {
            // Of every 4,001 iterations, one is lost and one times out.
            let outcome = match number {
                n if n % 4_001 == 900 => Outcome::Lost("the connection to rack-a closed".into()),
                n if n % 4_001 == 1_700 => Outcome::Timeout(String::new()),
                _ => Outcome::Ok,
            };
            let stages = pipeline.draw(&mut self.random, number as f64 / iterations as f64);
            let tree = tree::build_tree(pipeline, &stages, (edge, rack), at, outcome == Outcome::Ok);
            let warm_up = number <= WARM_UP_ITERATIONS;
            events.push(Event::Iteration(Iteration {
                run,
                number,
                episode: ((number - 1) / 1_000) as u32,
                step: ((number - 1) % 1_000) as u32,
                warm_up,
                outcome,
                tree,
            }));
            at = at + step;
        }
        events.push(Event::RunEnded(RunEnded { run, ended: at, reason: EndReason::Finished }));
        events
    }

    /// Stores the clock samples of the edges for the last `seconds`.
    pub(crate) async fn store_clocks(&mut self, seconds: i64) {
        let (rack, now) = (self.rack_id(), self.clock.wall());
        for index in (0..self.pipelines.len()).filter(|index| self.pipelines[*index].is_remote) {
            let pipeline = &self.pipelines[index];
            let samples = (0..seconds).rev().map(|ago| {
                let at = now - Span::from_seconds(ago);
                Event::Clock(Box::new(clocks::sample(pipeline, rack, at, ago, &mut self.random)))
            });
            let samples: Vec<Event> = samples.collect();
            self.agents[index].offer(samples);
            self.agents[index].wait_until_stored().await;
        }
    }

    /// Reports a few incidents.
    pub(crate) async fn store_incidents(&mut self) {
        let now = self.clock.wall();
        let incidents = [
            (0, 400, IncidentKind::ModelLoaded, "loaded quality-control (ONNX Runtime 1.31, cpu, 1.9 s)"),
            (1, 380, IncidentKind::Connected, "reconnected to rack-a after 0.4 s; 0 lost"),
            (1, 95, IncidentKind::Disconnected, "lost rack-a: connection reset by peer"),
            (2, 60, IncidentKind::ClockStep, "the wall clock was stepped by +18.2 ms"),
        ];
        for (pipeline, ago, kind, text) in incidents {
            let index = pipeline % self.pipelines.len();
            let at = now - Span::from_seconds(ago);
            let incident = Incident { at, kind, pipeline: None, run: None, peer: None, text: text.into() };
            self.agents[index].offer([Event::Incident(incident)]);
            self.agents[index].wait_until_stored().await;
        }
    }

    /// Stores `count` gaps of the newest run of a pipeline, ten seconds apart, 974 events in each.
    pub(crate) async fn store_gaps(&mut self, index: usize, count: i64) {
        let pipeline = &self.pipelines[index];
        let now = self.clock.wall();
        let gaps = (1..=count).rev().map(|ago| Gap {
            pipeline: Some(slug(pipeline.name)),
            run: pipeline.run,
            from: now - Span::from_seconds(10 * ago),
            to: now - Span::from_seconds(10 * ago - 3),
            count: 974,
            reason: "no room in the agent's spool".to_owned(),
        });
        self.agents[index].offer(gaps.map(Event::Gap).collect::<Vec<_>>());
        self.agents[index].wait_until_stored().await;
    }

    /// Reports the seconds from `from` to `to` of all pipelines. The last second may be incomplete.
    pub(crate) async fn report(&mut self, from: WallTime, to: WallTime) {
        let seconds: Vec<i64> = (from.unix_seconds()..=to.unix_seconds()).collect();
        // The pipelines take turns of 20 seconds, so that none is far ahead of the others.
        for chunk in seconds.chunks(20) {
            for index in 0..self.pipelines.len() {
                let pipeline = &self.pipelines[index];
                // An update has the newest second first.
                let seconds = chunk.iter().filter(|at| !pipeline.is_silent(to.unix_seconds() - **at)).rev();
                let seconds = seconds.map(|at| pipeline.second(*at, to, &mut self.random)).collect();
                let pipeline = PipelineLive {
                    pipeline: slug(pipeline.name),
                    state: PipelineState::Running,
                    run: pipeline.run,
                    placement: pipeline.placement(),
                    load: format!("{} Hz", pipeline.hz),
                    seconds,
                };
                let load = 0.3 + 0.1 * index as f64;
                self.report_second(index, vec![pipeline], chunk.first().copied(), load, to).await;
                // An update holds only one second of a link, so each of the other seconds is sent in an update of its
                // own.
                let others = if self.pipelines[index].is_remote { &chunk[1..] } else { &[] };
                for at in others {
                    self.report_second(index, Vec::new(), Some(*at), load, to).await;
                }
            }
            let rack = self.agents.len() - 1;
            self.report_second(rack, Vec::new(), None, 0.12, to).await;
        }
    }

    /// Sends one live update of an agent: the seconds of its pipelines, and the clock sample of its link for the second
    /// `second`.
    async fn report_second(
        &mut self,
        index: usize,
        pipelines: Vec<PipelineLive>,
        second: Option<i64>,
        load: f64,
        sent: WallTime,
    ) {
        let rack = self.rack_id();
        let pipeline = self.pipelines.get(index).filter(|pipeline| pipeline.is_remote);
        let link = pipeline.zip(second).map(|(pipeline, second)| {
            let at = WallTime::from_unix_nanos(second * 1_000_000_000);
            let ago = sent.unix_seconds() - second;
            clocks::live(pipeline, clocks::sample(pipeline, rack, at, ago, &mut self.random))
        });
        let has_clock_fault = self.pipelines.get(index).is_some_and(|pipeline| pipeline.has_clock_fault);
        let clock = clocks::host_clock(has_clock_fault, sent);
        let mut vary = |size: f64| size * (1.0 + 0.1 * self.random.normal());
        let metrics = HostMetrics {
            cpu: Some(vary(load).clamp(0.0, 1.0)),
            memory_used_bytes: Some(4_300_000_000 + index as u64 * 700_000_000),
            gpu: Some(vary(0.7 - load).clamp(0.0, 1.0)),
            temperature_celsius: Some(54.0 + vary(3.0)),
            power_watts: Some(vary(10.0)),
            agent_cpu: Some(0.013),
            agent_memory_bytes: Some(31_000_000),
            models: Some(ModelMetrics { loaded: 1, memory_bytes: 96_000_000 }),
        };
        let agent = &mut self.agents[index];
        let update = LiveUpdate {
            host: agent.id(),
            sent,
            pipelines,
            links: link.into_iter().collect(),
            clock,
            metrics,
            accounting: backlog::add_backlog(agent.accounting(), index, self.backlog, sent),
        };
        agent.send_message(&ToAggregator::Live(update)).await;
    }
}

/// Returns the conditions of an edge. If `has_slow_governor` is true, its CPU governor is not `performance`.
fn conditions(host: &str, has_slow_governor: bool) -> Vec<Condition> {
    let found = |about: &str, found: &str, grade, advice: &str| Condition {
        host: host.to_owned(),
        about: about.to_owned(),
        found: found.to_owned(),
        grade,
        advice: advice.to_owned(),
    };
    let governor = if has_slow_governor {
        let advice = "set it to `performance` for the measurement";
        found("CPU governor", "schedutil: the frequency follows the load", Grade::Doubtful, advice)
    } else {
        found("CPU governor", "performance", Grade::Good, "")
    };
    vec![
        governor,
        found("thermal throttling", "none, neither now nor since the host was started", Grade::Good, ""),
        found("Wi-Fi power save", "cannot be found out of wlan0: `iw` is missing", Grade::Unknown, ""),
    ]
}
