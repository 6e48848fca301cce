//! One transaction: the work of many hosts, from `BEGIN` to `COMMIT`.

use std::collections::HashMap;

use peernet_clock::{Stamp, WallTime};
use peernet_stream::{BatchHead, Event, HighWaterMark, MissingBatches, StreamId};
use sqlx::SqliteConnection;

use super::clock::Links;
use super::counters::Counters;
use super::ends::RunEnds;
use super::entities::{Entities, Reporter};
use super::foreign_reports::ForeignReports;
use super::names::Names;
use super::prepared::{PreparedBatch, Step};
use super::quarantine::RejectedBatch;
use super::rows::{Inserts, ResolvedBatch};
use super::streams::AdvancedStreams;
use super::{CommitResult, Introduction, Refusal, Work, records, secrets};
use crate::raw_transaction;
use crate::rollups::Rollups;
use crate::storage_clock::StorageClock;
use crate::stored::StoredCounts;

/// State that transactions share: caches of the small tables, and additions that are written at the end of a
/// transaction.
#[derive(Debug, Default)]
pub(super) struct Staging {
    pub(super) names: Names,
    entities: Entities,
    inserts: Inserts,
    rollups: Rollups,
    counters: Counters,
    advanced_streams: AdvancedStreams,
    ends: RunEnds,
    links: Links,
    foreign_reports: ForeignReports,
}

impl Staging {
    pub(super) fn new(names: Names) -> Self {
        Self { names, ..Self::default() }
    }

    /// Stores all of `work`, and advances the storage clock. If `quarantine_reason` is given, the database has refused
    /// this work for that reason: the batches are quarantined instead, missing batches are marked as stored without a
    /// gap, and all other work is dropped. `marks` are the committed marks.
    pub(super) async fn run(
        &mut self,
        connection: &mut SqliteConnection,
        work: &[Work],
        marks: &HashMap<StreamId, HighWaterMark>,
        (storage_clock, stamp): (&StorageClock, Stamp),
        quarantine_reason: Option<&str>,
    ) -> Result<CommitResult, Refusal> {
        raw_transaction::begin(connection).await?;
        let elapsed = storage_clock.advance(connection, stamp).await?;
        let storage_s = elapsed.nanos().div_euclid(1_000_000_000);
        let now = stamp.wall;
        let mut committed = CommitResult::default();
        let mut batches = Vec::new();
        for item in work {
            let (head, rejected) = match (item, quarantine_reason) {
                (Work::Batch(batch), None) => (batch.head, None),
                (Work::Batch(batch), Some(reason)) => {
                    (batch.head, Some(RejectedBatch::from_refused(batch, reason)))
                }
                (Work::UnstorableBatch(batch), _) => {
                    (batch.head, Some(RejectedBatch::from_unstorable(batch)))
                }
                (Work::MissingBatches(missing), _) => {
                    let MissingBatches {
                        host, stream, through: number, chain, process, events_through, ..
                    } = *missing;
                    // This head stands for the last missing batch. Only the fields that identify the batch and its mark
                    // are used.
                    let (previous_chain, events, events_before) = (chain, 0, events_through);
                    let head = BatchHead {
                        host,
                        stream,
                        process,
                        number,
                        previous_chain,
                        chain,
                        events,
                        events_before,
                    };
                    (head, None)
                }
                // Only batches are quarantined. Another message that the database refused is dropped.
                (
                    Work::Hello(_) | Work::Goodbye(_) | Work::Secret(_) | Work::LiveDescription(_),
                    Some(reason),
                ) => {
                    tracing::error!(
                        reason,
                        "the database refused a message of a host: the message is dropped, the batches are stored"
                    );
                    continue;
                }
                (Work::Hello(introduction), None) => {
                    self.introduce(connection, introduction, now).await?;
                    continue;
                }
                (Work::Goodbye(host), None) => {
                    // The host may be missing in a database that has replaced another database.
                    if let Some(id) = self.entities.find_host(connection, *host).await? {
                        self.ends.record_process_end(connection, id).await?;
                    }
                    continue;
                }
                (Work::Secret(host), None) => {
                    committed.secrets.push((*host, secrets::read_host_secret(connection, *host).await?));
                    continue;
                }
                (Work::LiveDescription(description), None) => {
                    self.entities.describe_run(connection, description, now).await?;
                    continue;
                }
            };
            let mark =
                self.advanced_streams.new_mark(head.stream).or_else(|| marks.get(&head.stream).copied());
            if let Some(mark) = mark.filter(|mark| head.number <= mark.stored) {
                // The batch is already stored. The agent sent it again because it had no acknowledgement yet.
                committed.marks.insert(head.stream, mark);
                continue;
            }
            let host = self.entities.host(connection, head.host, now).await?;
            let reporter = Reporter { id: head.host, row: host };
            let added = match (item, rejected) {
                (_, Some(rejected)) => {
                    let reason = rejected.reason().to_owned();
                    let added = rejected.store(connection, &mut self.entities, reporter, now).await?;
                    committed.quarantined.push((head, reason));
                    added
                }
                (Work::Batch(batch), None) => {
                    batches.push(self.resolve(connection, batch, reporter, now).await?);
                    let counts = self.counters.host(head.host, host);
                    counts.newest = counts.newest.max(batch.newest);
                    batch.added
                }
                (Work::MissingBatches(missing), None) => match quarantine_reason {
                    Some(reason) => {
                        // The mark advances without the gap. Otherwise this work would be tried again without end, and
                        // the work of all other hosts would wait for it.
                        tracing::error!(
                            host = %missing.host, from = missing.from, through = missing.through,
                            events = missing.events, reason,
                            "the database refused the gap for missing batches of a host: the gap is not recorded"
                        );
                        StoredCounts::default()
                    }
                    None => {
                        let is_first_contact =
                            self.counters.is_first_contact(connection, head.host, host).await?;
                        records::insert_missing_batches(connection, host, missing, is_first_contact, now)
                            .await?
                    }
                },
                // All other work was done above.
                _ => continue,
            };
            self.counters.host(head.host, host).add(&added);
            self.advanced_streams.advance(host, head);
        }
        committed.nodes = batches.iter().map(|batch| batch.batch.nodes.len() as u64).sum();
        // The batches of one run are inserted one after the other, because the rows of one run are adjacent in the
        // tables.
        batches.sort_by_key(|batch| batch.runs.first().copied());
        self.inserts.run(connection, &batches, &mut self.rollups).await?;
        self.rollups.write(connection).await?;
        committed.hosts = self.counters.write(connection, now, storage_s).await?;
        self.links.write(connection, storage_s).await?;
        // Ends come after the counters: a run without a reported end ends with its last iteration.
        self.ends.write(connection).await?;
        self.foreign_reports.write(connection, now).await?;
        committed.marks.extend(self.advanced_streams.write(connection, now).await?);
        raw_transaction::commit(connection).await?;
        committed.runs = self.entities.take_loaded_runs();
        committed.runs_without_start = self.entities.take_runs_without_start();
        Ok(committed)
    }

