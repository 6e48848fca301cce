//! Episodes, warm-up and failed iterations of a run. They are computed from single rows of iterations, which are found
//! by number. The number of rows that are read does not depend on the length of the run.

use std::collections::HashMap;

use peernet_analysis::warm_up::warm_up_periods;
use peernet_clock::WallTime;

use super::iterations::Row;
use super::{corrupt_data, sql, wall};
use crate::error::StoreError;
use crate::readers::Readers;
use crate::types::Episodes;

/// Name of the requested data in errors.
const WHAT: &str = "episodes";
/// Number of iterations among which the end of a period of warm-up is searched.
const MAX_WARM_UP: i64 = 10_000;

pub(crate) async fn episodes(readers: &Readers, run: i64) -> Result<Episodes, StoreError> {
    let first = first_row(readers, run).await?;
    let last = last_row(readers, run).await?;
    let Some((first, last)) = first.zip(last) else { return Ok(Episodes::default()) };
    let mut steps = steps(&last);
    let mut borders = Vec::new();
    if last.episode <= Episodes::MAX_BORDERS {
        if let Some(steps) = steps {
            let expected_numbers = (1..=i64::from(last.episode)).map(|episode| episode * steps + 1);
            borders = rows_by_number(readers, run, &expected_numbers.collect::<Vec<_>>()).await?;
        }
        let is_border = |row: &Row, steps: i64| row.step == 0 && first_number(row, steps) == row.number;
        // An actuator may end episodes before their last step; then they have different lengths.
        if steps.is_none_or(|steps| borders.iter().any(|row| !is_border(row, steps))) {
            steps = None;
            borders = rows_by_number(readers, run, &first_numbers(readers, run, &last).await?).await?;
            borders.retain(|row| row.step == 0);
        }
    }
    let warm_up = read_warm_up_periods(readers, run, &first, &borders, &last).await?;
    let (failed_starts, failed_count) = failed_iterations(readers, run, last.number).await?;
    let start_times = |rows: Vec<Row>| rows.iter().map(|row| wall(row.started_ns)).collect();
    Ok(Episodes {
        first: (first.number == 1).then(|| wall(first.started_ns)),
        count: u64::from(last.episode) + 1,
        steps: steps.and_then(|steps| u64::try_from(steps).ok()),
        borders: start_times(borders),
        warm_up,
        failed_starts: start_times(failed_starts),
        failed_count,
    })
}

/// Returns the start of the first iteration after the warm-up; `None` if the beginning of the run is not stored.
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
    let end = first_measured_numbers(readers, run, &[first.number])
        .await?
        .into_iter()
        .flatten()
        .collect::<Vec<_>>();
    Ok(rows_by_number(readers, run, &end).await?.first().map(|row| wall(row.started_ns)))
}

/// Returns the start of the last iteration that is not warm-up. `None` if the run ended with more than [`MAX_WARM_UP`]
/// iterations of warm-up.
pub(super) async fn last_measured_start(readers: &Readers, run: i64) -> Result<Option<WallTime>, StoreError> {
    let Some(last) = last_row(readers, run).await? else { return Ok(None) };
    if !last.warm_up {
        return Ok(Some(wall(last.started_ns)));
    }
    // Each episode begins with a warm-up, so a run can end in one.
    let query =
        sqlx::query_as(sql::LAST_MEASURED).bind(run).bind(last.number - MAX_WARM_UP).bind(last.number);
    let row: Option<Row> = query.fetch_optional(&readers.pool()).await.map_err(readers.failed(WHAT))?;
    Ok(row.map(|row| wall(row.started_ns)))
}

/// Returns the starts of failed iterations, as charts mark them.
pub(super) async fn failed_starts(readers: &Readers, run: i64) -> Result<Vec<WallTime>, StoreError> {
    let Some(last) = last_row(readers, run).await? else { return Ok(Vec::new()) };
    let (rows, _) = failed_iterations(readers, run, last.number).await?;
    Ok(rows.iter().map(|row| wall(row.started_ns)).collect())
}

