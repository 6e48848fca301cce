//! Tests of networks that block probes, and of probe ports that are in use.

use std::fs::Permissions;
use std::net::UdpSocket;
use std::os::unix::fs::PermissionsExt;

use peernet_agent::{Agent, StartError};
use peernet_clock::Verdict;
use peernet_stream::Probing;
use tokio_util::sync::CancellationToken;

use super::{CLOUD, DELAY_NAMES, MAX_STALE_AT_START, assert_interval_contains, delay, pipeline};
use crate::harness::{Aggregator, TestAgent, VERSION, clock, config};

const LOAD: &str = "load = { mode = 'rate', hz = 50.0 }\nmax_in_flight = 4\nlimit = { iterations = 60 }";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn delays_are_bounded_by_data_without_probes() {
    let without_sending = "[probes]\nsend = false\n";
    let without_reflecting = "[probes]\nreflect = false\n";
    for (edge_keys, cloud_keys, reason) in
        [(without_sending, "", "send = false"), ("", without_reflecting, "cloud answers no probes")]
    {
        let aggregator = Aggregator::start().await;
        let cloud =
            TestAgent::start_with_clock_name("cloud", None, config(&format!("{CLOUD}{cloud_keys}")), "cloud")
                .await;
        let tables = format!("{edge_keys}{}", pipeline("line", &cloud, LOAD));
        let edge =
            TestAgent::start_with_clock_name("edge", Some(&aggregator.address), config(&tables), "edge")
                .await;
        edge.until(|live| {
            live.links.iter().any(|link| matches!(&link.probing, Probing::Off(text) if text.contains(reason)))
        })
        .await;
        let received_events =
            aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
        assert_eq!(received_events.iterations().len(), 60);
        for iteration in received_events.iterations() {
            for name in DELAY_NAMES {
                let delay = delay(iteration, name);
                assert_interval_contains(&delay, delay.raw);
                let is_stale_at_start =
                    iteration.number <= MAX_STALE_AT_START && delay.verdict == Verdict::Stale;
                assert!(
                    is_stale_at_start || matches!(delay.verdict, Verdict::Ok | Verdict::Limited),
                    "{delay:?}"
                );
            }
        }
        edge.stop().await.expect("stops well");
        let received_events = aggregator.until(|received_events| !received_events.goodbyes.is_empty()).await;
        assert!(!received_events.clock_samples().is_empty());
        for sample in received_events.clock_samples() {
            assert_eq!((sample.probes.sent, sample.round_trip), (0, None));
            assert!(sample.upper.is_some() && sample.lower.is_some() && sample.exchanges.accepted > 0);
        }
        cloud.stop().await.expect("stops well");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn probes_are_answered_only_with_shared_key() {
    let folder = tempfile::tempdir().expect("a folder");
    let key = folder.path().join("key");
    std::fs::write(&key, "0123456789abcdef0123456789abcdef\n").expect("written");
    std::fs::set_permissions(&key, Permissions::from_mode(0o600)).expect("this user owns the file");
    let probes_with_key = format!("[probes]\nkey_file = '{}'\n", key.display());
    // Without the key an edge gets no answer, as with a firewall.
    let cloud = TestAgent::start_with_clock_name(
        "cloud",
        None,
        config(&format!("{CLOUD}{probes_with_key}")),
        "cloud",
    )
    .await;
    let load = "load = { mode = 'rate', hz = 20.0 }";
    let tables = |keys: &str| config(&format!("{keys}{}", pipeline("line", &cloud, load)));
    let edge_without_key =
        TestAgent::start_with_clock_name("edge_without_key", None, tables(""), "edge_without_key").await;
    let edge_with_key =
        TestAgent::start_with_clock_name("edge_with_key", None, tables(&probes_with_key), "edge_with_key")
            .await;

    let live = edge_with_key
        .until(|live| live.links.iter().any(|link| link.latest_sample.probes.answered > 0))
        .await;
    assert!(matches!(live.links[0].probing, Probing::On { .. }), "{:?}", live.links[0].probing);
    let is_loopback = |address: &str| address.starts_with("udp://127.0.0.1:");
    let unanswered =
        |probing: &Probing| matches!(probing, Probing::Unanswered { address, .. } if is_loopback(address));
    let live = edge_without_key.until(|live| live.links.iter().any(|link| unanswered(&link.probing))).await;
    assert_eq!(live.links[0].latest_sample.probes.answered, 0);
    let offset = live.links[0].latest_sample.offset.as_ref().expect("the data exchanges show the offset");
    assert!(offset.bounds.lo <= offset.estimate && offset.estimate <= offset.bounds.hi);
    for agent in [edge_without_key, edge_with_key, cloud] {
        agent.stop().await.expect("stops well");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn key_only_at_edge_is_named_as_reason() {
    let folder = tempfile::tempdir().expect("a folder");
    let key = folder.path().join("key");
    std::fs::write(&key, "0123456789abcdef0123456789abcdef\n").expect("written");
    std::fs::set_permissions(&key, Permissions::from_mode(0o600)).expect("this user owns the file");
    let probes_with_key = format!("[probes]\nkey_file = '{}'\n", key.display());
    let aggregator = Aggregator::start().await;
    let cloud = TestAgent::start_with_clock_name("cloud", None, config(CLOUD), "cloud").await;
    let tables =
        format!("{probes_with_key}{}", pipeline("line", &cloud, "load = { mode = 'rate', hz = 20.0 }"));
    let edge =
        TestAgent::start_with_clock_name("edge", Some(&aggregator.address), config(&tables), "edge").await;
    let names_key = |probing: &Probing| matches!(probing, Probing::Unanswered { reason: Some(reason), .. } if reason.contains("same key"));
    edge.until(|live| live.links.iter().any(|link| names_key(&link.probing))).await;
    edge.stop().await.expect("stops well");
    let received_events = aggregator.until(|received_events| !received_events.goodbyes.is_empty()).await;
    // Probes that were in flight when the edge stopped are also lost.
    let (mut sent, mut lost) = (0, 0);
    for sample in received_events.clock_samples() {
        (sent, lost) = (sent + sample.probes.sent, lost + sample.probes.lost);
        assert_eq!(sample.probes.answered, 0);
    }
    assert!(sent > 0 && sent == lost, "{sent} sent, {lost} lost");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn occupied_probe_port_is_error_only_if_configured() {
    let taken = UdpSocket::bind("127.0.0.1:0").expect("a port");
    let port = taken.local_addr().expect("bound").port();
    let state = tempfile::tempdir().expect("a folder");
    let mut fixed_port_config = config(&format!("{CLOUD}[probes]\nport = {port}\n"));
    fixed_port_config.agent.name = Some("cloud".parse().expect("a name"));
    fixed_port_config.agent.state_dir = state.path().to_owned();
    let started = Agent::start(fixed_port_config, VERSION, clock("cloud"), CancellationToken::new()).await;
    let error = match started {
        Err(error @ StartError::Reflector(_)) => error.to_string(),
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("the port is taken"),
    };
    assert!(error.contains(&port.to_string()) && error.contains("[probes] port"), "{error}");

    // Two clouds on one address: at least one of them takes a port other than the default.
    let clouds = [
        TestAgent::start_with_clock_name("first", None, config(CLOUD), "first").await,
        TestAgent::start_with_clock_name("second", None, config(CLOUD), "second").await,
    ];
    let tables = clouds.iter().zip(["to-first", "to-second"]).map(|(cloud, name)| pipeline(name, cloud, ""));
    let edge =
        TestAgent::start_with_clock_name("edge", None, config(&tables.collect::<String>()), "edge").await;
    let live = edge
        .until(|live| {
            live.links.len() == 2 && live.links.iter().all(|link| link.latest_sample.round_trip.is_some())
        })
        .await;
    let addresses: Vec<_> = live
        .links
        .iter()
        .map(|link| match &link.probing {
            Probing::On { address, .. } => address.as_str(),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_ne!(addresses[0], addresses[1]);
    edge.stop().await.expect("stops well");
    for cloud in clouds {
        cloud.stop().await.expect("stops well");
    }
}
