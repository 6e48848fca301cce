//! Detection of iterations that arrived before under another batch number. Two copies of one spool that are used alternately send
//! the same iterations in two streams.
//!
//! The rest of such a batch is stored unchanged: runs and clock samples replace the same rows; incidents and gaps have
//! nothing to identify them, and appear twice.

use std::collections::HashSet;

use peernet_logger::RunId;
use sqlx::SqliteConnection;

use super::prepared::PreparedBatch;

/// The run's key leads to its iterations one by one.
const STORED: &str = "SELECT iteration.number FROM run \
     JOIN pipeline ON pipeline.id = run.pipeline JOIN host ON host.id = pipeline.host \
     CROSS JOIN json_each(?3) AS asked \
     CROSS JOIN iteration ON iteration.run = run.number AND iteration.number = asked.value \
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
        let searched = serde_json::to_string(&numbers).map_err(|error| sqlx::Error::Encode(error.into()))?;
        let found: Vec<i64> = sqlx::query_scalar(STORED)
            .bind(run.id.to_string())
            .bind(batch.head.host.to_string())
            .bind(searched)
            .fetch_all(&mut *connection)
            .await?;
        stored.extend(found.into_iter().map(|number| (run.id, number)));
    }
    Ok(stored)
}
