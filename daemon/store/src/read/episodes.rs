//! Episodes, warm-up and failed iterations of a run. The queries find single iterations by number, so the number of
//! rows that they read hardly depends on the length of the run.

use std::collections::HashMap;

use peernet_analysis::warm_up::warm_up_periods;
use peernet_clock::WallTime;

use super::iterations::Row;
use super::{corrupt_data, sql, wall};
use crate::column::count;
use crate::error::StoreError;
use crate::readers::Readers;
use crate::types::Episodes;

/// Name of the requested data in errors.
const WHAT: &str = "episodes";
/// Number of iterations that are searched for the end of a period of warm-up.
const MAX_WARM_UP: i64 = 10_000;

pub(crate) async fn episodes(readers: &Readers, run: i64) -> Result<Episodes, StoreError> {
    let first = first_row(readers, run).await?;
    let last = last_row(readers, run).await?;
    let Some((first, last)) = first.zip(last) else { return Ok(Episodes::default()) };
    let mut steps = steps_per_episode(&last);
    let mut borders = Vec::new();
    if last.episode <= Episodes::MAX_BORDERS {
        if let Some(steps) = steps {
            let expected_numbers = (1..=i64::from(last.episode)).map(|episode| episode * steps + 1);
            borders = rows_by_number(readers, run, &expected_numbers.collect::<Vec<_>>()).await?;
        }
        let is_border =
            |row: &Row, steps: i64| row.step == 0 && first_number_of_episode(row, steps) == row.number;
        // An actuator may end episodes early; then the episodes have different lengths.
        if steps.is_none_or(|steps| borders.iter().any(|row| !is_border(row, steps))) {
            steps = None;
            borders =
                rows_by_number(readers, run, &first_numbers_of_episodes(readers, run, &last).await?).await?;
            // If the beginning of an episode is not stored, its first stored iteration is a later step.
            borders.retain(|row| row.step == 0);
        }
    }
    let warm_up = read_warm_up_periods(readers, run, &first, &borders, &last).await?;
    let (failed_starts, failed_in_warm_up) = failed_iterations(readers, run, last.number).await?;
    let start_times = |rows: Vec<Row>| rows.iter().map(|row| wall(row.started_ns)).collect();
    Ok(Episodes {
        first: (first.number == 1).then(|| wall(first.started_ns)),
        count: u64::from(last.episode) + 1,
        steps: steps.and_then(|steps| u64::try_from(steps).ok()),
        borders: start_times(borders),
        warm_up,
        failed_starts: start_times(failed_starts),
        failed_in_warm_up,
    })
}

/// Returns the start of the first iteration after the warm-up. `None` if the beginning of the run is not stored, or if
/// no such iteration is found among the first [`MAX_WARM_UP`] iterations.
pub(super) async fn first_measured_start(
    readers: &Readers,
    run: i64,
) -> Result<Option<WallTime>, StoreError> {
    let Some(first) = first_row(readers, run).await?.filter(|first| first.number == 1) else {
        return Ok(None);
    };
    if !first.warm_up {
        return Ok(Some(wall(first.started_ns)));
    }
    let first_measured = first_measured_numbers(readers, run, &[first.number])
        .await?
        .into_iter()
        .flatten()
        .collect::<Vec<_>>();
    Ok(rows_by_number(readers, run, &first_measured).await?.first().map(|row| wall(row.started_ns)))
}

/// Returns the start of the last iteration that is not warm-up. `None` if the run ended with more than [`MAX_WARM_UP`]
/// iterations of warm-up.
pub(super) async fn last_measured_start(readers: &Readers, run: i64) -> Result<Option<WallTime>, StoreError> {
    let Some(last) = last_row(readers, run).await? else { return Ok(None) };
    if !last.warm_up {
        return Ok(Some(wall(last.started_ns)));
    }
    // Each episode may begin with a warm-up, so a run can end during a warm-up.
    let query =
        sqlx::query_as(sql::LAST_MEASURED).bind(run).bind(last.number - MAX_WARM_UP).bind(last.number);
    let row: Option<Row> = query.fetch_optional(&readers.pool()).await.map_err(readers.error_for(WHAT))?;
    Ok(row.map(|row| wall(row.started_ns)))
}

/// Returns the number of episodes before that of the last iteration; `None` if no iteration is stored.
pub(super) async fn earlier_episodes(readers: &Readers, run: i64) -> Result<Option<u64>, StoreError> {
    Ok(last_row(readers, run).await?.map(|row| row.episode.into()))
}

