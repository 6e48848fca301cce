//! Test of simultaneous faults: agents and aggregator are killed while disks fill up, become read-only and are
//! remounted, and clocks jump.

use std::path::PathBuf;
use std::time::Duration;

use peernet_clock::Span;
use peernet_tests::fleet::{agent_configuration_in, echo_pipeline, rate_load};
use peernet_tests::{
    Fleet, ImageDisk, Stopwatch, StoredRun, TestRng, record_measurements, thousands, wait_until,
};

use super::{setting, wait_for_turn};

const AGENTS: [&str; 2] = ["left", "right"];
const HZ: f64 = 200.0;

/// Longest pause between two faults or kills.
const MAX_PAUSE: Duration = Duration::from_millis(700);

/// Largest jump of a clock.
const MAX_JUMP: Span = Span::from_seconds(40 * 86_400);

/// Fault of a machine, which lasts until it is repaired.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    /// The aggregator's disk is full.
    StoreFull,
    /// The agents' disk is full.
    SpoolsFull,
    /// The database cannot be written.
    StoreReadOnly,
    /// The spool of an agent cannot be written.
    SpoolReadOnly(usize),
    /// The aggregator's disk is not mounted.
    StoreUnmounted,
    /// The clock of the aggregator jumps.
    AggregatorClock,
    /// The clock of an agent jumps.
    AgentClock(usize),
}

struct Storm {
    fleet: Fleet,
    store: ImageDisk,
    spools: ImageDisk,
    faults: Vec<Fault>,
    /// Number of answers in the logs of each agent's ended processes.
    answers: [u64; AGENTS.len()],
    /// Number of kills of each agent.
    agent_kills: [u64; AGENTS.len()],
    /// Number of kills of the aggregator.
    aggregator_kills: u64,
    /// Number of starts that failed because of a fault.
    failed_starts: u32,
}

impl Storm {
    fn new() -> Self {
        let (store, spools) = (ImageDisk::new(512 << 20), ImageDisk::new(128 << 20));
        let state = spools.folder().join("NAME").display().to_string();
        let pipeline = echo_pipeline("loop", &format!("{}\nactuator = {{ kind = \"log\" }}", rate_load(HZ)));
        let database = store.folder().join("aggregator.sqlite").display().to_string();
        let mut fleet =
            Fleet::with_database(&database, &AGENTS, &agent_configuration_in(&state, "", &pipeline));
        fleet.aggregator.stop();
        let Fleet { deployment, aggregator, agents, .. } = &mut fleet;
        for daemon in agents.iter_mut().chain([aggregator]) {
            daemon.show_time(deployment, Span::ZERO);
        }
        fleet.restart_aggregator();
        fleet.start_all();
        // An agent creates its host id at its first start, and cannot start if there is no space for that.
        for agent in 0..AGENTS.len() {
            fleet.wait_for_counts(agent, "the agent is known", |counts| counts.produced > 0);
        }
        let (answers, agent_kills) = ([0; AGENTS.len()], [0; AGENTS.len()]);
        Self {
            fleet,
            store,
            spools,
            faults: Vec::new(),
            answers,
            agent_kills,
            aggregator_kills: 0,
            failed_starts: 0,
        }
    }

    /// Returns the files of the database or of a spool that processes write with system calls. The third file is
    /// mapped into memory, and the kernel ends a process that writes to a mapping of an immutable file.
    fn files(&self, fault: Fault) -> Vec<PathBuf> {
        let main = match fault {
            Fault::SpoolReadOnly(agent) => {
                self.spools.folder().join(&self.fleet.agents[agent].name).join("spool.sqlite")
            }
            _ => self.fleet.database().to_owned(),
        };
        vec![main.clone(), format!("{}-wal", main.display()).into()]
    }

    fn inject(&mut self, fault: Fault, rng: &mut TestRng) {
        let jump = Span::from_seconds(rng.below(2 * MAX_JUMP.seconds() as usize) as i64) - MAX_JUMP;
        match fault {
            Fault::StoreFull => self.store.fill(),
            Fault::SpoolsFull => self.spools.fill(),
            Fault::StoreReadOnly => self.store.set_immutable(&self.files(fault), true),
            Fault::SpoolReadOnly(_) => self.spools.set_immutable(&self.files(fault), true),
            Fault::StoreUnmounted => self.store.unmount(),
            Fault::AggregatorClock => self.fleet.aggregator.show_time(&self.fleet.deployment, jump),
            Fault::AgentClock(agent) => self.fleet.agents[agent].show_time(&self.fleet.deployment, jump),
        }
        self.faults.push(fault);
    }

    /// Repairs everything but clocks.
    fn repair(&mut self) {
        for fault in std::mem::take(&mut self.faults) {
            match fault {
                Fault::StoreFull => self.store.free(),
                Fault::SpoolsFull => self.spools.free(),
                Fault::StoreReadOnly => self.store.set_immutable(&self.files(fault), false),
                Fault::SpoolReadOnly(_) => self.spools.set_immutable(&self.files(fault), false),
                Fault::StoreUnmounted => {
                    // Two mounts of one image would overwrite each other.
                    wait_until("the device is free", || (!self.store.is_in_use()).then_some(()));
                    self.store.mount();
                }
                Fault::AggregatorClock | Fault::AgentClock(_) => {}
            }
        }
    }

