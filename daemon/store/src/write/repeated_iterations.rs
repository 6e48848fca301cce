//! Detection of iterations that are already stored although their batch is new. Two copies of one spool that are used
//! alternately send the same iterations in two streams.
//!
//! The other events of such a batch are stored. Runs and clock samples replace the rows that are already stored.
//! Incidents and gaps cannot be identified as repeated, so they appear twice.

use std::collections::HashSet;

use peernet_logger::RunId;
use sqlx::SqliteConnection;

use super::prepared::PreparedBatch;

/// Selects which iterations of a run are stored: ?1 run, ?2 host, ?3 numbers of the iterations in question, as a JSON
/// array. Each number is looked up by the key of the table.
// With an array, one prepared statement serves any number of iterations.
const STORED: &str = "SELECT iteration.number FROM run \
     JOIN pipeline ON pipeline.id = run.pipeline JOIN host ON host.id = pipeline.host \
     CROSS JOIN json_each(?3) AS requested \
     CROSS JOIN iteration ON iteration.run = run.number AND iteration.number = requested.value \
     WHERE (run.uuid = ?1 OR run.reported_uuid = ?1) AND host.uuid = ?2";

/// Returns the iterations of a batch that are already stored in runs of the same host.
pub(super) async fn find(
    connection: &mut SqliteConnection,
    batch: &PreparedBatch,
) -> Result<HashSet<(RunId, i64)>, sqlx::Error> {
    let mut numbers = vec![Vec::new(); batch.runs.len()];
    for iteration in &batch.iterations {
        numbers[iteration.run as usize].push(iteration.number);
    }
    let mut stored = HashSet::new();
    for (run, numbers) in batch.runs.iter().zip(numbers) {
        let requested = serde_json::to_string(&numbers).map_err(|error| sqlx::Error::Encode(error.into()))?;
        let stored_numbers: Vec<i64> = sqlx::query_scalar(STORED)
            .bind(run.id.to_string())
            .bind(batch.head.host.to_string())
            .bind(requested)
            .fetch_all(&mut *connection)
            .await?;
        stored.extend(stored_numbers.into_iter().map(|number| (run.id, number)));
    }
    Ok(stored)
}