/// Returns the stored iteration with the largest number.
async fn last_row(readers: &Readers, run: i64) -> Result<Option<Row>, StoreError> {
    let last = sqlx::query_as(sql::LAST_ITERATION).bind(run);
    last.fetch_optional(&readers.pool()).await.map_err(readers.failed(WHAT))
}

/// Returns the first stored iteration.
async fn first_row(readers: &Readers, run: i64) -> Result<Option<Row>, StoreError> {
    let first = sqlx::query_as(sql::ITERATIONS).bind(run).bind(0).bind(1);
    first.fetch_optional(&readers.pool()).await.map_err(readers.failed(WHAT))
}

/// Returns the number of the first iteration of an iteration's episode.
fn first_number(row: &Row, steps: i64) -> i64 {
    i64::from(row.episode) * steps + 1
}

/// Returns the number of iterations per episode, which follows from an iteration's number, episode and step. Returns
/// `None` for an iteration of the first episode, and if no number of steps agrees with the values.
fn steps(row: &Row) -> Option<i64> {
    let (episode, step) = (i64::from(row.episode), i64::from(row.step));
    // Number of iterations in all earlier episodes.
    let earlier_iterations = row.number - 1 - step;
    let steps = earlier_iterations.checked_div(episode)?;
    (steps > step && steps * episode == earlier_iterations).then_some(steps)
}

/// Returns the number of the first stored iteration of each episode, except for the first episode. The numbers are
/// found by one common bisection, so the number of queries grows only with the logarithm of the run's length.
async fn first_numbers(readers: &Readers, run: i64, last: &Row) -> Result<Vec<i64>, StoreError> {
    // For each episode: a number before the first iteration of the episode or of a later episode, and a number at or
    // after this iteration. Retention deletes the oldest iterations, so a missing iteration is before the stored
    // iterations.
    let mut ends: Vec<(i64, i64)> = (1..=last.episode).map(|_| (0, last.number)).collect();
    while ends.iter().any(|(before, at)| before + 1 < *at) {
        let middles: Vec<i64> = ends.iter().map(|(before, at)| before + (at - before) / 2).collect();
        let known: HashMap<i64, u32> = rows_by_number(readers, run, &middles)
            .await?
            .into_iter()
            .map(|row| (row.number, row.episode))
            .collect();
        for (episode, ((before, at), middle)) in (1..).zip(ends.iter_mut().zip(middles)) {
            let has_begun = known.get(&middle).is_some_and(|known| *known >= episode);
            if has_begun { *at = middle } else { *before = (*before).max(middle) }
        }
    }
    Ok(ends.into_iter().map(|(_, at)| at).collect())
}

/// Returns the periods of warm-up at the start of a run and of the episodes that begin at `borders`.
async fn read_warm_up_periods(
    readers: &Readers,
    run: i64,
    first: &Row,
    borders: &[Row],
    last: &Row,
) -> Result<Vec<(WallTime, WallTime)>, StoreError> {
    // Without its first iteration, it is not known where the first period begins.
    let begins = std::iter::once(first).filter(|first| first.number == 1).chain(borders);
    let begins: Vec<&Row> = begins.filter(|row| row.warm_up).collect();
    let numbers: Vec<i64> = begins.iter().map(|row| row.number).collect();
    let ends = first_measured_numbers(readers, run, &numbers).await?;
    let end_rows = rows_by_number(readers, run, &ends.iter().copied().flatten().collect::<Vec<_>>()).await?;
    let is_known = |end: &Option<i64>| end.is_some() || last.warm_up;
    let begins = begins.into_iter().zip(&ends).filter(|(_, end)| is_known(end)).map(|(begin, _)| begin);
    let mut rows: Vec<&Row> = begins.chain(&end_rows).chain([last]).collect();
    rows.sort_by_key(|row| row.number);
    Ok(warm_up_periods(rows.into_iter().map(|row| (wall(row.started_ns), row.warm_up))))
}