    async fn introduce(
        &mut self,
        connection: &mut SqliteConnection,
        introduction: &Introduction,
        now: WallTime,
    ) -> Result<(), Refusal> {
        let id = self.entities.introduce(connection, &introduction.host, now).await?;
        self.ends.record_process(connection, id, introduction.process).await?;
        if let Some(secret) = &introduction.secret {
            secrets::enrol(connection, id, secret, now).await?;
        }
        let host = introduction.host.id;
        let is_first_contact = self.counters.is_first_contact(connection, host, id).await?;
        let added =
            self.advanced_streams.introduce(connection, id, introduction, is_first_contact, now).await?;
        self.counters.host(host, id).add(&added);
        Ok(())
    }

    /// Stores the events of a batch that are not iterations, and looks up the ids to which the batch's rows refer.
    async fn resolve<'a>(
        &mut self,
        connection: &mut SqliteConnection,
        batch: &'a PreparedBatch,
        reporter: Reporter,
        now: WallTime,
    ) -> Result<ResolvedBatch<'a>, Refusal> {
        // Foreign runs are looked for before any event of the batch is stored, because an event may create a run of the
        // reporter with the same id.
        self.foreign_reports.check(connection, &mut self.entities, reporter, &batch.named_runs).await?;
        let mut runs = vec![0; batch.runs.len()];
        for step in &batch.steps {
            match step {
                Step::Event(event) => self.store_event(connection, event, reporter, now).await?,
                Step::Run(run, started) => {
                    let part = &batch.runs[*run as usize];
                    let known =
                        self.entities.find_or_create_run(connection, reporter, part.id, *started).await?;
                    runs[*run as usize] = known.number;
                }
            }
        }
        let mut names = Vec::with_capacity(batch.names.len());
        for key in &batch.names {
            names.push(self.names.id(connection, key).await?);
        }
        let mut hosts = Vec::with_capacity(batch.hosts.len());
        for host in &batch.hosts {
            hosts.push(self.entities.host(connection, *host, now).await?);
        }
        for (part, run) in batch.runs.iter().zip(&runs) {
            self.counters.add_run_part(*run, part);
        }
        Ok(ResolvedBatch { batch, runs, names, hosts })
    }

    async fn store_event(
        &mut self,
        connection: &mut SqliteConnection,
        event: &Event,
        reporter: Reporter,
        now: WallTime,
    ) -> Result<(), Refusal> {
        match event {
            Event::RunStarted(run) => {
                let (known, pipeline) = self.entities.store_run_start(connection, reporter, run).await?;
                self.ends.record_next_run(pipeline, known.number);
                Ok(())
            }
            Event::RunEnded(end) => self.entities.store_run_end(connection, reporter, end).await,
            Event::Incident(incident) => {
                records::insert_incident(connection, &mut self.entities, reporter, incident, now).await
            }
            Event::Gap(gap) => records::insert_gap(connection, &mut self.entities, reporter, gap).await,
            Event::Clock(sample) => {
                self.links.store(connection, &mut self.entities, reporter.row, sample, now).await
            }
            // Iterations are not stored as events: `PreparedBatch` holds their rows.
            Event::Iteration(_) => Ok(()),
        }
    }

    /// Discards the state that is only in memory, because the transaction failed. The names have to be read again.
    pub(super) fn forget(&mut self) {
        self.entities.forget();
        self.rollups.forget();
        self.counters.forget();
        self.advanced_streams.forget();
        self.ends.forget();
        self.links.forget();
        self.foreign_reports.forget();
    }
}
