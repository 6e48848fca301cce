//! Statistics of any number of whole runs in two statements. A separate statement for each run would take longer
//! than reading the rows of the run.

use std::collections::HashMap;

use futures::TryStreamExt as _;
use peernet_clock::Verdict;
use peernet_logger::Name;
use peernet_statistics::Summary;

use super::super::{corrupt_data, count, sql};
use super::{WHAT, WholeRunRollup, json_array};
use crate::error::StoreError;
use crate::readers::Readers;
use crate::rollups::Quantity;
use crate::types::{MergeableStatistics, RunStatistics};

pub(crate) async fn statistics(readers: &Readers, runs: &[i64]) -> Result<Vec<RunStatistics>, StoreError> {
    let run_list = json_array(runs)?;
    let mut by_run = HashMap::<i64, MergeableStatistics>::new();
    let pool = readers.pool();
    let mut rows = sqlx::query_as::<_, WholeRunRollup>(sql::ROLLUPS).bind(&run_list).fetch(&pool);
    while let Some(row) = rows.try_next().await.map_err(readers.error_for(WHAT))? {
        let summary = row.summary()?;
        let (statistics, name) = (by_run.entry(row.run).or_default(), Name::from(row.text));
        match Quantity::from_number(row.quantity) {
            Some(Quantity::Value) => statistics.add(name, &row.unit, &summary),
            Some(Quantity::HalfWidth) => statistics.add_half_widths(name, &summary),
            Some(Quantity::LowerEnd) => statistics.add_ends(name, [&summary, &Summary::default()]),
            Some(Quantity::UpperEnd) => statistics.add_ends(name, [&Summary::default(), &summary]),
            None => return Err(corrupt_data(WHAT, format_args!("quantity {}", row.quantity))),
        }
    }
    // This returns the connection to the pool, so that the next query can use it. With few connections, queries that
    // hold one connection while they wait for another could block each other.
    drop(rows);
    let verdicts: Vec<(i64, String, i64, i64)> = sqlx::query_as(sql::VERDICTS)
        .bind(&run_list)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    for (run, name, number, delays) in verdicts {
        let verdict = usize::try_from(number).ok().and_then(|number| Verdict::ALL.get(number).copied());
        let verdict = verdict.ok_or_else(|| corrupt_data(WHAT, format_args!("verdict {number}")))?;
        by_run.entry(run).or_default().add_verdicts(Name::from(name), verdict, count(delays));
    }
    let by_run: HashMap<i64, RunStatistics> =
        by_run.into_iter().map(|(run, statistics)| (run, RunStatistics::from(statistics))).collect();
    // The statistics are cloned and not moved, because a run may be requested twice.
    Ok(runs.iter().map(|run| by_run.get(run).cloned().unwrap_or_default()).collect())
}
