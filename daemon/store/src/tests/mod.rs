//! Tests of the store with a real file: readers get what the writer stored.

mod arguments;
mod clock_samples;
#[path = "../../../aggregator/tests/it/clocks.rs"]
#[expect(unreachable_pub, reason = "shared with the integration tests")]
mod clocks;
mod connections;
mod deadlines;
mod episode_results;
mod episodes;
mod experiments;
mod fixtures;
mod foreign_log;
#[path = "../../../aggregator/tests/it/generate.rs"]
#[expect(unreachable_pub, reason = "shared with the integration tests and the benchmark")]
mod generate;
mod interval_ends;
mod limits;
mod maintaining;
mod measured_time;
mod merged_statistics;
mod migrating;
mod observed_delays;
mod one_value;
mod ownership;
mod queries;
mod query_plans;
mod rebuilding;
mod recomputing;
mod recomputing_by_raw_clocks;
mod refused_work;
mod repairing;
mod retention;
mod retention_size;
mod rollups;
mod run_ends;
mod simulation;
mod skipped_starts;
mod start_times;
mod storage_clock;
mod value_pairs;
mod whole_iterations;
mod writing;

use std::path::PathBuf;
use std::sync::Arc;

use bytes::Bytes;
use peernet_clock::{ClockIdentity, MonoTime, RawTime, Stamp, SystemClock, WallTime};
use peernet_logger::{HostId, RunId};
use peernet_stream::{BatchHead, ChainHash, Event, HostDescription, StreamId};
use sqlx::{ConnectOptions, SqliteConnection};
use tempfile::TempDir;

use super::integrity::Integrity;
use super::readers::Readers;
use super::write::{CommitResult, Introduction, Work, Writer};
use super::{Store, database};
use crate::RetentionConfig;

const NOW: WallTime = WallTime::from_unix_nanos(1_750_000_000_000_000_000);
/// Readings of the aggregator's clocks when a test commits.
const STAMP: Stamp = Stamp { wall: NOW, mono: MonoTime::from_nanos(0), raw: RawTime::from_nanos(0) };

/// Number of the process that all batches come from.
// The number is greater than SQLite's greatest integer, because agents draw process numbers from the whole `u64` range.
const PROCESS: u64 = u64::MAX - 4;

/// Number of nodes of an iteration that [`generate::iteration`] makes.
const NODES_PER_ITERATION: i64 = 21;

/// A database in a temporary folder with one agent that writes to it.
struct TestStore {
    _folder: TempDir,
    path: PathBuf,
    writer: Writer,
    store: Store,
    edge: HostId,
    cloud: HostId,
    stream: StreamId,
    next_number: u64,
}

impl TestStore {
    async fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("peernet.sqlite");
        let writer = open(&path).await;
        let store = Store::new(readers(&path));
        let (edge, cloud, stream) = (HostId::random(), HostId::random(), StreamId::random());
        let mut test_store =
            Self { _folder: folder, path, writer, store, edge, cloud, stream, next_number: 1 };
        test_store
            .commit(&[
                hello(generate::host(test_store.edge, "edge"), 1),
                hello(generate::host(test_store.cloud, "cloud"), 1),
            ])
            .await;
        test_store
    }

    fn hosts(&self) -> (HostId, HostId) {
        (self.edge, self.cloud)
    }

    /// Makes the next batch of the stream.
    fn batch(&mut self, events: Vec<Event>) -> Work {
        let number = self.next_number;
        self.next_number += 1;
        self.batch_numbered(number, events)
    }

    fn batch_numbered(&self, number: u64, events: impl AsRef<[Event]>) -> Work {
        let events = events.as_ref();
        let body = Bytes::from(generate::body(events));
        Work::from_batch(self.head(number, &body, events.len()), body)
    }

    fn head(&self, number: u64, body: &[u8], events: usize) -> BatchHead {
        // The store does not check chains, so each batch begins a new chain.
        let (host, stream, previous_chain, events) =
            (self.edge, self.stream, ChainHash::START, events as u32);
        // A made-up number of earlier events, which grows from batch to batch.
        let (chain, events_before) = (previous_chain.next(events, body), 100 * number);
        BatchHead { host, stream, process: PROCESS, number, previous_chain, chain, events, events_before }
    }

    async fn commit(&mut self, work: &[Work]) -> CommitResult {
        self.writer.commit(work, STAMP).await.expect("commits")
    }

    /// Stores a run of `iterations` iterations.
    async fn store_run(&mut self, iterations: u64) -> RunId {
        let run = RunId::random();
        let mut numbers = generate::Numbers::new(7);
        let mut events = vec![generate::run_started(run, "line", generate::at(0.0))];
        let hosts = self.hosts();
        events.extend(
            (1..=iterations).map(|n| Event::Iteration(generate::iteration(run, n, hosts, &mut numbers))),
        );
        let work: Vec<Work> =
            events.chunks(50).map(<[Event]>::to_vec).map(|events| self.batch(events)).collect();
        self.commit(&work).await;
        run
    }

    /// Opens a connection that may write, as another program would.
    async fn second_connection(&self) -> SqliteConnection {
        database::write_options(&self.path).connect().await.expect("opens")
    }

    /// Returns the number that a query selects.
    async fn count(&self, sql: &'static str) -> i64 {
        sqlx::query_scalar(sql).fetch_one(&self.store.readers.pool()).await.expect("counts")
    }
}

async fn open(path: &std::path::Path) -> Writer {
    let connection = database::open(path).await.expect("opens");
    Writer::new(path.to_owned(), connection, RetentionConfig::default()).await.expect("reads the marks")
}

/// Makes the introduction of a host's process, with a stream that the test does not use otherwise.
fn hello(host: HostDescription, process: u64) -> Work {
    let stream = StreamId::random();
    Work::Hello(Box::new(Introduction {
        host,
        process,
        stream,
        previous_stream: None,
        first: 1,
        replaced: None,
        missing_previous: None,
        secret: None,
    }))
}

/// Makes readers with a time limit that no query of a test reaches.
fn readers(path: &std::path::Path) -> Readers {
    let identity = ClockIdentity::from_system(ClockIdentity::SYSTEM).expect("linux has a boot id");
    Readers::open(
        path,
        2,
        std::time::Duration::from_secs(600),
        Arc::new(SystemClock::new(identity)),
        Integrity::new(path),
    )
}
