//! Tests of an agent that listens at several addresses.

use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;

use peernet_networks::{Address, NetworkKind};
use peernet_stream::{PipelineState, Probing};
use peernet_test_ports::free_port;

use crate::harness::{TestAgent, WAIT_TIMEOUT, clock, config};

const MODEL: &str = "[[model]]\nname = 'echo'\nkind = 'echo'\n";

fn pipeline(name: &str, peer: &Address) -> String {
    format!(
        "[[pipeline]]\nname = '{name}'\nsensor = {{ kind = 'synthetic', size_bytes = 1000 }}\n\
         placement = {{ kind = 'remote', peer = '{peer}', model = 'echo' }}\n\
         load = {{ mode = 'rate', hz = 50.0 }}\nwarm_up = {{ iterations = 0 }}\n"
    )
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn each_address_is_served_within_its_own_limits() {
    let tables = format!(
        "[serve]\nlisten = ['tcp://127.0.0.1:0', 'tcp://127.0.0.2:0']\nsession = {{ max_sessions = 1 }}\n{MODEL}"
    );
    let cloud = TestAgent::start("cloud", None, &tables).await;
    let [first, second] = cloud.running.serve_addresses() else {
        panic!("{:?}", cloud.running.serve_addresses())
    };
    assert_eq!((first.host().as_str(), second.host().as_str()), ("127.0.0.1", "127.0.0.2"));
    assert_eq!(cloud.running.description().serves, Some(format!("{first}, {second}")));

    let tables = pipeline("first", first) + &pipeline("second", second);
    // The edge's clock has another name, so that probes are sent as between two hosts.
    let edge = TestAgent::start_with_clock_name("edge", None, config(&tables), "edge").await;
    edge.until(|live| {
        let answered = |second: &peernet_stream::Second| second.counts.ok > 0;
        live.pipelines.iter().all(|pipeline| pipeline.seconds.iter().any(answered))
    })
    .await;
    let mut served = cloud.running.served_counts();
    let served = tokio::time::timeout(WAIT_TIMEOUT, served.wait_for(|served| served.sessions == 2)).await;
    served.expect("in time").expect("the agent serves");
    let live = edge.until(|live| live.links.iter().any(|link| link.latest_sample.probes.answered > 0)).await;
    let [link] = &live.links[..] else { panic!("one pair of hosts, one network: {:?}", live.links) };
    assert_eq!((link.pipelines.len(), link.network().as_str()), (2, "zmq-tcp"));
    assert!(matches!(&link.probing, Probing::On { .. }), "{:?}", link.probing);

    // Each listener has one session, which is its limit.
    for address in [first, second] {
        let late = TestAgent::start("late", None, &pipeline("late", address)).await;
        let refused =
            late.until_state(|state| matches!(state, PipelineState::Waiting(why) if why.contains("refused")));
        refused.await;
        late.stop().await.expect("stops well");
    }
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn probes_are_answered_at_every_address() {
    let tables = format!("[serve]\nlisten = ['tcp://127.0.0.1:0', 'tcp://127.0.0.2:0']\n{MODEL}");
    let cloud = TestAgent::start("cloud", None, &tables).await;
    for address in cloud.running.serve_addresses() {
        let tables = config(&pipeline("line", address));
        let edge = TestAgent::start_with_clock_name("edge", None, tables, "edge").await;
        let live =
            edge.until(|live| live.links.iter().any(|link| link.latest_sample.probes.answered > 0)).await;
        let Probing::On { address: probed, .. } = &live.links[0].probing else { panic!("{:?}", live.links) };
        assert!(probed.starts_with(&format!("udp://{}:", address.host())), "{probed} for {address}");
        edge.stop().await.expect("stops well");
    }
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn occupied_address_fails_start_and_frees_others() {
    let taken = TcpListener::bind("127.0.0.1:0").expect("a port");
    let taken_at = taken.local_addr().expect("it is bound");
    // Other tests at the same time get other ports, so that none of them takes this port in between.
    let free_at = SocketAddr::from(([127, 0, 0, 1], free_port()));
    let start = |listen: String| {
        let tables = config(&format!("[serve]\nlisten = {listen}\n{MODEL}"));
        let state = Arc::new(tempfile::tempdir().expect("a folder"));
        TestAgent::try_start(clock("system"), "cloud", None, tables, state)
    };
    let refused = start(format!("['tcp://{free_at}', 'tcp://{taken_at}']")).await;
    let Err(error) = refused else { panic!("one of its ports is in use") };
    assert!(error.to_string().contains(&format!("cannot listen on tcp://{taken_at}")), "{error}");
    let cloud = start(format!("'tcp://{free_at}'")).await.expect("the port is free again");
    cloud.stop().await.expect("stops well");
}

#[test]
fn networks_not_matching_addresses_are_refused() {
    let state = tempfile::tempdir().expect("a folder");
    for network in NetworkKind::ALL {
        for scheme in NetworkKind::ALL.iter().flat_map(|kind| kind.schemes()) {
            // An address of ROS 2 has a domain instead of a host.
            let rest = if *scheme == "ros2" { "0/peernet" } else { "127.0.0.1:0" };
            let address: Address = format!("{scheme}://{rest}").parse().expect("an address");
            let mut config = config(&format!(
                "[serve]\nlisten = '{address}'\nnetwork = '{network}'\n{MODEL}\
                 [[pipeline]]\nname = 'line'\nsensor = {{ kind = 'synthetic', size_bytes = 1 }}\n\
                 placement = {{ kind = 'remote', peer = '{address}', network = '{network}' }}\n"
            ));
            config.agent.state_dir = state.path().to_owned();
            let found = peernet_agent::Agent::check(&config, &clock("system"));
            // A build without ROS 2 also reports that ROS 2 is missing.
            let not_built = peernet_ros::ros2::Ros2Error::NotBuilt.to_string();
            let found: Vec<String> = found
                .iter()
                .map(ToString::to_string)
                .filter(|problem| !problem.ends_with(&not_built))
                .collect();
            if address.network() == *network {
                assert_eq!(found, Vec::<String>::new());
                continue;
            }
            for key in ["serve.network", "pipeline[0].placement.network"] {
                let expected = format!(
                    "{key}: the network is {network}, but {address} is an address of {}; leave the network out, or write ",
                    address.network()
                );
                assert!(
                    found.iter().any(|problem| problem.starts_with(&expected)),
                    "{expected} in {found:#?}"
                );
            }
        }
    }
}

#[test]
fn event_stream_over_another_network_is_refused() {
    let state = tempfile::tempdir().expect("a folder");
    let mut config = config("");
    config.agent.state_dir = state.path().to_owned();
    config.agent.aggregator = Some("udp://127.0.0.1:5550".parse().expect("an address"));
    let found = peernet_agent::Agent::check(&config, &clock("system"));
    let expected = "agent.aggregator: the event stream uses the network zmq-tcp, but udp://127.0.0.1:5550 is an address of zmq-udp; \
                    write tcp://host:port";
    assert!(found.iter().any(|problem| problem.to_string() == expected), "{expected} in {found:#?}");
}
