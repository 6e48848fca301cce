//! Statistics that grow with the nodes, in the same transaction.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use peernet_statistics::{Moments, Sketch, Summary};
use sqlx::{Arguments, SqliteConnection};

use super::insert::Insert;

/// Widths of the buckets in seconds; 0 is the whole run. A coarser one is one more number here.
pub(crate) const RESOLUTIONS: [i64; 2] = [0, 10];
/// The finest buckets: what a commit's numbers are collected in first.
const FINEST_S: i64 = 10;
/// Summaries kept in memory; beyond, all are forgotten and read again when needed.
const MOST_CACHED: usize = 20_000;

/// What is summed up of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Quantity {
    /// Its value.
    Value = 0,
    /// Half the width of its bounds.
    HalfWidth = 1,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Key {
    run: i64,
    resolution_s: i64,
    name: i64,
    quantity: Quantity,
    bucket_s: i64,
}

/// The summaries that current runs write to.
#[derive(Debug)]
pub(super) struct Rollups {
    /// As they stand in the database, or will when the transaction ends well.
    cached: HashMap<Key, Summary>,
    /// What the current transaction adds, in the finest buckets.
    fresh: HashMap<Key, Summary>,
    verdicts: HashMap<(i64, i64, u8), i64>,
    upsert: Insert,
    upsert_verdicts: Insert,
}

impl Default for Rollups {
    fn default() -> Self {
        Self {
            cached: HashMap::new(),
            fresh: HashMap::new(),
            verdicts: HashMap::new(),
            upsert: Insert::new(
                "INSERT INTO rollup (run, resolution_s, name, quantity, bucket_s, count, mean, m2, min, max, sketch)",
                11,
                "ON CONFLICT DO UPDATE SET count = excluded.count, mean = excluded.mean, m2 = excluded.m2, \
                 min = excluded.min, max = excluded.max, sketch = excluded.sketch",
            ),
            upsert_verdicts: Insert::new(
                "INSERT INTO verdict_count (run, name, verdict, count)",
                4,
                "ON CONFLICT DO UPDATE SET count = count + excluded.count",
            ),
        }
    }
}

impl Rollups {
    /// Adds a number of an iteration that began at `started_s`; what is not finite is left out.
    pub(super) fn record(&mut self, run: i64, name: i64, quantity: Quantity, started_s: i64, value: f64) {
        let bucket_s = started_s - started_s.rem_euclid(FINEST_S);
        let key = Key { run, resolution_s: FINEST_S, name, quantity, bucket_s };
        self.fresh.entry(key).or_default().record(value);
    }

    /// Counts a verdict.
    pub(super) fn judge(&mut self, run: i64, name: i64, verdict: u8) {
        *self.verdicts.entry((run, name, verdict)).or_default() += 1;
    }

    /// Writes what was added since the last time.
    pub(super) async fn write(&mut self, connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
        if self.cached.len() > MOST_CACHED {
            self.cached.clear();
        }
        let mut touched = HashMap::<Key, Summary>::new();
        for (fine, summary) in self.fresh.drain().filter(|(_, summary)| summary.count() > 0) {
            for resolution_s in RESOLUTIONS {
                touched.entry(fine.at(resolution_s)).or_default().merge(&summary);
            }
        }
        let mut rows = Vec::with_capacity(touched.len());
        for (key, added) in touched {
            let all = match self.cached.entry(key) {
                Entry::Occupied(cached) => cached.into_mut(),
                Entry::Vacant(place) => place.insert(read(connection, key).await?.unwrap_or_default()),
            };
            all.merge(&added);
            rows.push((key, all.moments, all.sketch.to_bytes()));
        }
        // By key: neighbours share pages.
        rows.sort_unstable_by_key(|(key, ..)| {
            (key.run, key.resolution_s, key.name, key.quantity as u8, key.bucket_s)
        });
        self.upsert
            .run(connection, &rows, |(key, moments, sketch), to| {
                to.add(key.run)?;
                to.add(key.resolution_s)?;
                to.add(key.name)?;
                to.add(key.quantity as u8)?;
                to.add(key.bucket_s)?;
                to.add(i64::try_from(moments.count)?)?;
                to.add(moments.mean)?;
                to.add(moments.m2)?;
                to.add(moments.min)?;
                to.add(moments.max)?;
                to.add(sketch.as_slice())
            })
            .await?;
        let verdicts: Vec<_> = self.verdicts.drain().collect();
        self.upsert_verdicts
            .run(connection, &verdicts, |((run, name, verdict), count), to| {
                to.add(*run)?;
                to.add(*name)?;
                to.add(*verdict)?;
                to.add(*count)
            })
            .await
    }

    /// Forgets what is only in memory: the transaction did not end well.
    pub(super) fn forget(&mut self) {
        self.cached.clear();
        self.fresh.clear();
        self.verdicts.clear();
    }
}

impl Key {
    /// The key of the bucket of another width that this one falls into.
    fn at(self, resolution_s: i64) -> Self {
        let bucket_s =
            if resolution_s == 0 { 0 } else { self.bucket_s - self.bucket_s.rem_euclid(resolution_s) };
        Self { resolution_s, bucket_s, ..self }
    }
}

async fn read(connection: &mut SqliteConnection, key: Key) -> Result<Option<Summary>, sqlx::Error> {
    let row: Option<(i64, f64, f64, f64, f64, Vec<u8>)> = sqlx::query_as(
        "SELECT count, mean, m2, min, max, sketch FROM rollup \
         WHERE run = ? AND resolution_s = ? AND name = ? AND quantity = ? AND bucket_s = ?",
    )
    .bind(key.run)
    .bind(key.resolution_s)
    .bind(key.name)
    .bind(key.quantity as u8)
    .bind(key.bucket_s)
    .fetch_optional(connection)
    .await?;
    row.map(|(count, mean, m2, min, max, sketch)| {
        let count = u64::try_from(count).map_err(|error| sqlx::Error::Decode(error.into()))?;
        let sketch = Sketch::from_bytes(&sketch).map_err(|error| sqlx::Error::Decode(error.into()))?;
        Ok(Summary { moments: Moments { count, mean, m2, min, max }, sketch })
    })
    .transpose()
}
