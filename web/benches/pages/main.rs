//! Benchmark of whole pages and API resources on a large database, from the request to the compressed answer: a run
//! with a million recorded tree nodes is compared with a run with the given number of nodes. The aggregator receives both runs
//! over ZeroMQ.
//!
//! `cargo bench -p peernet-web --bench pages -- [NODES] [FOLDER]`: by default 100 million nodes, which
//! take some minutes and about 6 GB. With `FOLDER`, the databases are kept there and used again by
//! later runs.

#![expect(clippy::print_stdout, reason = "a benchmark prints its table")]

#[path = "../../../daemon/aggregator/tests/it/clocks.rs"]
#[expect(unreachable_pub, dead_code, reason = "shared with the tests")]
mod clocks;
mod fill;
#[path = "../../../daemon/aggregator/tests/it/generate.rs"]
#[expect(unreachable_pub, dead_code, reason = "shared with the tests")]
mod generate;
mod requests;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use peernet_aggregator::{Aggregator, AggregatorConfig};
use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use peernet_web::{WebConfig, Zone};
use tokio_util::sync::CancellationToken;

use crate::requests::{ResponseTimes, measure};

/// Maximum number of nodes of the small run, which has at most half of the large run's nodes.
const MAX_SMALL_NODES: u64 = 1_000_000;

#[tokio::main]
async fn main() {
    let mut arguments = std::env::args().skip(1).filter(|argument| argument != "--bench");
    let nodes: u64 =
        arguments.next().map_or(MAX_SMALL_NODES * 100, |word| word.parse().expect("a number of nodes"));
    let scratch = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).expect("a folder");
    let folder = arguments.next().map_or_else(|| scratch.path().to_owned(), PathBuf::from);
    std::fs::create_dir_all(&folder).expect("a folder");
    let small_nodes = MAX_SMALL_NODES.min(nodes / 2);
    let small = measure_database(&folder, small_nodes).await;
    let large = measure_database(&folder, nodes).await;
    println!("\n| page | {small_nodes} nodes, median ms | max | {nodes} nodes, median ms | max | ratio |");
    println!("| --- | --- | --- | --- | --- | --- |");
    for (small_times, large_times) in small.iter().zip(&large) {
        println!(
            "| {} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} |",
            small_times.page,
            small_times.median_ms,
            small_times.max_ms,
            large_times.median_ms,
            large_times.max_ms,
            large_times.median_ms / small_times.median_ms
        );
    }
}

/// Measures all pages on a database of `nodes` nodes. Fills the database if it does not exist.
async fn measure_database(folder: &Path, nodes: u64) -> Vec<ResponseTimes> {
    let database = folder.join(format!("{nodes}.sqlite"));
    let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("bench", "pages")));
    if !database.exists() {
        let began = clock.mono();
        fill::fill(&database, nodes, &clock).await;
        let seconds = (clock.mono() - began).seconds();
        let bytes = std::fs::metadata(&database).expect("is there").len();
        println!(
            "{nodes} nodes in {seconds:.0} s, {:.0} nodes/s, {:.1} bytes/node",
            nodes as f64 / seconds,
            bytes as f64 / nodes as f64
        );
    }
    let stop = CancellationToken::new();
    let running = start(&database, &clock, stop.clone()).await;
    let config = WebConfig { time_zone: Zone::Utc, ..WebConfig::default() };
    let router = peernet_web::router(&config, running.handle.clone(), Arc::clone(&clock), stop.clone());
    let times = measure(&router, &clock).await;
    stop.cancel();
    running.join().await.expect("ends well");
    times
}

/// Starts an aggregator on a free port.
async fn start(
    database: &Path,
    clock: &SharedClock,
    stop: CancellationToken,
) -> peernet_aggregator::RunningAggregator {
    let config = AggregatorConfig {
        listen: "tcp://127.0.0.1:0".into(),
        database: database.to_owned(),
        ..AggregatorConfig::default()
    };
    Aggregator::start(config, Arc::clone(clock), stop).await.expect("starts")
}
