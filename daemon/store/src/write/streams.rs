//! Streams of batches: the number up to which each stream is stored, and the stream that each host uses.

use std::collections::{HashMap, HashSet};

use peernet_clock::WallTime;
use peernet_logger::HostId;
use peernet_stream::{
    BatchHead, ChainHash, Hello, HighWaterMark, MissingPreviousBatches, StreamId, StreamRecord,
};
use sqlx::{Arguments, FromRow, SqliteConnection};

use super::entities::id;
use super::{Introduction, Refusal, records};
use crate::column::{column, count};
use crate::insert::Insert;
use crate::stored::StoredCounts;

/// The streams in the database.
#[derive(Clone, Debug, Default)]
pub struct Streams {
    /// Mark of each stream with stored batches.
    pub marks: HashMap<StreamId, HighWaterMark>,
    /// All streams with which any host ever introduced itself.
    introduced: HashSet<StreamId>,
    /// The stream with which each host introduced itself last.
    last_streams: HashMap<HostId, StreamId>,
}

/// The streams that a transaction advances.
#[derive(Debug)]
pub(super) struct AdvancedStreams {
    /// For each stream: the row of its host, and the head of the last batch that the transaction stores.
    last_batches: HashMap<StreamId, (i64, BatchHead)>,
    upsert: Insert,
}

impl Default for AdvancedStreams {
    fn default() -> Self {
        Self {
            last_batches: HashMap::new(),
            upsert: Insert::new(
                "INSERT INTO stream (uuid, host, stored, chain, process, events, first_seen_ns, last_seen_ns)",
                8,
                "ON CONFLICT (uuid) DO UPDATE SET stored = excluded.stored, chain = excluded.chain, \
                 process = excluded.process, events = excluded.events, last_seen_ns = excluded.last_seen_ns",
            ),
        }
    }
}

/// A row of the table `stream` with its host.
#[derive(FromRow)]
struct Row {
    uuid: String,
    host: String,
    stored: i64,
    chain: Option<Vec<u8>>,
    process: Option<i64>,
    events: Option<i64>,
}

impl Streams {
    /// Returns the record from which a hello is answered. `seniority` is the rank of the host by age among the stored
    /// hosts, smaller for older hosts; `None` if nothing of the host is stored.
    pub fn stream_record(&self, hello: &Hello, seniority: Option<u64>) -> StreamRecord {
        let mark_of = |stream| self.marks.get(&stream).copied();
        StreamRecord {
            mark: mark_of(hello.stream),
            was_used: self.introduced.contains(&hello.stream),
            last_stream: self.last_streams.get(&hello.host.id).copied(),
            previous_mark: hello.previous_stream.and_then(mark_of),
            seniority,
        }
    }

    /// Records that a host introduced itself with a stream.
    pub fn record_hello(&mut self, host: HostId, stream: StreamId) {
        self.introduced.insert(stream);
        self.last_streams.insert(host, stream);
    }

    /// Reads the table `stream`.
    pub(super) async fn load(connection: &mut SqliteConnection) -> Result<Self, sqlx::Error> {
        let rows: Vec<Row> = sqlx::query_as(
            "SELECT stream.uuid, host.uuid AS host, stream.stored, stream.chain, stream.process, \
             stream.events FROM stream JOIN host ON host.id = stream.host ORDER BY stream.last_seen_ns, stream.id",
        )
        .fetch_all(connection)
        .await?;
        let mut streams = Self::default();
        for Row { uuid, host, stored, chain, process, events } in rows {
            let (stream, host) = (id(&uuid)?, id(&host)?);
            streams.record_hello(host, stream);
            // A stream without a chain hash has no stored batches, or was stored by an earlier version of
            // PEERNet. In that version each start of an agent began a new stream, so no agent continues
            // the stream.
            let Some(chain) = chain else { continue };
            let chain = <[u8; 16]>::try_from(chain)
                .map_err(|_| invalid_column("a chain hash that is not 16 bytes long"))?;
            let stored = u64::try_from(stored).map_err(|error| sqlx::Error::Decode(error.into()))?;
            let (chain, process) = (ChainHash::from_bytes(chain), process.map(i64::cast_unsigned));
            let events = events.map(count);
            streams.marks.insert(stream, HighWaterMark { host, stored, chain, process, events });
        }
        Ok(streams)
    }
}

