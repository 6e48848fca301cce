//! Agents of earlier versions sent the arguments of programs, which may be secrets. The store does not serve them.

use peernet_logger::RunId;
use peernet_stream::{Event, RunDescription};

use super::{TestStore, generate};

#[tokio::test]
async fn stored_arguments_are_not_served() {
    let mut test_store = TestStore::new().await;
    let Event::RunStarted(run) = generate::run_started(RunId::random(), "line", generate::at(0.0)) else {
        panic!("the start of a run")
    };
    let facts = vec![("Sensor".to_owned(), "the program ./light --token hunter2".to_owned())];
    let configuration = "name = 'line'\nsensor = { kind = 'exec', command = './light --token hunter2' }";
    let run = RunDescription { facts, configuration: configuration.to_owned(), ..run };
    let work = test_store.batch(vec![Event::RunStarted(run)]);
    test_store.commit(&[work]).await;

    let detail = test_store.store.run(1).await.expect("answers").expect("exists");
    assert_eq!(detail.facts, [("Sensor".to_owned(), "the program ./light".to_owned())]);
    assert!(detail.configuration.contains("program = \"./light\""), "{}", detail.configuration);
    assert!(!detail.configuration.contains("hunter2"), "{}", detail.configuration);
}
