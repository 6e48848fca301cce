//! The tables `rollup` and `verdict_count`.

use peernet_statistics::{Moments, Sketch, Summary};
use sqlx::{Arguments, FromRow, SqliteConnection};

use super::packed::PackedSummary;
use super::{Quantity, SeriesKey, WHOLE_RUN, WIDTHS_S};
use crate::insert::Insert;

/// A row of `rollup`.
#[derive(Clone, Debug, FromRow)]
pub(crate) struct RollupRow {
    run: i64,
    resolution_s: i64,
    pub(crate) bucket_s: i64,
    pub(crate) name: i64,
    quantity: i64,
    count: i64,
    mean: f64,
    m2: f64,
    min: f64,
    max: f64,
    sketch: Vec<u8>,
}

impl RollupRow {
    pub(super) fn new(
        (run, resolution_s, bucket_s): (i64, i64, i64),
        (name, quantity): SeriesKey,
        packed: PackedSummary,
    ) -> Self {
        let Moments { count, mean, m2, min, max } = packed.moments;
        // An earlier version accepted numbers close to infinity, from which NaN may result. The table rejects NaN, so
        // NaN is replaced: a bad value must not prevent that later values are stored. Such a row has an infinite mean
        // until the roll-ups are rebuilt.
        let without_nan = |number: f64| if number.is_nan() { f64::INFINITY } else { number };
        let (mean, m2) = (without_nan(mean), without_nan(m2));
        Self {
            run,
            resolution_s,
            bucket_s,
            name,
            quantity: quantity as i64,
            count: count.cast_signed(),
            mean,
            m2,
            min,
            max,
            sketch: packed.sketch,
        }
    }

    /// Returns the key, which is the order of the table.
    pub(super) const fn key(&self) -> (i64, i64, i64, i64, i64) {
        (self.run, self.resolution_s, self.bucket_s, self.name, self.quantity)
    }

    /// Returns the quantity.
    ///
    /// # Errors
    /// If no quantity has the stored number.
    pub(crate) fn quantity(&self) -> Result<Quantity, sqlx::Error> {
        let unknown = || sqlx::Error::Decode(format!("quantity {} of a roll-up", self.quantity).into());
        Quantity::from_number(self.quantity).ok_or_else(unknown)
    }

    const fn moments(&self) -> Moments {
        let Self { count, mean, m2, min, max, .. } = *self;
        Moments { count: count.unsigned_abs(), mean, m2, min, max }
    }

    pub(super) fn into_parts(self) -> Result<(i64, SeriesKey, PackedSummary), sqlx::Error> {
        let series = (self.name, self.quantity()?);
        let moments = self.moments();
        Ok((self.bucket_s, series, PackedSummary { moments, sketch: self.sketch }))
    }

    /// Returns the summary of the row.
    pub(crate) fn summary(&self) -> Result<Summary, sqlx::Error> {
        let sketch = Sketch::from_bytes(&self.sketch).map_err(|error| sqlx::Error::Decode(error.into()))?;
        Ok(Summary { moments: self.moments(), sketch })
    }
}

/// Statements that write the tables `rollup` and `verdict_count`.
#[derive(Debug)]
pub(super) struct Upserts {
    rollups: Insert,
    verdicts: Insert,
}

impl Default for Upserts {
    fn default() -> Self {
        Self {
            rollups: Insert::new(
                "INSERT INTO rollup (run, resolution_s, bucket_s, name, quantity, count, mean, m2, min, max, sketch)",
                11,
                // Rows are replaced, because moments and sketches are merged in memory.
                "ON CONFLICT DO UPDATE SET count = excluded.count, mean = excluded.mean, m2 = excluded.m2, \
                 min = excluded.min, max = excluded.max, sketch = excluded.sketch",
            ),
            verdicts: Insert::new(
                "INSERT INTO verdict_count (run, name, verdict, count)",
                4,
                "ON CONFLICT DO UPDATE SET count = count + excluded.count",
            ),
        }
    }
}

impl Upserts {
    /// Writes rows, and replaces existing rows with the same keys.
    pub(super) async fn write_rollups(
        &self,
        connection: &mut SqliteConnection,
        rows: Vec<RollupRow>,
    ) -> Result<(), sqlx::Error> {
        self.rollups
            .run(connection, rows, |row, to| {
                to.add(row.run)?;
                to.add(row.resolution_s)?;
                to.add(row.bucket_s)?;
                to.add(row.name)?;
                to.add(row.quantity)?;
                to.add(row.count)?;
                to.add(row.mean)?;
                to.add(row.m2)?;
                to.add(row.min)?;
                to.add(row.max)?;
                to.add(row.sketch)
            })
            .await
    }

    /// Adds to the counts of verdicts.
    pub(super) async fn write_verdicts(
        &self,
        connection: &mut SqliteConnection,
        counts: &[((i64, i64, u8), i64)],
    ) -> Result<(), sqlx::Error> {
        self.verdicts
            .run(connection, counts, |((run, name, verdict), count), to| {
                to.add(*run)?;
                to.add(*name)?;
                to.add(*verdict)?;
                to.add(*count)
            })
            .await
    }
}

/// Start of the newest bucket of each width, and of the whole run: ?1 run.
// Each subquery looks up one end of the key. A query with GROUP BY would read all roll-ups of the run.
const NEWEST: &str = "SELECT (SELECT max(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = 1), \
     (SELECT max(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = 10), \
     (SELECT max(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = 60), \
     (SELECT max(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = 3600), \
     (SELECT max(bucket_s) FROM rollup WHERE run = ?1 AND resolution_s = 0)";

/// Returns the start of the newest bucket of each width, and of the whole run.
pub(super) async fn newest_buckets(
    connection: &mut SqliteConnection,
    run: i64,
) -> Result<[Option<i64>; WIDTHS_S.len() + 1], sqlx::Error> {
    // `NEWEST` contains `WHOLE_RUN` as the number 0.
    const _: () = assert!(WHOLE_RUN == 0);
    let (second, ten, minute, hour, whole) = sqlx::query_as(NEWEST).bind(run).fetch_one(connection).await?;
    Ok([second, ten, minute, hour, whole])
}

/// ?1 run, ?2 width, ?3 starts of the buckets, a JSON array.
const BUCKETS: &str = "SELECT run, resolution_s, bucket_s, name, quantity, count, mean, m2, min, max, sketch \
     FROM rollup WHERE run = ?1 AND resolution_s = ?2 AND bucket_s IN (SELECT value FROM json_each(?3)) \
     ORDER BY bucket_s, name, quantity";

/// Returns all rows of the buckets with these starts, in the order of the table.
pub(super) async fn read_buckets(
    connection: &mut SqliteConnection,
    run: i64,
    width_s: i64,
    buckets: &[i64],
) -> Result<Vec<RollupRow>, sqlx::Error> {
    let buckets = serde_json::to_string(buckets).map_err(|error| sqlx::Error::Encode(error.into()))?;
    sqlx::query_as(BUCKETS).bind(run).bind(width_s).bind(buckets).fetch_all(connection).await
}

/// Statements of the writer, whose query plans a test checks.
#[cfg(test)]
pub(crate) const QUERIES: [(&str, &str); 2] = [("NEWEST", NEWEST), ("BUCKETS", BUCKETS)];
