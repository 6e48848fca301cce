//! Tests of spooled events, which survive the end of the agent, an absent aggregator and failures of the disk.

mod crash;
mod full;
mod identity;
mod trouble;

use std::path::Path;

use peernet_agent::AgentConfig;
use peernet_stream::{Event, codec};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};

use crate::harness::{Aggregator, StateDir, config};

/// Returns the configuration of an agent with a pipeline of small samples.
fn pipeline(keys: &str) -> AgentConfig {
    config(&format!(
        "[agent]\nbatch_delay_ms = 20\nbatch_nodes = 500\n[[model]]\nname = 'echo'\nkind = 'echo'\n\
         [[pipeline]]\nname = 'line'\nsensor = {{ kind = 'synthetic', size_bytes = 100 }}\n\
         warm_up = {{ iterations = 0 }}\nplacement = {{ kind = 'local', model = 'echo' }}\n{keys}"
    ))
}

/// Returns the configuration of an agent without a pipeline.
fn idle_config() -> AgentConfig {
    config("")
}

/// Returns a free address and the empty received events, for an aggregator that starts later.
async fn address_without_aggregator()
-> (String, std::sync::Arc<tokio::sync::watch::Sender<crate::harness::ReceivedEvents>>) {
    Aggregator::start().await.stop().await
}

/// Returns all events in a spool that no agent uses, in order.
async fn spooled_events(file: &Path) -> Vec<Event> {
    let options = SqliteConnectOptions::new().filename(file).disable_statement_logging();
    let mut connection = options.connect().await.expect("opens");
    let rows: Vec<(u32, Vec<u8>)> = sqlx::query_as("SELECT events, body FROM batch ORDER BY number")
        .fetch_all(&mut connection)
        .await
        .expect("reads");
    connection.close().await.expect("closes");
    let events = |(events, body): &(u32, Vec<u8>)| codec::decode_events(body, *events).expect("events");
    rows.iter().flat_map(events).collect()
}

/// Returns a state directory for an agent, and for the agents that are started after its end.
fn state() -> StateDir {
    StateDir::new(tempfile::tempdir().expect("a folder"))
}