/// Returns the starts of the failed iterations that charts mark.
pub(super) async fn failed_starts(readers: &Readers, run: i64) -> Result<Vec<WallTime>, StoreError> {
    let Some(last) = last_row(readers, run).await? else { return Ok(Vec::new()) };
    let (rows, _) = failed_iterations(readers, run, last.number).await?;
    Ok(rows.iter().map(|row| wall(row.started_ns)).collect())
}

/// Returns the stored iteration with the largest number.
async fn last_row(readers: &Readers, run: i64) -> Result<Option<Row>, StoreError> {
    let last = sqlx::query_as(sql::LAST_ITERATION).bind(run);
    last.fetch_optional(&readers.pool()).await.map_err(readers.error_for(WHAT))
}

/// Returns the stored iteration with the smallest number.
async fn first_row(readers: &Readers, run: i64) -> Result<Option<Row>, StoreError> {
    let first = sqlx::query_as(sql::ITERATIONS).bind(run).bind(0).bind(1);
    first.fetch_optional(&readers.pool()).await.map_err(readers.error_for(WHAT))
}

/// Returns the number of the first iteration of the episode that contains an iteration. Every episode has `steps`
/// iterations.
fn first_number_of_episode(row: &Row, steps: i64) -> i64 {
    i64::from(row.episode) * steps + 1
}

/// Computes the number of iterations per episode from the number, episode and step of one iteration, on the assumption
/// that all episodes have the same length. Returns `None` for an iteration of the first episode, and if no length
/// agrees with these values.
fn steps_per_episode(row: &Row) -> Option<i64> {
    let (episode, step) = (i64::from(row.episode), i64::from(row.step));
    // Number of iterations in all earlier episodes.
    let earlier_iterations = row.number - 1 - step;
    let steps = earlier_iterations.checked_div(episode)?;
    (steps > step && steps * episode == earlier_iterations).then_some(steps)
}

/// Returns the number of the first stored iteration of each episode, except for the first episode. Each query halves
/// the ranges of all episodes at once, so the number of queries grows only with the logarithm of the run's length.
async fn first_numbers_of_episodes(readers: &Readers, run: i64, last: &Row) -> Result<Vec<i64>, StoreError> {
    // The searched iteration of an episode is the first iteration of this or a later episode. For each episode, the
    // list has a number before the searched iteration, and a number at or after it, such that no stored iteration of an
    // earlier episode follows. Iterations that are not stored are skipped, because a run may have gaps.
    let mut ranges: Vec<(i64, i64)> = (1..=last.episode).map(|_| (0, last.number)).collect();
    while ranges.iter().any(|(before, at)| before + 1 < *at) {
        let middles: Vec<i64> = ranges.iter().map(|(before, at)| before + (at - before) / 2).collect();
        let stored = first_stored_numbers(readers, run, &middles).await?;
        let stored_numbers: Vec<i64> = stored.iter().copied().flatten().collect();
        let episodes_by_number: HashMap<i64, u32> = rows_by_number(readers, run, &stored_numbers)
            .await?
            .into_iter()
            .map(|row| (row.number, row.episode))
            .collect();
        for (episode, ((before, at), (middle, stored))) in
            (1..).zip(ranges.iter_mut().zip(middles.into_iter().zip(stored)))
        {
            let found = stored.and_then(|number| episodes_by_number.get(&number));
            if found.is_some_and(|found| *found >= episode) { *at = middle } else { *before = middle }
        }
    }
    let numbers: Vec<i64> = ranges.into_iter().map(|(_, at)| at).collect();
    Ok(first_stored_numbers(readers, run, &numbers).await?.into_iter().flatten().collect())
}

/// Returns, for each of these numbers, the number of the first stored iteration at or after it.
async fn first_stored_numbers(
    readers: &Readers,
    run: i64,
    numbers: &[i64],
) -> Result<Vec<Option<i64>>, StoreError> {
    sqlx::query_scalar(sql::FIRST_STORED)
        .bind(run)
        .bind(to_json(numbers)?)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))
}