    /// Chooses faults that can exist at the same time.
    fn choose_faults(rng: &mut TestRng) -> Vec<Fault> {
        let agent = rng.below(AGENTS.len());
        let store = [Fault::StoreFull, Fault::StoreReadOnly, Fault::StoreUnmounted, Fault::AggregatorClock];
        let spool = [Fault::SpoolsFull, Fault::SpoolReadOnly(agent), Fault::AgentClock(agent)];
        let (store, spool) = (store[rng.below(store.len())], spool[rng.below(spool.len())]);
        match rng.below(4) {
            0 => vec![store],
            1 => vec![spool],
            2 => vec![store, spool],
            _ => vec![spool, store],
        }
    }

    /// Causes faults, a kill during them, and a restart during or after them.
    fn inject_and_repair(&mut self, rng: &mut TestRng) {
        for fault in Self::choose_faults(rng) {
            self.inject(fault, rng);
            rng.sleep_up_to(MAX_PAUSE);
        }
        let (agent, choice) = (rng.below(AGENTS.len()), rng.below(5));
        let (kills_aggregator, kills_agent) = (choice < 2, choice > 0);
        if kills_aggregator {
            self.fleet.aggregator.kill();
            self.aggregator_kills += 1;
        }
        if kills_agent {
            self.answers[agent] += count_answers(&self.fleet.agents[agent].kill().log);
            self.agent_kills[agent] += 1;
        }
        rng.sleep_up_to(MAX_PAUSE);
        // An aggregator that is started without its disk creates a database in the mount point's folder.
        let needs_disk = kills_aggregator && self.faults.contains(&Fault::StoreUnmounted);
        if needs_disk || rng.once_in(2) {
            self.repair();
        }
        if kills_agent {
            self.fleet.start(agent);
        }
        if kills_aggregator {
            self.fleet.aggregator.start(&self.fleet.deployment);
        }
        rng.sleep_up_to(MAX_PAUSE);
        self.repair();
        let Fleet { deployment, aggregator, agents, .. } = &mut self.fleet;
        for daemon in agents.iter_mut().chain([aggregator]) {
            // A start during a fault may have failed. Everything is repaired now, so the second start succeeds.
            self.failed_starts += u32::from(daemon.restart_if_start_failed(deployment));
        }
        rng.sleep_up_to(MAX_PAUSE);
    }
}

/// Returns the number of iterations whose answer was acted on.
fn count_answers(log: &str) -> u64 {
    log.matches(" answer ").count() as u64
}

#[test]
#[ignore = "takes minutes with PEERNET_KILLS=200; for make soak"]
fn kills_disk_and_clock_faults_lose_nothing_uncounted() {
    let _turn = wait_for_turn();
    let (mut rng, stopwatch) = (TestRng::new("storm"), Stopwatch::start());
    let mut storm = Storm::new();
    let kills = setting("PEERNET_KILLS", 6);
    while storm.agent_kills.iter().sum::<u64>() + storm.aggregator_kills < kills {
        storm.inject_and_repair(&mut rng);
    }
    let Storm { mut fleet, mut answers, agent_kills, aggregator_kills, failed_starts, .. } = storm;
    let Fleet { deployment, aggregator, agents, .. } = &mut fleet;
    for daemon in agents.iter_mut().chain([aggregator]) {
        daemon.show_time(deployment, Span::ZERO);
    }
    let mut counts_of_agents = Vec::new();
    for (agent, answers) in answers.iter_mut().enumerate() {
        *answers += count_answers(&fleet.agents[agent].stop().log);
        counts_of_agents.push(fleet.deliver_spool(agent));
    }
    let stored_events = fleet.stop();
    for (index, (agent, counts)) in fleet.agents.iter().zip(&counts_of_agents).enumerate() {
        counts.assert_balanced();
        let host = &stored_events.hosts[&agent.name];
        assert_eq!(
            stored_events.count_missing(agent.spooled_iterations()),
            0,
            "what was spooled is stored: {counts:?}, {host:?}"
        );
        assert_eq!(host.quarantined, 0, "{counts:?}, {host:?}");
        // Every event is accounted for by the agents' counts.
        assert_eq!((counts.waiting, counts.dropped), (0, host.missing), "{counts:?}, {host:?}");
        assert_eq!(counts.produced, host.events + host.missing, "{counts:?}, {host:?}");
        // The logged answers are accounted for as well. A kill may hit an iteration after its action and before its end.
        let runs = stored_events.runs.values().filter(|run| run.host == agent.name);
        let accounted = runs.map(StoredRun::iterations).sum::<u64>() + host.missing;
        let (answers, kills) = (answers[index], agent_kills[index]);
        assert!(answers > 0 && accounted + kills >= answers, "{answers} answers, {accounted} accounted for");
    }
    let missing: u64 = stored_events.hosts.values().map(|host| host.missing).sum();
    let number = |count: u64| thousands(count as f64);
    record_measurements(
        "kills amid failing disks and jumping clocks",
        &[
            ("kills of agents", number(agent_kills.iter().sum())),
            ("kills of the aggregator", number(aggregator_kills)),
            ("starts that failed until the fault was repaired", number(failed_starts.into())),
            ("answers in the logs", number(answers.iter().sum())),
            ("iterations stored", number(stored_events.iterations())),
            ("lost and reported", number(missing)),
            // The assertions above would fail otherwise.
            ("lost and not reported", number(0)),
            ("seconds", number(stopwatch.elapsed().as_secs())),
        ],
    );
}
