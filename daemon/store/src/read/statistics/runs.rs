//! Statistics of whole runs, any number of them in two statements: a statement for each run would cost more than its rows.

use std::collections::HashMap;

use futures::TryStreamExt as _;
use peernet_clock::Verdict;
use peernet_logger::Name;

use super::super::{corrupt_data, count, sql};
use super::{RollupRow, WHAT, list};
use crate::error::StoreError;
use crate::readers::Readers;
use crate::types::{MergeableStatistics, RunStatistics};

pub(crate) async fn statistics(readers: &Readers, runs: &[i64]) -> Result<Vec<RunStatistics>, StoreError> {
    let list = list(runs)?;
    let mut found = HashMap::<i64, MergeableStatistics>::new();
    let pool = readers.pool();
    let mut rows = sqlx::query_as::<_, RollupRow>(sql::ROLLUPS).bind(&list).fetch(&pool);
    while let Some(row) = rows.try_next().await.map_err(readers.failed(WHAT))? {
        let summary = row.summary()?;
        let (known, name) = (found.entry(row.run).or_default(), Name::from(row.text));
        match row.quantity {
            0 => known.add(name, &row.unit, &summary),
            _ => known.add_half_widths(name, &summary),
        }
    }
    drop(rows);
    let verdicts: Vec<(i64, String, i64, i64)> = sqlx::query_as(sql::VERDICTS)
        .bind(&list)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.failed(WHAT))?;
    for (run, text, number, times) in verdicts {
        let verdict = usize::try_from(number).ok().and_then(|at| Verdict::ALL.get(at).copied());
        let verdict = verdict.ok_or_else(|| corrupt_data(WHAT, format_args!("verdict {number}")))?;
        found.entry(run).or_default().add_verdicts(Name::from(text), verdict, count(times));
    }
    let found: HashMap<i64, RunStatistics> =
        found.into_iter().map(|(run, kept)| (run, RunStatistics::from(kept))).collect();
    Ok(runs.iter().map(|run| found.get(run).cloned().unwrap_or_default()).collect())
}
