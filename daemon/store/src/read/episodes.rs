//! What stands beside the course of a run over time, from single rows of iterations: how many are read does not depend on
//! the length of the run.

use super::iterations::Row;
use super::{corrupt, sql, wall};
use crate::error::StoreError;
use crate::readers::Readers;
use crate::types::Episodes;

const WHAT: &str = "episodes";
/// Iterations among which the end of the warm-up is looked for.
const WARM_UP: i64 = 10_000;

pub(crate) async fn episodes(readers: &Readers, run: i64) -> Result<Episodes, StoreError> {
    let first: Option<Row> = sqlx::query_as(sql::ITERATIONS)
        .bind(run)
        .bind(0)
        .bind(1)
        .fetch_optional(&readers.pool())
        .await
        .map_err(readers.failed(WHAT))?;
    let last: Option<Row> = sqlx::query_as(sql::LAST_ITERATION)
        .bind(run)
        .fetch_optional(&readers.pool())
        .await
        .map_err(readers.failed(WHAT))?;
    let Some((first, last)) = first.zip(last) else { return Ok(Episodes::default()) };
    let steps = steps(&last);
    let borders = match steps {
        Some(steps) if last.episode <= Episodes::MOST_BORDERS => {
            let begins = (1..=i64::from(last.episode)).map(|episode| episode * steps + 1);
            let rows = rows(readers, run, &begins.collect::<Vec<_>>()).await?;
            rows.into_iter().filter(|row| row.step == 0 && begin(row, steps) == row.number).collect()
        }
        _ => Vec::new(),
    };
    let (unanswered, without_answer) = unanswered(readers, run, last.number).await?;
    let began = |rows: Vec<Row>| rows.iter().map(|row| wall(row.started_ns)).collect();
    Ok(Episodes {
        first: (first.number == 1).then(|| wall(first.started_ns)),
        count: u64::from(last.episode) + 1,
        steps: steps.and_then(|steps| u64::try_from(steps).ok()),
        borders: began(borders),
        warm_up_until: warm_up(readers, run, &first).await?.map(|row| wall(row.started_ns)),
        unanswered: began(unanswered),
        without_answer,
    })
}

/// Where the episode of an iteration begins.
fn begin(row: &Row, steps: i64) -> i64 {
    i64::from(row.episode) * steps + 1
}

/// Iterations of an episode, which follow from a number and its place; `None` in the first episode, and for a place that
/// no number of steps explains.
fn steps(row: &Row) -> Option<i64> {
    let (episode, step) = (i64::from(row.episode), i64::from(row.step));
    let before = row.number - 1 - step;
    let steps = before.checked_div(episode)?;
    (steps > step && steps * episode == before).then_some(steps)
}

/// The first iteration behind the warm-up that a run begins with.
async fn warm_up(readers: &Readers, run: i64, first: &Row) -> Result<Option<Row>, StoreError> {
    if first.number != 1 || !first.warm_up {
        return Ok(None);
    }
    let end = sqlx::query_as(sql::WARM_UP_END).bind(run).bind(WARM_UP);
    end.fetch_optional(&readers.pool()).await.map_err(readers.failed(WHAT))
}

/// Those that are marked, and how many there are, one more than are counted where there are more.
async fn unanswered(readers: &Readers, run: i64, last: i64) -> Result<(Vec<Row>, u64), StoreError> {
    let most = Episodes::MOST_UNANSWERED;
    let found: Vec<Row> = sqlx::query_as(sql::ITERATIONS_WITHOUT_ANSWER)
        .bind(run)
        .bind(0)
        .bind(i64::try_from(most).map_or(i64::MAX, |most| most + 1))
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.failed(WHAT))?;
    let Some(first) = found.first().filter(|_| found.len() > most) else {
        let all = found.len() as u64;
        return Ok((found, all));
    };
    let all: i64 = sqlx::query_scalar(sql::COUNT_WITHOUT_ANSWER)
        .bind(run)
        .bind(i64::try_from(Episodes::MOST_COUNTED).map_or(i64::MAX, |most| most + 1))
        .fetch_one(&readers.pool())
        .await
        .map_err(readers.failed(WHAT))?;
    let numbers: Vec<Option<i64>> = sqlx::query_scalar(sql::FIRST_WITHOUT_ANSWER)
        .bind(run)
        .bind(json(&parts(first.number, last, most as i64))?)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.failed(WHAT))?;
    let marked = rows(readers, run, &numbers.into_iter().flatten().collect::<Vec<_>>()).await?;
    // Between the two questions retention may have deleted some.
    let all = u64::try_from(all).unwrap_or_default().max(marked.len() as u64);
    Ok((marked, all))
}

/// Numbers from one to another in so many parts, each by its ends.
fn parts(from: i64, to: i64, count: i64) -> Vec<(i64, i64)> {
    let edge = |part: i64| from + ((to - from + 1) as f64 * part as f64 / count as f64) as i64;
    (0..count).map(|part| (edge(part), edge(part + 1) - 1)).filter(|(from, to)| from <= to).collect()
}

async fn rows(readers: &Readers, run: i64, numbers: &[i64]) -> Result<Vec<Row>, StoreError> {
    sqlx::query_as(sql::ITERATIONS_OF)
        .bind(run)
        .bind(json(numbers)?)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.failed(WHAT))
}

/// As statements take lists.
fn json(list: &(impl serde::Serialize + ?Sized)) -> Result<String, StoreError> {
    serde_json::to_string(list).map_err(|error| corrupt(WHAT, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_hold_every_number_once() {
        for (from, to, count) in [(1, 301, 300), (5, 5, 3), (900, 10_000_000, 300)] {
            let parts = parts(from, to, count);
            assert!(parts.len() <= count as usize);
            assert_eq!((parts[0].0, parts[parts.len() - 1].1), (from, to));
            assert!(parts.windows(2).all(|pair| pair[0].1 + 1 == pair[1].0), "{parts:?}");
        }
    }
}
