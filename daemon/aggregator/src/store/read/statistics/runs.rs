//! Whole runs, however many in two statements: a statement of its own for each costs more than its rows.

use std::collections::HashMap;

use futures::TryStreamExt as _;
use peernet_clock::Verdict;
use peernet_logger::{Name, stage};
use peernet_statistics::Summary;

use super::super::{corrupt, count, sql};
use super::{Known, RollupRow, WHAT, list};
use crate::error::StoreError;
use crate::figures::{Bound, Figures, rank};
use crate::store::readers::Readers;
use crate::store::types::{RunStatistics, StageStatistics};

pub(in crate::store) async fn statistics(
    readers: &Readers,
    runs: &[i64],
) -> Result<Vec<RunStatistics>, StoreError> {
    let list = list(runs)?;
    let mut found = HashMap::<i64, Found>::new();
    let mut rows = sqlx::query_as::<_, RollupRow>(sql::ROLLUPS).bind(&list).fetch(&readers.pool);
    while let Some(row) = rows.try_next().await.map_err(readers.failed(WHAT))? {
        found.entry(row.run).or_default().add(row)?;
    }
    drop(rows);
    let verdicts: Vec<(i64, String, i64, i64)> = sqlx::query_as(sql::VERDICTS)
        .bind(&list)
        .fetch_all(&readers.pool)
        .await
        .map_err(readers.failed(WHAT))?;
    for (run, text, number, times) in verdicts {
        let verdict = usize::try_from(number).ok().and_then(|at| Verdict::ALL.get(at).copied());
        let verdict = verdict.ok_or_else(|| corrupt(WHAT, format_args!("verdict {number}")))?;
        let known = found.entry(run).or_default();
        known.verdicts.entry(Name::from(text)).or_default().push((verdict, count(times)));
    }
    Ok(runs.iter().map(|run| found.get(run).map(Found::statistics).unwrap_or_default()).collect())
}

/// What the rows of one run say.
#[derive(Default)]
struct Found {
    values: HashMap<Name, Known>,
    half_widths: HashMap<Name, Summary>,
    verdicts: HashMap<Name, Vec<(Verdict, u64)>>,
}

impl Found {
    /// Takes in a row. A name that was used with several kinds is taken together.
    fn add(&mut self, row: RollupRow) -> Result<(), StoreError> {
        let summary = row.summary()?;
        let name = Name::from(row.text);
        if row.quantity == 0 {
            let fresh = || Known { unit: row.unit, summary: Summary::default() };
            self.values.entry(name).or_insert_with(fresh).summary.merge(&summary);
        } else {
            self.half_widths.entry(name).or_default().merge(&summary);
        }
        Ok(())
    }

    fn statistics(&self) -> RunStatistics {
        let sum = |known: &Known| known.summary.moments.sum();
        let total = self.values.get(stage::TOTAL.as_str()).map(sum).filter(|total| *total > 0.0);
        let stages = self.values.iter().filter_map(|(stage, known)| {
            Some(StageStatistics {
                stage: stage.clone(),
                unit: known.unit.clone(),
                is_stage: stage::ORDER.contains(stage),
                figures: known.figures()?,
                share: total.filter(|_| known.unit == "s").map(|total| sum(known) / total),
                bound: self.bound(stage),
            })
        });
        let mut stages: Vec<StageStatistics> = stages.collect();
        stages.sort_by(|a, b| rank(&a.stage).cmp(&rank(&b.stage)));
        let more = self.half_widths.keys().filter(|name| !self.verdicts.contains_key(*name));
        let mut bounds: Vec<Bound> =
            self.verdicts.keys().chain(more).filter_map(|name| self.bound(name)).collect();
        bounds.sort_by(|a, b| rank(&a.stage).cmp(&rank(&b.stage)));
        RunStatistics { stages, bounds }
    }

    /// How well a one-way delay is known; `None` of what is none.
    fn bound(&self, stage: &Name) -> Option<Bound> {
        let (half_width, verdicts) = (self.half_widths.get(stage), self.verdicts.get(stage));
        (half_width.is_some() || verdicts.is_some()).then(|| Bound {
            stage: stage.clone(),
            half_width: half_width.and_then(Figures::of),
            verdicts: verdicts.cloned().unwrap_or_default(),
        })
    }
}
