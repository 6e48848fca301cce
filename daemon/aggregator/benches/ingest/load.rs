//! The agents' messages: batches cut as agents cut them, with the times that their iterations would have at the target
//! rate.

use std::fmt;

use bytes::Bytes;
use peernet_clock::WallTime;
use peernet_logger::{HostId, RunId};
use peernet_stream::{
    BatchHead, ChainHash, Event, Hello, MAX_IN_FLIGHT_BATCHES, STREAM_VERSIONS, StreamId, batch_weight, codec,
};

use crate::generate;

/// Number of nodes of an iteration.
const NODES: u64 = 21;
/// Number of nodes at which agents cut a batch by default.
const BATCH_NODES: u64 = 8_192;
/// Number of bytes at which agents cut a batch by default.
pub(crate) const BATCH_BYTES: u64 = 128 * 1024;
/// Age at which agents cut a batch by default, seconds.
const BATCH_AGE_S: f64 = 0.2;
/// Upper bound of an iteration's size on the wire, bytes.
const ITERATION_BYTES: u64 = 540;

/// The number of agents and the load that each sends.
pub(crate) struct LoadPlan {
    pub(crate) agents: u64,
    /// Number of batches of each agent.
    pub(crate) batches_per_agent: u64,
    /// Number of iterations of each batch.
    pub(crate) iterations_per_batch: u64,
    /// Interval between two iterations of an agent, seconds.
    interval_s: f64,
}

/// The messages of one agent.
pub(crate) struct Load {
    pub(crate) hello: Hello,
    pub(crate) stream: StreamId,
    pub(crate) frames: Vec<Bytes>,
}

impl Load {
    /// Returns how many batches from index `from` on may be in flight together if the window has `window_bytes` bytes;
    /// at least one.
    pub(crate) fn max_in_flight(&self, from: usize, mut window_bytes: u64) -> usize {
        let waiting = self.frames[from..].iter().take(MAX_IN_FLIGHT_BATCHES);
        let fits = |frame: &Bytes| {
            let remaining = window_bytes.checked_sub(batch_weight(frame.len()));
            window_bytes = remaining.unwrap_or(0);
            remaining.is_some()
        };
        waiting.map(fits).take_while(|fits| *fits).count().max(1)
    }
}

impl LoadPlan {
    /// Plans about `nodes` nodes of all agents together. The target rate is 500,000 nodes/s, and 350,000 with 1,000
    /// agents or more.
    pub(crate) fn new(agents: u64, nodes: u64) -> Self {
        let target_rate = if agents >= 1_000 { 350_000.0 } else { 500_000.0 };
        let interval_s = NODES as f64 * agents as f64 / target_rate;
        let iterations_by_age = (BATCH_AGE_S / interval_s) as u64;
        let iterations_per_batch =
            iterations_by_age.clamp(1, (BATCH_NODES / NODES).min(BATCH_BYTES / ITERATION_BYTES));
        let batches_per_agent = nodes.div_ceil(agents * iterations_per_batch * NODES);
        Self { agents, batches_per_agent, iterations_per_batch, interval_s }
    }

    /// Number of nodes of all agents together.
    pub(crate) fn nodes(&self) -> u64 {
        self.agents * self.batches_per_agent * self.iterations_per_batch * NODES
    }

    /// Time in which the iterations of one batch are produced, seconds.
    pub(crate) fn batch_s(&self) -> f64 {
        self.iterations_per_batch as f64 * self.interval_s
    }

    /// Builds the messages of one agent, whose measuring begins at `start`.
    pub(crate) fn load(&self, agent: u64, start: WallTime) -> Load {
        let (host, stream, run) = (HostId::random(), StreamId::random(), RunId::random());
        let cloud = HostId::random();
        let mut random = generate::Numbers::new(agent);
        let (mut previous_chain, mut events_before) = (ChainHash::START, 0);
        let mut frames = Vec::new();
        let mut longest = 0;
        for number in 1..=self.batches_per_agent {
            let run_start = (number == 1).then(|| generate::run_started(run, "line", start));
            let numbers = (number - 1) * self.iterations_per_batch + 1..=number * self.iterations_per_batch;
            let iterations = numbers.map(|n| {
                let at = start + peernet_clock::Span::from_seconds_f64(n as f64 * self.interval_s);
                Event::Iteration(generate::iteration_at(run, n, (host, cloud), at, &mut random))
            });
            let events: Vec<Event> = run_start.into_iter().chain(iterations).collect();
            let body = generate::body(&events);
            let count = events.len() as u32;
            let chain = previous_chain.next(count, &body);
            let head = BatchHead {
                host,
                stream,
                process: 1,
                number,
                previous_chain,
                chain,
                events: count,
                events_before,
            };
            events_before = head.events_through();
            previous_chain = chain;
            longest = longest.max(body.len());
            let compress = false;
            frames.push(Bytes::from(codec::encode_batch(&head, &body, compress)));
        }
        // The first batch also contains the start of the run, for which 1,024 bytes are allowed.
        assert!(longest as u64 <= BATCH_BYTES + 1_024, "agents would cut a batch before {longest} bytes");
        let hello = Hello {
            protocol: STREAM_VERSIONS.oldest(),
            host: generate::host(host, &format!("agent-{agent}")),
            stream,
            previous_stream: None,
            first: 1,
            oldest: 1,
            chain_before_oldest: ChainHash::START,
            events_before_oldest: 0,
            events_before_first: Some(0),
            batch_bytes: BATCH_BYTES as u32,
            process: 1,
            extension: None,
        };
        Load { hello, stream, frames }
    }
}

impl fmt::Display for LoadPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { agents, batches_per_agent, iterations_per_batch, interval_s } = self;
        write!(
            f,
            "{agents} agents: {} nodes in {} batches of {} nodes, an iteration every {:.3} ms",
            self.nodes(),
            agents * batches_per_agent,
            iterations_per_batch * NODES,
            interval_s * 1e3
        )
    }
}
