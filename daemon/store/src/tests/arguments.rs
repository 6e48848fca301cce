//! Arguments of programs in runs that were stored by agents of earlier versions.

use peernet_logger::RunId;
use peernet_stream::{Event, RunDescription};

use super::{Bed, generate};

#[tokio::test]
async fn stored_arguments_are_not_served() {
    let mut bed = Bed::new().await;
    let Event::RunStarted(run) = generate::run_started(RunId::random(), "line", generate::at(0.0)) else {
        panic!("the start of a run")
    };
    let facts = vec![("Sensor".to_owned(), "the program ./light --token hunter2".to_owned())];
    let configuration = "name = 'line'\nsensor = { kind = 'exec', command = './light --token hunter2' }";
    let run = RunDescription { facts, configuration: configuration.to_owned(), ..run };
    let work = bed.batch(vec![Event::RunStarted(run)]);
    bed.commit(&[work]).await;

    let detail = bed.store.run(1).await.expect("answers").expect("exists");
    assert_eq!(detail.facts, [("Sensor".to_owned(), "the program ./light".to_owned())]);
    assert!(detail.configuration.contains("program = \"./light\""), "{}", detail.configuration);
    assert!(!detail.configuration.contains("hunter2"), "{}", detail.configuration);
}