impl AdvancedStreams {
    /// Stores that a host introduced itself with a stream.
    ///
    /// For a new stream, a gap is stored if the stream does not continue the host's previous stream, or if batches of
    /// the previous stream are missing in this database. Returns what the gaps add to the counters of the host.
    pub(super) async fn introduce(
        &mut self,
        connection: &mut SqliteConnection,
        host: i64,
        introduction: &Introduction,
        is_first_contact: bool,
        now: WallTime,
    ) -> Result<StoredCounts, Refusal> {
        let update = sqlx::query("UPDATE stream SET last_seen_ns = ? WHERE uuid = ?")
            .bind(now.unix_nanos())
            .bind(introduction.stream.to_string())
            .execute(&mut *connection)
            .await?;
        if update.rows_affected() > 0 {
            // The stream is not new: its gaps were stored with its first hello.
            return Ok(StoredCounts::default());
        }
        // No batch of the new stream is stored yet. `stored` is the number before the stream's first batch.
        sqlx::query(
            "INSERT INTO stream (uuid, host, stored, previous, first_seen_ns, last_seen_ns) \
             VALUES (?1, ?2, ?3, ?4, ?5, ?5)",
        )
        .bind(introduction.stream.to_string())
        .bind(host)
        .bind(column(introduction.first.saturating_sub(1)))
        .bind(introduction.previous_stream.map(|stream| stream.to_string()))
        .bind(now.unix_nanos())
        .execute(&mut *connection)
        .await?;
        let replaced = introduction.replaced.map(|replaced| {
            let reason = format!(
                "the spool with the stream {replaced} was deleted or replaced: its remaining events are lost, and their number is unknown"
            );
            (reason, None)
        });
        let missing_previous = introduction.missing_previous.map(|MissingPreviousBatches { stream, from, through, events }| {
            let reason = match is_first_contact {
                true => records::describe_batches_of_other_database(&stream, from, through),
                false => format!(
                    "batches {from} to {through} of stream {stream} are not in this database: they were stored in a newer \
                     database, of which this one is an older copy"
                ),
            };
            (reason, events)
        });
        let mut added = StoredCounts::default();
        for (reason, events) in replaced.into_iter().chain(missing_previous) {
            added.add(&records::insert_unattributed_gap(&mut *connection, host, &reason, events, now).await?);
        }
        Ok(added)
    }

    /// Records that this transaction stores all batches of a stream up to the batch with this head.
    pub(super) fn advance(&mut self, host: i64, head: BatchHead) {
        self.last_batches.insert(head.stream, (host, head));
    }

    /// Returns the new mark of a stream, if this transaction advances the stream.
    pub(super) fn new_mark(&self, stream: StreamId) -> Option<HighWaterMark> {
        self.last_batches.get(&stream).map(|(_, head)| HighWaterMark::from(*head))
    }

    /// Writes the new marks to the table `stream` and returns them.
    pub(super) async fn write(
        &mut self,
        connection: &mut SqliteConnection,
        now: WallTime,
    ) -> Result<HashMap<StreamId, HighWaterMark>, sqlx::Error> {
        self.upsert
            .run(connection, &self.last_batches, |(stream, (host, head)), to| {
                to.add(stream.to_string())?;
                to.add(*host)?;
                to.add(column(head.number))?;
                to.add(head.chain.as_bytes().as_slice())?;
                to.add(head.process.cast_signed())?;
                to.add(column(head.events_through()))?;
                to.add(now.unix_nanos())?;
                to.add(now.unix_nanos())
            })
            .await?;
        Ok(self.last_batches.drain().map(|(stream, (_, head))| (stream, HighWaterMark::from(head))).collect())
    }

    /// Discards the state that is only in memory, because the transaction failed.
    pub(super) fn forget(&mut self) {
        self.last_batches.clear();
    }
}

fn invalid_column(what: &'static str) -> sqlx::Error {
    sqlx::Error::Decode(what.into())
}