/// For each of these numbers, returns the number of the first iteration from there on that is not warm-up; `None` if
/// none of the next [`MAX_WARM_UP`] iterations is such an iteration.
async fn first_measured_numbers(
    readers: &Readers,
    run: i64,
    numbers: &[i64],
) -> Result<Vec<Option<i64>>, StoreError> {
    sqlx::query_scalar(sql::WARM_UP_ENDS)
        .bind(run)
        .bind(json(numbers)?)
        .bind(MAX_WARM_UP)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.failed(WHAT))
}

/// Returns the failed iterations that charts mark, and the number of all failed iterations. The number is at most one
/// more than `MAX_COUNTED`, which then means "more than that".
async fn failed_iterations(readers: &Readers, run: i64, last: i64) -> Result<(Vec<Row>, u64), StoreError> {
    let max_marked = Episodes::MAX_FAILED;
    let failed: Vec<Row> = sqlx::query_as(sql::ITERATIONS_WITHOUT_ANSWER)
        .bind(run)
        .bind(0)
        .bind(i64::try_from(max_marked).map_or(i64::MAX, |max_marked| max_marked + 1))
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.failed(WHAT))?;
    let Some(first) = failed.first().filter(|_| failed.len() > max_marked) else {
        let total = failed.len() as u64;
        return Ok((failed, total));
    };
    let total: i64 = sqlx::query_scalar(sql::COUNT_WITHOUT_ANSWER)
        .bind(run)
        .bind(i64::try_from(Episodes::MAX_COUNTED).map_or(i64::MAX, |max_counted| max_counted + 1))
        .fetch_one(&readers.pool())
        .await
        .map_err(readers.failed(WHAT))?;
    let numbers: Vec<Option<i64>> = sqlx::query_scalar(sql::FIRST_WITHOUT_ANSWER)
        .bind(run)
        .bind(json(&parts(first.number, last, max_marked as i64))?)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.failed(WHAT))?;
    let marked = rows_by_number(readers, run, &numbers.into_iter().flatten().collect::<Vec<_>>()).await?;
    // Rows may have been added or deleted between the queries, so the two numbers may disagree.
    let total = u64::try_from(total).unwrap_or_default().max(marked.len() as u64);
    Ok((marked, total))
}

/// Divides the numbers from `from` to `to` into at most `count` parts. Each part is given by its first and last number.
fn parts(from: i64, to: i64, count: i64) -> Vec<(i64, i64)> {
    let edge = |part: i64| from + ((to - from + 1) as f64 * part as f64 / count as f64) as i64;
    (0..count).map(|part| (edge(part), edge(part + 1) - 1)).filter(|(from, to)| from <= to).collect()
}

/// Reads the iterations with these numbers.
async fn rows_by_number(readers: &Readers, run: i64, numbers: &[i64]) -> Result<Vec<Row>, StoreError> {
    sqlx::query_as(sql::ITERATIONS_OF)
        .bind(run)
        .bind(json(numbers)?)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.failed(WHAT))
}

/// Converts a list to JSON, the form in which statements take a list.
fn json(list: &(impl serde::Serialize + ?Sized)) -> Result<String, StoreError> {
    serde_json::to_string(list).map_err(|error| corrupt_data(WHAT, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_contain_each_number_once() {
        for (from, to, count) in [(1, 301, 300), (5, 5, 3), (900, 10_000_000, 300)] {
            let parts = parts(from, to, count);
            assert!(parts.len() <= count as usize);
            assert_eq!((parts[0].0, parts[parts.len() - 1].1), (from, to));
            assert!(parts.windows(2).all(|pair| pair[0].1 + 1 == pair[1].0), "{parts:?}");
        }
    }
}
