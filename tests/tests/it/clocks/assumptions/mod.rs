//! Clocks that keep what the intervals rest on, and clocks that do not: what is reported, and for how long it is wrong.
//!
//! The clocks of both hosts are shown by a library that the programs know nothing of. Each case says when an assumption begins to be
//! violated, and no interval with the verdict `ok` or `limited` may miss the truth later than a window after that. Nothing has a value or
//! bounds that is `inconsistent`.

mod kept;
mod outcome;
mod paused;
mod violated;

use std::path::Path;

use outcome::Outcome;
use peernet_clock::{RawTime, Span};
use peernet_tests::network::{Network, Way};
use peernet_tests::truth::HostClock;
use peernet_tests::{ClockShim, Plant, Process, until, until_grown};

/// Length of the window by default: for so long after a violation an interval may be wrong.
const WINDOW: Span = Span::from_seconds(10);

const fn way(delay_ms: u32, jitter_ms: u32, loss_percent: u32) -> Way {
    Way { delay_ms, jitter_ms, loss_percent }
}

fn cable(_: &Path) -> Network {
    Network::direct()
}

fn wire(up: Way, down: Way) -> impl FnOnce(&Path) -> Network {
    move |folder| Network::wire(folder, up, down)
}

/// The table of a host whose clocks are shown by the shim: the kernel's word on its clock is not about those.
const CLOCK: &str = "[clock]\ntimestamps = \"user\"\ndiscipline = []\n";

/// A pipeline that is steady and goes on until its host is stopped.
const LOAD: &str = "load = { mode = \"rate\", hz = 50.0 }\nmax_in_flight = 64\ntimeout_ms = 5000";

/// Two hosts whose clocks are shown by the shim, and a pipeline that goes on until the edge is stopped.
struct Scene {
    what: &'static str,
    edge: Process,
    cloud: Option<Process>,
    /// The edge's clocks and the cloud's.
    shims: [ClockShim; 2],
    plant: Plant,
}

impl Scene {
    /// `keys` are further ones of the edge's table `[clock]`; `prepare` sets the clocks of edge and cloud before they start.
    fn new(
        what: &'static str,
        network: impl FnOnce(&Path) -> Network,
        keys: &str,
        prepare: impl FnOnce([&ClockShim; 2]),
    ) -> Self {
        let plant = Plant::new(network);
        let shims =
            ["edge", "cloud"].map(|host| ClockShim::new(&plant.folder().join(format!("{host}-clocks"))));
        let [edge, cloud] = &shims;
        prepare([edge, cloud]);
        let cloud = start_cloud(&plant, cloud);
        // Both hosts are on one machine: without an identity of its own the edge's clock would be the cloud's.
        let pipeline = plant.pipeline("misled", 1000, LOAD);
        let tables = format!("clock_identity = \"shown\"\n{CLOCK}{keys}\n{pipeline}");
        let edge = plant.edge(&tables, &edge.environment());
        Self { what, edge, cloud: Some(cloud), shims, plant }
    }

    /// The edge's clocks.
    const fn shim(&self) -> &ClockShim {
        &self.shims[0]
    }

    /// The cloud's process.
    fn cloud(&self) -> &Process {
        self.cloud.as_ref().expect("it runs")
    }

    /// Kills the cloud and starts it again as after a reboot: its clocks show something else.
    fn reboot_cloud(&mut self, step: Span, ppm: f64) {
        let [_, shim] = &self.shims;
        self.cloud.take().expect("it runs").kill();
        let begin = shim.change(step, ppm, 0.0);
        until("the cloud's clocks after its reboot", || (shim.now() > begin).then_some(()));
        self.cloud = Some(start_cloud(&self.plant, shim));
    }

    /// When the newest stored upload arrived, by the kernel's clock; `None` before there is one.
    fn stored_until(&self) -> Option<RawTime> {
        let sql = "SELECT t.received_raw_ns FROM transit AS t JOIN node USING (run, iteration, node) \
                   JOIN name ON name.id = node.name WHERE name.text = 'upload' AND t.received_raw_ns IS NOT NULL \
                   ORDER BY t.run DESC, t.iteration DESC LIMIT 1";
        let shown = RawTime::from_nanos(self.plant.ask(sql).trim().parse().ok()?);
        self.shims[1].errors().truths(shown).last().copied()
    }

    /// Waits until what arrived at a time is stored.
    fn reach(&self, time: RawTime) {
        until_grown(self.what, time.nanos().unsigned_abs(), || {
            Some(self.stored_until()?.nanos().unsigned_abs())
        });
    }

    /// Waits until the window is full: ten seconds and a little are stored. Returns when that was.
    fn settle(&self) -> RawTime {
        let settled = until("the first upload", || self.stored_until()) + WINDOW + Span::from_seconds(1);
        self.reach(settled);
        settled
    }

    /// Stops the edge and returns what is stored.
    fn end(self) -> Outcome {
        assert_eq!(self.edge.stop().code(), 0);
        self.plant.api.until("/api/v1/runs", |runs| {
            let mut runs = runs["runs"].as_array()?.iter();
            runs.all(|run| run["reason"] == "stopped").then_some(())
        });
        let incidents = self.plant.api.json("/api/v1/incidents").to_string();
        let [edge, cloud] = self.shims.map(|shim| HostClock::shown(shim.errors()));
        Outcome::new(self.what, &self.plant.iterations(), [&edge, &cloud], incidents)
    }
}

fn start_cloud(plant: &Plant, shim: &ClockShim) -> Process {
    let cloud = plant.cloud_with(CLOCK, &shim.environment());
    cloud.wait_for("ready");
    cloud
}
