//! Tests that a run's description contains the conditions of both hosts.

use peernet_stream::Condition;

use crate::harness::{Aggregator, TestAgent};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn run_has_conditions_of_both_hosts() {
    let aggregator = Aggregator::start().await;
    let cloud = "[serve]\nlisten = 'tcp://127.0.0.1:0'\n[[model]]\nname = 'echo'\nkind = 'echo'\n";
    let cloud = TestAgent::start("cloud", None, cloud).await;
    let pipeline = format!(
        "[[pipeline]]\nname = 'line'\nsensor = {{ kind = 'synthetic', size_bytes = 10 }}\n\
         placement = {{ kind = 'remote', peer = '{}', model = 'echo' }}\nlimit = {{ iterations = 5 }}\n",
        cloud.address()
    );
    let edge = TestAgent::start("edge", Some(&aggregator.address), &pipeline).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    let found: &[Condition] = &received_events.run_starts()[0].conditions;
    for (host, about) in [
        ("edge", "CPU governor"),
        ("edge", "competing load"),
        ("edge", "machine"),
        ("cloud", "CPU governor"),
        ("cloud", "competing load"),
    ] {
        let named = found.iter().any(|condition| condition.host == host && condition.about == about);
        assert!(named, "nothing about {about} of {host}: {found:#?}");
    }
    // The edge has a spool, because there is an aggregator; the cloud has none.
    let disks: Vec<&Condition> = found.iter().filter(|condition| condition.about == "free disk").collect();
    assert!(
        matches!(disks.as_slice(), [condition] if condition.host == "edge" && condition.found.contains("spool")),
        "{disks:?}"
    );
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}
