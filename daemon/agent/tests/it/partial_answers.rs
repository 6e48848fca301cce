//! Tests of partial answers of a Python model on a cloud whose network accepts less than the model yields.

use peernet_stream::{Iteration, Outcome};

use crate::harness::{Aggregator, TestAgent, value};

/// `Fitting` and `Oversized` yield many more partial answers than may be unread. The partial answers of `Fitting` fill
/// the send queue; the partial answers of `Oversized` are larger than a message. `Stalling` sends three partial
/// answers, and then takes longer than the time limit.
const MODELS: &str = "
class Fitting:
    def infer(self, x):
        for part in range(200): yield bytes(60_000)
        return 'ok'
class Oversized:
    def infer(self, x):
        for part in range(200): yield bytes(100_000)
        return 'ok'
class Stalling:
    def infer(self, x):
        import time
        for part in range(3): yield 'a'
        time.sleep(2)
        return 'ok'
";

/// Runs two iterations with a model of [`MODELS`]. Messages have at most 64 KiB.
async fn run(object: &str, keys: &str) -> Vec<Iteration> {
    let folder = tempfile::tempdir().expect("can be made");
    std::fs::write(folder.path().join("own.py"), MODELS).expect("can be written");
    let aggregator = Aggregator::start().await;
    let tables = format!(
        "[serve]\nlisten = 'tcp://127.0.0.1:0'\nsession = {{ max_message_bytes = 65536 }}\n\
         [[model]]\nname = 'own'\nkind = 'python'\nobject = 'own::{object}'\nfolder = '{}'\n",
        folder.path().display()
    );
    let cloud = TestAgent::start("cloud", None, &tables).await;
    let tables = format!(
        "[[pipeline]]\nname = 'line'\nsensor = {{ kind = 'text', length = 20 }}\n\
         placement = {{ kind = 'remote', peer = '{}', model = 'own', session = {{ max_message_bytes = 65536 }} }}\n\
         warm_up = {{ iterations = 0 }}\nlimit = {{ iterations = 2 }}\n{keys}\n",
        cloud.address()
    );
    let edge = TestAgent::start("edge", Some(&aggregator.address), &tables).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
    received_events.iterations().into_iter().cloned().collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_partial_answer_arrives_through_full_queue() {
    let iterations = run("Fitting", "").await;
    assert_eq!(iterations.len(), 2);
    for iteration in iterations {
        assert_eq!(iteration.outcome, Outcome::Ok);
        assert_eq!(value(&iteration.tree, "parts"), Some(200.0));
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn oversized_partial_answer_fails_iteration_with_key_and_size() {
    let iterations = run("Oversized", "").await;
    assert_eq!(iterations.len(), 2);
    for iteration in iterations {
        let Outcome::Failed(reason) = &iteration.outcome else { panic!("{:?}", iteration.outcome) };
        for part in ["model own failed", "100000 bytes", "max_message_bytes", "65536"] {
            assert!(reason.contains(part), "{reason}");
        }
        assert_eq!(value(&iteration.tree, "parts"), None);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn timeout_keeps_partial_answers_that_arrived() {
    let iterations = run("Stalling", "timeout_ms = 1500").await;
    let first =
        iterations.iter().min_by_key(|iteration| iteration.number).expect("the iterations are recorded");
    let Outcome::Timeout(reason) = &first.outcome else { panic!("{:?}", first.outcome) };
    assert!(reason.contains("after partial answer 3: if it needs longer"), "{reason}");
    assert_eq!(value(&first.tree, "parts"), Some(3.0));
    let first_part = value(&first.tree, "first-part").expect("is recorded");
    assert!(first_part > 0.0 && first_part < 1.5, "{first_part}");
}
