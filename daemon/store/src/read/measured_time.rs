//! The time in which a run measured, and the values within a period. The number of rows that are read hardly depends on
//! the length of the period: whole buckets are read, each as wide as possible, and single iterations only from the
//! incomplete seconds at both ends of the period.

use peernet_clock::WallTime;
use peernet_logger::stage;

use super::iterations::Row;
use super::statistics::{NameIds, StoredWidths};
use super::{corrupt_data, sql, wall};
use crate::error::StoreError;
use crate::readers::Readers;
use crate::rollups::{RollupRow, WIDTHS_S};
use crate::types::{MeasuredTime, MeasuredWithin, RunSummary};

/// Name of the requested data in errors.
const WHAT: &str = "measured times";
/// Number of iterations at the start of a run that are searched for the first successful iteration, and number at its
/// end that are searched for the last one.
const MAX_SEARCHED: i64 = 10_000;
const SECOND_NS: i64 = 1_000_000_000;

pub(crate) async fn measured_time(
    readers: &Readers,
    run: &RunSummary,
) -> Result<Option<MeasuredTime>, StoreError> {
    let widths = StoredWidths::read(readers, run.number).await?;
    let Some((width_s, (first_bucket_s, last_bucket_s))) = widths.finest_complete() else { return Ok(None) };
    // While all iterations and all buckets of one second each are stored, the times are exact.
    if run.last_deleted_iteration == 0 && width_s == WIDTHS_S[0] {
        let read_start = async |statement: &'static str| {
            let row: Option<Row> = sqlx::query_as(statement)
                .bind(run.number)
                .bind(MAX_SEARCHED)
                .fetch_optional(&readers.pool())
                .await
                .map_err(readers.error_for(WHAT))?;
            Ok(row.map(|row| wall(row.started_ns)))
        };
        if let Some((first, last)) =
            read_start(sql::FIRST_IN_STATISTICS).await?.zip(read_start(sql::LAST_IN_STATISTICS).await?)
        {
            return Ok(Some(MeasuredTime { first, last, resolution_s: 0 }));
        }
    }
    // The first iteration may be anywhere in the first bucket, and the last iteration anywhere in the last bucket. The
    // whole buckets between these two buckets are certainly within the measured time.
    let (first_s, last_s) = (first_bucket_s + width_s, last_bucket_s);
    Ok((first_s < last_s).then(|| MeasuredTime {
        first: wall(first_s * SECOND_NS),
        last: wall(last_s * SECOND_NS),
        resolution_s: u32::try_from(width_s).unwrap_or(u32::MAX),
    }))
}

pub(crate) async fn measured_within(
    readers: &Readers,
    run: i64,
    (from, to): (WallTime, WallTime),
) -> Result<MeasuredWithin, StoreError> {
    let (from_ns, to_ns) = (from.unix_nanos(), to.unix_nanos());
    // The whole seconds within the period: the start is rounded up, and the end is rounded down.
    let (first_whole_s, end_whole_s) = (-(-from_ns).div_euclid(SECOND_NS), to_ns.div_euclid(SECOND_NS));
    let mut measured = MeasuredWithin::default();
    if first_whole_s >= end_whole_s {
        add_iterations(readers, run, (from_ns, to_ns), &mut measured).await?;
        return Ok(measured);
    }
    let name_ids = NameIds::read(readers, &[stage::TOTAL]).await?.ids()?;
    for (width_s, first_s, end_s) in widest_buckets((first_whole_s, end_whole_s)) {
        let rows: Vec<RollupRow> = sqlx::query_as(sql::ROLLUPS_WITHIN)
            .bind(run)
            .bind(width_s)
            .bind(&name_ids)
            .bind(first_s)
            .bind(end_s)
            .fetch_all(&readers.pool())
            .await
            .map_err(readers.error_for(WHAT))?;
        for row in rows {
            measured.totals.merge(&row.summary().map_err(|error| corrupt_data(WHAT, error))?);
        }
    }
    measured.count = measured.totals.count();
    add_iterations(readers, run, (from_ns, first_whole_s * SECOND_NS), &mut measured).await?;
    add_iterations(readers, run, (end_whole_s * SECOND_NS, to_ns), &mut measured).await?;
    Ok(measured)
}

/// Adds the iterations that started at `from_ns` or later and before `to_ns`.
async fn add_iterations(
    readers: &Readers,
    run: i64,
    (from_ns, to_ns): (i64, i64),
    measured: &mut MeasuredWithin,
) -> Result<(), StoreError> {
    if from_ns >= to_ns {
        return Ok(());
    }
    // Iterations are numbered in the order of their starts, so the iterations of a period have consecutive numbers.
    let first_number = async |time_ns: i64| {
        let number: Option<i64> = sqlx::query_scalar(sql::FIRST_NUMBER_SINCE)
            .bind(run)
            .bind(time_ns)
            .fetch_one(&readers.pool())
            .await
            .map_err(readers.error_for(WHAT))?;
        Ok(number)
    };
    let (Some(from), Some(end)) = (first_number(from_ns).await?, first_number(to_ns).await?) else {
        return Ok(());
    };
    let totals: Vec<Option<f64>> = sqlx::query_scalar(sql::TOTALS_IN_STATISTICS)
        .bind(run)
        .bind(from)
        .bind(end - 1)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    measured.count += totals.len() as u64;
    totals.into_iter().flatten().for_each(|total| measured.totals.record(total));
    Ok(())
}

/// Divides a range of whole seconds into buckets of the stored widths, each as wide as possible. Returns for each range
/// of buckets of one width: the width, the start of the first bucket, and the end of the last bucket.
fn widest_buckets((mut first_s, mut end_s): (i64, i64)) -> Vec<(i64, i64, i64)> {
    let mut ranges = Vec::new();
    for (index, width_s) in WIDTHS_S.into_iter().enumerate() {
        let wider = WIDTHS_S.get(index + 1).map(|wider_s| {
            (-(-first_s).div_euclid(*wider_s) * wider_s, end_s.div_euclid(*wider_s) * wider_s)
        });
        let Some((next_first_s, next_end_s)) = wider.filter(|(first_s, end_s)| first_s < end_s) else {
            ranges.push((width_s, first_s, end_s));
            break;
        };
        ranges.extend([(width_s, first_s, next_first_s), (width_s, next_end_s, end_s)]);
        (first_s, end_s) = (next_first_s, next_end_s);
    }
    ranges.retain(|(_, first_s, end_s)| first_s < end_s);
    ranges
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buckets_are_as_wide_as_possible() {
        assert_eq!(widest_buckets((3, 9)), [(1, 3, 9)]);
        let expected =
            [(1, 58, 60), (1, 7_270, 7_271), (10, 7_260, 7_270), (60, 60, 3_600), (60, 7_200, 7_260)];
        let mut ranges = widest_buckets((58, 7_271));
        let seconds: i64 = ranges.iter().map(|(_, first_s, end_s)| end_s - first_s).sum();
        assert_eq!(seconds, 7_271 - 58);
        ranges.retain(|(width_s, ..)| *width_s < 3_600);
        assert_eq!(ranges, expected);
    }
}