/// Returns the periods of warm-up at the start of a run and of the episodes that begin at `borders`.
async fn read_warm_up_periods(
    readers: &Readers,
    run: i64,
    first: &Row,
    borders: &[Row],
    last: &Row,
) -> Result<Vec<(WallTime, WallTime)>, StoreError> {
    // If the run's first iteration is not stored, it is not known where the run's first warm-up begins.
    let warm_up_starts = std::iter::once(first).filter(|first| first.number == 1).chain(borders);
    let warm_up_starts: Vec<&Row> = warm_up_starts.filter(|row| row.warm_up).collect();
    let numbers: Vec<i64> = warm_up_starts.iter().map(|row| row.number).collect();
    let ends = first_measured_numbers(readers, run, &numbers).await?;
    let end_rows = rows_by_number(readers, run, &ends.iter().copied().flatten().collect::<Vec<_>>()).await?;
    // A warm-up without a found end may last until the run's last iteration, if this iteration is warm-up.
    let has_known_end = |end: &Option<i64>| end.is_some() || last.warm_up;
    let warm_up_starts =
        warm_up_starts.into_iter().zip(&ends).filter(|(_, end)| has_known_end(end)).map(|(begin, _)| begin);
    let mut rows: Vec<&Row> = warm_up_starts.chain(&end_rows).chain([last]).collect();
    rows.sort_by_key(|row| row.number);
    Ok(warm_up_periods(rows.into_iter().map(|row| (wall(row.started_ns), row.warm_up))))
}

/// Returns, for each of these numbers, the number of the first iteration at or after it that is not warm-up. `None` if
/// all of the next [`MAX_WARM_UP`] iterations are warm-up.
async fn first_measured_numbers(
    readers: &Readers,
    run: i64,
    numbers: &[i64],
) -> Result<Vec<Option<i64>>, StoreError> {
    sqlx::query_scalar(sql::WARM_UP_ENDS)
        .bind(run)
        .bind(to_json(numbers)?)
        .bind(MAX_WARM_UP)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))
}

/// Returns the failed iterations that charts mark, and the number of all failed iterations of the warm-up. The number
/// is `None` if more than `MAX_COUNTED` iterations failed.
async fn failed_iterations(
    readers: &Readers,
    run: i64,
    last_number: i64,
) -> Result<(Vec<Row>, Option<u64>), StoreError> {
    let max_marked = Episodes::MAX_FAILED;
    let failed: Vec<Row> = sqlx::query_as(sql::FAILED_ITERATIONS)
        .bind(run)
        .bind(0)
        .bind(i64::try_from(max_marked).map_or(i64::MAX, |max_marked| max_marked + 1))
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    let Some(first) = failed.first().filter(|_| failed.len() > max_marked) else {
        let in_warm_up = failed.iter().filter(|row| row.warm_up).count() as u64;
        return Ok((failed, Some(in_warm_up)));
    };
    let (total, in_warm_up): (i64, i64) = sqlx::query_as(sql::FAILED_COUNT)
        .bind(run)
        .bind(i64::try_from(Episodes::MAX_COUNTED).map_or(i64::MAX, |max_counted| max_counted + 1))
        .fetch_one(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    // A chart cannot mark all of them, so it marks the first one of each part of the run.
    let numbers: Vec<Option<i64>> = sqlx::query_scalar(sql::FIRST_FAILED_OF_PARTS)
        .bind(run)
        .bind(to_json(&divide_range(first.number, last_number, max_marked as i64))?)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    let marked = rows_by_number(readers, run, &numbers.into_iter().flatten().collect::<Vec<_>>()).await?;
    Ok((marked, (count(total) <= Episodes::MAX_COUNTED).then(|| count(in_warm_up))))
}

/// Divides the range from `from` to `to` into at most `count` parts. Returns the first and the last number of each
/// part.
fn divide_range(from: i64, to: i64, count: i64) -> Vec<(i64, i64)> {
    let part_start = |part: i64| from + ((to - from + 1) as f64 * part as f64 / count as f64) as i64;
    (0..count)
        .map(|part| (part_start(part), part_start(part + 1) - 1))
        .filter(|(from, to)| from <= to)
        .collect()
}

/// Reads the iterations with these numbers. Iterations that are not stored are absent.
async fn rows_by_number(readers: &Readers, run: i64, numbers: &[i64]) -> Result<Vec<Row>, StoreError> {
    sqlx::query_as(sql::ITERATIONS_BY_NUMBER)
        .bind(run)
        .bind(to_json(numbers)?)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))
}

/// Converts a list to JSON, because statements take lists as JSON.
fn to_json(list: &(impl serde::Serialize + ?Sized)) -> Result<String, StoreError> {
    serde_json::to_string(list).map_err(|error| corrupt_data(WHAT, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn divided_range_contains_each_number_once() {
        for (from, to, count) in [(1, 301, 300), (5, 5, 3), (900, 10_000_000, 300)] {
            let parts = divide_range(from, to, count);
            assert!(parts.len() <= count as usize);
            assert_eq!((parts[0].0, parts[parts.len() - 1].1), (from, to));
            assert!(parts.windows(2).all(|pair| pair[0].1 + 1 == pair[1].0), "{parts:?}");
        }
    }
}
