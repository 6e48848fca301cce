//! Tests of the start: an error states the object, the place and the remedy.

use std::sync::Arc;

use peernet_aggregator::{Aggregator, AggregatorConfig, StartError};
use peernet_store::OpenError;
use tokio_util::sync::CancellationToken;

use crate::testbed::Testbed;

/// Returns the error of a start with `config`.
async fn start_error(testbed: &Testbed, config: AggregatorConfig) -> StartError {
    let stop = CancellationToken::new();
    Aggregator::start(config, Arc::clone(&testbed.clock), stop).await.expect_err("refuses")
}

#[tokio::test]
async fn port_in_use_is_named_in_error() {
    let mut testbed = Testbed::new().await;
    let config =
        AggregatorConfig { database: testbed.database.with_file_name("other.sqlite"), ..testbed.config() };
    let error = start_error(&testbed, config).await;
    assert!(matches!(&error, StartError::Listen { address, .. } if *address == testbed.address));
    assert!(error.to_string().starts_with(&format!("cannot listen on {}: ", testbed.address)), "{error}");
    testbed.stop().await;
}

#[tokio::test]
async fn unusable_database_is_named_in_error() {
    let mut testbed = Testbed::new().await;
    let listen = "tcp://127.0.0.1:0".to_owned();
    // One file is not a database; the other path is below a file.
    let file = testbed.database.with_file_name("notes.txt");
    std::fs::write(&file, "not a database, but long enough to be taken for the header of one by a reader")
        .expect("writes");
    let config = AggregatorConfig { database: file.clone(), listen: listen.clone(), ..testbed.config() };
    let error = start_error(&testbed, config).await;
    assert!(
        matches!(&error, StartError::Database(OpenError::Unrecognised { path, .. }) if *path == file),
        "{error}"
    );
    let path_below_file = file.join("peernet.sqlite");
    let config = AggregatorConfig { database: path_below_file, listen, ..testbed.config() };
    assert_eq!(
        Aggregator::check(&config).iter().map(|problem| problem.key).collect::<Vec<_>>(),
        ["database"]
    );
    let error = start_error(&testbed, config).await;
    assert!(error.to_string().contains("notes.txt is not a folder; choose another path"), "{error}");
    testbed.stop().await;
}

#[tokio::test]
async fn live_state_has_address_and_name() {
    let mut testbed = Testbed::new().await;
    let snapshot = testbed.aggregator().live().borrow().clone();
    assert_eq!(snapshot.aggregator.as_str(), "base");
    assert!(snapshot.listening.starts_with("tcp://127.0.0.1:") && !snapshot.listening.ends_with(":0"));
    assert!(snapshot.hosts.is_empty() && snapshot.pipelines.is_empty());
    testbed.stop().await;
}
