//! Tests that a link exists as long as its sessions.

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;

use peernet_clock::{DelaySource, Span, Verdict};
use peernet_logger::Slug;
use peernet_stream::Probing;

use super::{CLOUD, pipeline};
use crate::harness::{Aggregator, TestAgent, config};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pipelines_to_one_cloud_share_link_until_last_ends() {
    let cloud = TestAgent::start_with_clock_name("cloud", None, config(CLOUD), "cloud").await;
    let short = pipeline("short", &cloud, "load = { mode = 'rate', hz = 50.0 }\nlimit = { iterations = 50 }");
    let long = pipeline("long", &cloud, "load = { mode = 'rate', hz = 50.0 }\nlimit = { iterations = 150 }");
    let edge =
        TestAgent::start_with_clock_name("edge", None, config(&format!("{short}{long}")), "edge").await;
    let names = |pipelines: &[Slug]| pipelines.iter().map(ToString::to_string).collect::<Vec<_>>();

    let live = edge.until(|live| live.links.iter().any(|link| link.pipelines.len() == 2)).await;
    let [link] = &live.links[..] else { panic!("{:?}", live.links) };
    assert_eq!((link.peer_name.as_str(), link.same_clock), ("cloud", false));
    assert_eq!(
        (names(&link.pipelines), &link.networks[..]),
        (vec!["long".into(), "short".into()], &["zmq-tcp".to_owned()][..])
    );
    assert!(link.edge.is_some() && link.cloud.is_some());

    let live = edge.until(|live| live.links.iter().any(|link| link.latest_sample.probes.answered > 0)).await;
    let Probing::On { address, rate_hz, stamps } = &live.links[0].probing else { panic!("{:?}", live.links) };
    assert!(address.starts_with("udp://127.0.0.1:") && !stamps.is_empty(), "{address} {stamps}");
    assert_eq!(*rate_hz, 10.0);

    let live = edge.until(|live| live.links.iter().any(|link| link.pipelines.len() == 1)).await;
    assert_eq!(names(&live.links[0].pipelines), ["long"]);
    edge.until(|live| live.links.is_empty()).await;
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn same_clock_is_recognised_and_probed_rarely() {
    let cloud = TestAgent::start("cloud", None, CLOUD).await;
    let tables = pipeline("line", &cloud, "load = { mode = 'rate', hz = 50.0 }");
    let edge = TestAgent::start("edge", None, &tables).await;
    let live = edge.until(|live| live.links.iter().any(|link| link.latest_sample.probes.answered > 0)).await;
    let link = &live.links[0];
    assert!(link.same_clock);
    assert!(matches!(link.probing, Probing::On { rate_hz: 1.0, .. }), "{:?}", link.probing);
    let offset = link.latest_sample.offset.as_ref().expect("known");
    assert_eq!((offset.estimate, offset.source), (Span::ZERO, DelaySource::SameClock));
    assert_eq!(offset.verdict, Verdict::Ok);
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn each_network_of_pair_has_all_probe_results() {
    let aggregator = Aggregator::start().await;
    let listen = "[serve]\nlisten = ['tcp://127.0.0.1:0', 'udp://127.0.0.1:0']\n[[model]]\nname = 'echo'\nkind = 'echo'\n";
    let cloud = TestAgent::start_with_clock_name("cloud", None, config(listen), "cloud").await;
    let [tcp, udp] = cloud.running.serve_addresses() else {
        panic!("two addresses: {:?}", cloud.running.serve_addresses())
    };
    let pipeline = |name: &str, address: &dyn std::fmt::Display| {
        format!(
            "[[pipeline]]\nname = '{name}'\nsensor = {{ kind = 'synthetic', size_bytes = 2000 }}\n\
             placement = {{ kind = 'remote', peer = '{address}', model = 'echo' }}\n\
             load = {{ mode = 'rate', hz = 50.0 }}\n"
        )
    };
    // Only the edge has the key, so no probe is answered, and many probes are in flight when a session ends.
    let folder = tempfile::tempdir().expect("a folder");
    let key = folder.path().join("key");
    std::fs::write(&key, "0123456789abcdef0123456789abcdef\n").expect("written");
    std::fs::set_permissions(&key, Permissions::from_mode(0o600)).expect("this user owns the file");
    let probes = format!("[probes]\nrate_hz = 50.0\nkey_file = '{}'\n", key.display());
    let tables = format!("{probes}{}{}", pipeline("first", tcp), pipeline("second", udp));
    let edge =
        TestAgent::start_with_clock_name("edge", Some(&aggregator.address), config(&tables), "edge").await;
    edge.until(|live| {
        live.links.len() == 2 && live.links.iter().all(|link| link.latest_sample.probes.lost > 0)
    })
    .await;
    // Both sessions end, one a little earlier.
    edge.stop().await.expect("stops well");
    let received_events = aggregator.until(|received_events| !received_events.goodbyes.is_empty()).await;
    for network in ["zmq-tcp", "zmq-udp"] {
        let (mut sent, mut answered_or_lost) = (0, 0);
        for sample in
            received_events.clock_samples().iter().filter(|sample| sample.network.to_string() == network)
        {
            sent += sample.probes.sent;
            answered_or_lost += sample.probes.answered + sample.probes.lost;
        }
        // About a hundred probes are in flight at the end (2 s at 50 Hz). A few probes were sent in the second before
        // one of the sessions began.
        assert!(
            sent > 50 && sent.abs_diff(answered_or_lost) < 10,
            "{network}: {sent} sent, {answered_or_lost} answered or lost"
        );
    }
    cloud.stop().await.expect("stops well");
}
