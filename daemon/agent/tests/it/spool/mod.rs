//! Events on the disk: they outlive the agent, its aggregator and its disk's troubles.

mod crash;
mod full;
mod identity;
mod trouble;

use std::path::Path;

use peernet_agent::AgentConfig;
use peernet_stream::{Event, codec};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};

use crate::harness::{Aggregator, State, config};

/// A pipeline that makes small iterations.
fn line(keys: &str) -> AgentConfig {
    config(&format!(
        "[agent]\nbatch_delay_ms = 20\nbatch_nodes = 500\n[[model]]\nname = 'echo'\nkind = 'echo'\n\
         [[pipeline]]\nname = 'line'\nsensor = {{ kind = 'synthetic', size_bytes = 100 }}\n\
         warm_up = {{ iterations = 0 }}\nplacement = {{ kind = 'local', model = 'echo' }}\n{keys}"
    ))
}

/// An agent that measures nothing itself.
fn idle() -> AgentConfig {
    config("")
}

/// An address at which nobody is now, for an aggregator that comes later.
async fn nobody() -> (String, std::sync::Arc<tokio::sync::watch::Sender<crate::harness::Seen>>) {
    Aggregator::start().await.down().await
}

/// All events in a spool that no agent uses, in order.
async fn spooled(file: &Path) -> Vec<Event> {
    let options = SqliteConnectOptions::new().filename(file).disable_statement_logging();
    let mut connection = options.connect().await.expect("opens");
    let rows: Vec<(u32, Vec<u8>)> = sqlx::query_as("SELECT events, body FROM batch ORDER BY number")
        .fetch_all(&mut connection)
        .await
        .expect("reads");
    connection.close().await.expect("closes");
    let events = |(events, body): &(u32, Vec<u8>)| codec::events(body, *events).expect("events");
    rows.iter().flat_map(events).collect()
}

/// A folder for an agent and those after it.
fn state() -> State {
    State::new(tempfile::tempdir().expect("a folder"))
}
