//! Plan of the sweep: the sizes and their order, as the configuration of an agent.

use std::path::Path;

use crate::exit::{Exit, Failure};
use anyhow::{Context, bail};
use peernet_agent::AgentConfig;
use peernet_networks::Address;
use peernet_sensors::SensorConfig;
use rand::SeedableRng;
use rand::rngs::StdRng;
use rand::seq::SliceRandom;
use serde_json::json;

use super::Arguments;
use crate::foreground::read_agent_tables;

/// Maximum number of shuffled rounds. A round contains each size once. After the last round the
/// order repeats. The number is large enough that size and time are not correlated.
const MAX_ROUNDS: u64 = 64;
/// Seed of the order. It is fixed, so that calibrations with equal sizes send them in the same order.
const SEED: u64 = 1;
/// Timeout of an answer in milliseconds: the largest payloads are slow over some links.
const TIMEOUT_MS: u64 = 60_000;
/// Timeout of connecting in milliseconds.
const OPEN_TIMEOUT_MS: u64 = 10_000;
/// Size limit of a message in bytes, unless a payload needs more.
const MIN_MESSAGE_LIMIT_BYTES: u64 = 64 << 20;
/// Maximum size of the parts of a message other than the payload, bytes.
const MAX_OVERHEAD_BYTES: u64 = 1 << 20;

/// Plan of a sweep.
pub(super) struct Plan {
    sizes: Vec<u64>,
    /// Address of the peer.
    pub(super) peer: Address,
    /// Sizes in the order in which they are sent; the order repeats.
    order: Vec<u64>,
    warm_up: u64,
    /// Number of iterations without the warm-up.
    pub(super) iterations: u64,
    /// Time limit, seconds.
    pub(super) seconds: f64,
    pipeline: serde_json::Value,
}

impl Plan {
    /// Makes the plan.
    ///
    /// # Errors
    /// When there are fewer than three sizes, too few to fit a line, or the peer's address does not belong to the
    /// network of `--network`.
    pub(super) fn new(arguments: &Arguments) -> anyhow::Result<Self> {
        let mut sizes = arguments.sizes.clone();
        sizes.sort_unstable();
        sizes.dedup();
        if sizes.len() < 3 {
            bail!("--sizes needs at least three different sizes to fit a line");
        }
        let peer = arguments.peer_address()?;
        // Shuffled, because with sorted sizes a slow change of the link would look like an effect of the size.
        let mut random = StdRng::seed_from_u64(SEED);
        let rounds = arguments.repeats.get().saturating_add(arguments.warm_up).min(MAX_ROUNDS);
        let round = |_| {
            let mut round = sizes.clone();
            round.shuffle(&mut random);
            round
        };
        let order: Vec<u64> = (0..rounds).flat_map(round).collect();
        let per_round = sizes.len() as u64;
        let largest = sizes.last().copied().unwrap_or_default();
        let iterations = arguments.repeats.get().saturating_mul(per_round);
        let warm_up = arguments.warm_up.saturating_mul(per_round);
        let payloads = order.iter().map(|size| *size as usize).collect();
        let pipeline = json!({
            "name": "calibration",
            "sensor": SensorConfig::size_sweep(payloads),
            "placement": {
                "kind": "remote",
                "peer": peer,
                "model": "calibration",
                "session": {
                    "open_timeout_ms": OPEN_TIMEOUT_MS,
                    "max_message_bytes": MIN_MESSAGE_LIMIT_BYTES.max(largest + MAX_OVERHEAD_BYTES),
                },
            },
            "load": { "mode": "closed" },
            "timeout_ms": TIMEOUT_MS,
            "warm_up": { "iterations": warm_up },
            "limit": { "iterations": iterations, "duration_s": arguments.seconds },
        });
        Ok(Self { sizes, order, peer, warm_up, iterations, seconds: arguments.seconds, pipeline })
    }

    /// Returns the sizes, smallest first.
    pub(super) fn sizes(&self) -> &[u64] {
        &self.sizes
    }

    /// Returns the number of iterations, including the warm-up.
    pub(super) fn all_iterations(&self) -> u64 {
        self.iterations.saturating_add(self.warm_up)
    }

    /// Returns the payload of an iteration in bytes. `number` is counted from 1.
    pub(super) fn payload(&self, number: u64) -> u64 {
        let index = number.saturating_sub(1) % self.order.len() as u64;
        self.order[index as usize]
    }

    /// Makes the configuration of an agent for the sweep. The tables for clocks and probes are read from `file` if it
    /// is given.
    ///
    /// # Errors
    /// When the file cannot be read (exit code 66) or its tables are wrong (exit code 78).
    pub(super) fn agent(&self, file: Option<&Path>, state_dir: &Path) -> Result<AgentConfig, Failure> {
        let mut config = read_agent_tables(file)?;
        state_dir.clone_into(&mut config.agent.state_dir);
        let pipeline = serde_json::from_value(self.pipeline.clone()).context("cannot set up the sweep");
        config.pipelines = vec![pipeline.map_err(|error| Failure::new(Exit::Configuration, error))?];
        Ok(config)
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        arguments: Arguments,
    }

    fn plan(line: &str) -> anyhow::Result<Plan> {
        let words = std::iter::once("calibrate").chain(line.split_whitespace());
        Plan::new(&Line::try_parse_from(words).expect("a command line").arguments)
    }

    #[test]
    fn each_round_has_all_sizes_in_another_order() {
        let plan = plan("cloud --sizes 1kB,100,1MB,100,10kB --repeats 50 --warm-up 1").expect("four sizes");
        assert_eq!(
            (plan.sizes(), plan.iterations, plan.all_iterations()),
            (&[100, 1_000, 10_000, 1_000_000][..], 200, 204)
        );
        let rounds: Vec<Vec<u64>> = plan
            .order
            .chunks(4)
            .map(|round| {
                let mut round = round.to_vec();
                round.sort_unstable();
                round
            })
            .collect();
        assert!(rounds.len() == 51 && rounds.iter().all(|round| round == plan.sizes()));
        let first_sizes: std::collections::BTreeSet<u64> =
            plan.order.chunks(4).map(|round| round[0]).collect();
        assert_eq!(first_sizes.len(), 4, "each size comes first in some round");
        assert_eq!((plan.payload(1), plan.payload(205)), (plan.order[0], plan.order[0]));
    }

    #[test]
    fn fewer_than_three_different_sizes_are_refused() {
        assert!(plan("cloud --sizes 1,2,2").is_err());
    }
}
