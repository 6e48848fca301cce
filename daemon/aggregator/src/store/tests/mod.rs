//! The store with a real file: what the writer wrote is what readers are told.

mod clock_samples;
#[path = "../../../tests/it/clocks.rs"]
#[expect(unreachable_pub, reason = "shared with the integration tests")]
mod clocks;
mod ends;
#[path = "../../../tests/it/generate.rs"]
#[expect(unreachable_pub, reason = "shared with the integration tests and the benchmark")]
mod generate;
mod migrating;
mod plans;
mod questions;
mod recomputing;
mod simulation;
mod writing;

use std::path::PathBuf;

use peernet_clock::WallTime;
use peernet_logger::stream::{Batch, Event, StreamId};
use peernet_logger::{HostId, RunId};
use sqlx::{ConnectOptions, SqliteConnection};
use tempfile::TempDir;

use super::write::{Committed, Work, Writer};
use super::{Store, database};

const NOW: WallTime = WallTime::from_unix_nanos(1_750_000_000_000_000_000);

/// A database in a folder of its own, with one agent that writes to it.
struct Bed {
    _folder: TempDir,
    path: PathBuf,
    writer: Writer,
    store: Store,
    edge: HostId,
    cloud: HostId,
    stream: StreamId,
    next: u64,
}

impl Bed {
    async fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("peernet.sqlite");
        let writer = open(&path).await;
        let store = Store::new(database::readers(&path, 2));
        let (edge, cloud, stream) = (HostId::random(), HostId::random(), StreamId::random());
        let mut bed = Self { _folder: folder, path, writer, store, edge, cloud, stream, next: 1 };
        bed.commit(&[
            Work::Hello { host: Box::new(generate::host(bed.edge, "edge")), process: 1 },
            Work::Hello { host: Box::new(generate::host(bed.cloud, "cloud")), process: 1 },
        ])
        .await;
        bed
    }

    fn hosts(&self) -> (HostId, HostId) {
        (self.edge, self.cloud)
    }

    /// The next batch of the stream.
    fn batch(&mut self, events: Vec<Event>) -> Work {
        let number = self.next;
        self.next += 1;
        self.batch_numbered(number, events)
    }

    fn batch_numbered(&self, number: u64, events: Vec<Event>) -> Work {
        let batch = Batch { host: self.edge, stream: self.stream, number, events };
        Work::Batch(Box::new(batch))
    }

    async fn commit(&mut self, work: &[Work]) -> Committed {
        self.writer.commit(work, NOW).await.expect("commits")
    }

    /// Stores a run of so many iterations.
    async fn run_of(&mut self, iterations: u64) -> RunId {
        let run = RunId::random();
        let mut numbers = generate::Numbers(7);
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

    /// A connection of another program that may write.
    async fn other(&self) -> SqliteConnection {
        database::writing(&self.path).connect().await.expect("opens")
    }

    /// One number of the database.
    async fn count(&self, sql: &'static str) -> i64 {
        sqlx::query_scalar(sql).fetch_one(&self.store.pool).await.expect("counts")
    }
}

async fn open(path: &std::path::Path) -> Writer {
    let connection = database::open(path).await.expect("opens");
    Writer::new(path.to_owned(), connection).await.expect("reads the marks")
}
