//! Tests with clocks that fulfil the assumptions of the intervals, and with clocks that violate them.
//!
//! A preloaded library, the shim, replaces the clock readings of the programs of both hosts. Each case defines from when
//! on an assumption is violated. For one [`WINDOW`] after that, intervals may be wrong; later, each interval with the
//! verdict `ok` or `limited` must contain the truth. No delay with the verdict `inconsistent` has a value or bounds.

mod outcome;
mod paused;
mod violated;
mod within_limits;

use std::path::Path;

use outcome::Outcome;
use peernet_clock::{RawTime, Span};
use peernet_tests::network::{Network, WireProperties};
use peernet_tests::truth::HostClock;
use peernet_tests::{ClockShim, Process, TwoHostTestbed, wait_until, wait_until_grown};

use super::CONSTANT_DRIFT;

/// Default of the key `window_s`: largest distance in time from an exchange to a delay that it bounds. After a
/// violation an interval may be wrong for this time.
const WINDOW: Span = Span::from_seconds(10);

const fn wire_direction(delay_ms: u32, jitter_ms: u32, loss_percent: u32) -> WireProperties {
    WireProperties { delay_ms, jitter_ms, loss_percent }
}

fn direct_network(_: &Path) -> Network {
    Network::direct()
}

fn wire_network(up: WireProperties, down: WireProperties) -> impl FnOnce(&Path) -> Network {
    move |folder| Network::wire(folder, up, down)
}

/// Table of a host whose clock readings the shim replaces. The agent uses neither the kernel's receive stamps nor its
/// statements about the wall clock, because both describe the kernel's own clocks.
const CLOCK: &str = "[clock]\ntimestamps = \"user\"\ndiscipline = []\n";

/// Load of a pipeline with a steady rate, which runs until its host is stopped.
const LOAD: &str = "load = { mode = \"rate\", hz = 50.0 }\nmax_in_flight = 64\ntimeout_ms = 5000";

/// Two hosts whose clock readings the shim replaces, and a pipeline that runs until the edge is stopped.
struct ClockTestbed {
    /// Description of the case. `2/6 ms` are the delays of the path up and down.
    case: &'static str,
    edge: Process,
    cloud: Option<Process>,
    /// The shims of the edge and of the cloud.
    shims: [ClockShim; 2],
    hosts: TwoHostTestbed,
}

impl ClockTestbed {
    /// Starts the hosts. `keys` are additional keys of the edge's table `[clock]`; `prepare` sets the clocks of edge
    /// and cloud before they start.
    fn new(
        case: &'static str,
        network: impl FnOnce(&Path) -> Network,
        keys: &str,
        prepare: impl FnOnce([&ClockShim; 2]),
    ) -> Self {
        let hosts = TwoHostTestbed::new(network);
        let shims =
            ["edge", "cloud"].map(|host| ClockShim::new(&hosts.folder().join(format!("{host}-clocks"))));
        let [edge, cloud] = &shims;
        prepare([edge, cloud]);
        let cloud = start_cloud(&hosts, cloud);
        // Both hosts are on one machine: without an identity of its own the edge's clock would count as the cloud's.
        let pipeline = hosts.pipeline("misled", 1000, LOAD);
        let tables = format!("clock_identity = \"edge\"\n{CLOCK}{keys}\n{pipeline}");
        let edge = hosts.start_edge(&tables, &edge.environment());
        Self { case, edge, cloud: Some(cloud), shims, hosts }
    }

    /// Returns the edge's shim.
    const fn shim(&self) -> &ClockShim {
        &self.shims[0]
    }

    /// Returns the cloud's process.
    fn cloud(&self) -> &Process {
        self.cloud.as_ref().expect("the cloud runs")
    }

    /// Kills the cloud and starts it again with other clock readings, as after a reboot.
    fn reboot_cloud(&mut self, step: Span, ppm: f64) {
        let [_, shim] = &self.shims;
        self.cloud.take().expect("the cloud runs").kill();
        let begin = shim.schedule_change(step, ppm, CONSTANT_DRIFT);
        wait_until("the cloud's clocks after its reboot", || (shim.now() > begin).then_some(()));
        self.cloud = Some(start_cloud(&self.hosts, shim));
    }

    /// Returns the arrival of the newest stored upload, by the kernel's clock; `None` if no upload is stored.
    fn newest_stored_arrival(&self) -> Option<RawTime> {
        let sql = "SELECT t.received_raw_ns FROM transit AS t JOIN node USING (run, iteration, node) \
                   JOIN name ON name.id = node.name WHERE name.text = 'upload' AND t.received_raw_ns IS NOT NULL \
                   ORDER BY t.run DESC, t.iteration DESC LIMIT 1";
        let shown = RawTime::from_nanos(self.hosts.query_database(sql).trim().parse().ok()?);
        // A clock that was set back showed some times twice. The newest upload arrived at the last of these times.
        self.shims[1].errors().truths(shown).last().copied()
    }

    /// Waits until all uploads that arrived before a time are stored.
    fn wait_until_stored_to(&self, time: RawTime) {
        wait_until_grown(self.case, time.nanos().unsigned_abs(), || {
            Some(self.newest_stored_arrival()?.nanos().unsigned_abs())
        });
    }

    /// Waits until all uploads of eleven seconds are stored, so that the window is full. Returns the end of these seconds.
    fn wait_for_full_window(&self) -> RawTime {
        let settled =
            wait_until("the first upload", || self.newest_stored_arrival()) + WINDOW + Span::from_seconds(1);
        self.wait_until_stored_to(settled);
        settled
    }

    /// Stops the edge and returns the stored delays.
    fn end(self) -> Outcome {
        assert_eq!(self.edge.stop().code(), 0);
        self.hosts.api.wait_until("/api/v1/runs", |runs| {
            let mut runs = runs["runs"].as_array()?.iter();
            runs.all(|run| run["reason"] == "stopped").then_some(())
        });
        let incidents = self.hosts.api.json("/api/v1/incidents").to_string();
        let [edge, cloud] = self.shims.map(|shim| HostClock::with_shim_errors(shim.errors()));
        Outcome::new(self.case, &self.hosts.iterations(), [&edge, &cloud], incidents)
    }
}

fn start_cloud(hosts: &TwoHostTestbed, shim: &ClockShim) -> Process {
    let cloud = hosts.start_cloud_with(CLOCK, &shim.environment());
    cloud.wait_for("ready");
    cloud
}
