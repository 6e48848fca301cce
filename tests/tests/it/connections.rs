//! Tests of the statistics of connections, from the kernel to the page.

use peernet_tests::network::WireProperties;
use peernet_tests::truth::query_database;
use peernet_tests::{LoopbackDeployment, Network, TwoHostTestbed, wait_until};

const CLOUD: &str = r#"
[serve]
listen = "tcp://127.0.0.1:{data}"

[[model]]
name = "echo"
kind = "echo"
"#;

const EDGE: &str = r#"
[[pipeline]]
name = "offload"
sensor = { kind = "synthetic", size_bytes = 10000 }
placement = { kind = "remote", peer = "tcp://127.0.0.1:{data}", model = "echo" }
load = { mode = "rate", hz = 50.0 }
"#;

#[test]
fn page_api_and_metrics_show_connection() {
    let deployment = LoopbackDeployment::new();
    let (aggregator, api) = deployment.start_aggregator();
    let cloud = deployment.start_agent("cloud", CLOUD);
    let edge = deployment.start_agent("edge", EDGE);
    let connection = api.wait_until("/api/v1/links/edge~cloud", |link| {
        let connection = link["now"]["connections"].get(0)?;
        let at_cloud = connection["cloud"]["up"]["messages"].as_u64()?;
        (connection["up"]["messages"].as_u64()? > 50 && at_cloud > 50).then(|| connection.clone())
    });
    let (up, down) = (&connection["up"], &connection["down"]);
    assert_eq!((&connection["pipeline"], &connection["network"]), (&"offload".into(), &"zmq-tcp".into()));
    // An echo sends back what it received, and each direction has a message that opens the session.
    assert!(up["bytes"].as_u64() >= Some(500_000) && down["bytes"].as_u64() >= Some(500_000), "{connection}");
    assert!(up["datagrams"].as_u64() >= Some(50) && up["retransmitted_datagrams"].is_u64(), "{connection}");
    // TCP reports no lost datagrams, and only the sender of a direction knows what it retransmitted.
    assert!(up["lost_datagrams"].is_null() && down["retransmitted_datagrams"].is_null(), "{connection}");
    let round_trip = &connection["transport_round_trip"];
    assert!(
        round_trip["smoothed_s"].as_f64().is_some_and(|round_trip| round_trip > 0.0 && round_trip < 1.0),
        "{connection}"
    );
    // The cloud's counts are older than those of the edge.
    let at_cloud = &connection["cloud"];
    for (direction, edge_counts) in [("up", up), ("down", down)] {
        let bytes = at_cloud[direction]["bytes"].as_u64();
        assert!(bytes > Some(100_000) && bytes <= edge_counts["bytes"].as_u64(), "{connection}");
    }
    assert!(at_cloud["down"]["retransmitted_datagrams"].is_u64(), "the edge cannot know it: {connection}");
    assert!(at_cloud["transport_round_trip"]["smoothed_s"].is_f64(), "{connection}");
    let interface = &connection["interface"];
    assert_eq!((&interface["name"], &interface["type"]), (&"lo".into(), &"loopback".into()));
    let remote = format!("127.0.0.1:{}", deployment.data_port);
    assert_eq!(connection["remote_address"], remote.as_str());

    let (status, page) = api.get("/links/edge~cloud").expect("the aggregator answers");
    assert_eq!(status, 200);
    for text in [
        "Connections</h2>",
        "by lo, loopback, MTU ",
        "round trip of the transport&#39;s packets ",
        remote.as_str(),
    ] {
        assert!(page.contains(text), "the page lacks {text:?}: {page}");
    }
    assert!(page.contains("data-h=\"counted by\">cloud</td>"), "{page}");
    let (_, metrics) = api.get("/metrics").expect("the aggregator answers");
    let series = "peernet_link_transferred_bytes_total{edge=\"edge\",cloud=\"cloud\",network=\"zmq-tcp\",\
                  pipeline=\"offload\",direction=\"upload\"} ";
    assert!(metrics.contains(series), "{metrics}");
    assert!(metrics.contains(&series.replace("link_transferred", "link_cloud_transferred")), "{metrics}");

    for process in [edge, cloud] {
        let end = process.stop();
        assert_eq!(end.code(), 0, "{}", end.log);
    }
    // The totals of a connection are stored when it has ended.
    let database = deployment.folder().join("aggregator.sqlite");
    let stored = wait_until("the cloud's counts in the database", || {
        let sql = "SELECT sent_bytes, cloud_received_bytes, received_bytes, cloud_sent_bytes FROM connection_total \
                   WHERE edge = 'edge' AND cloud = 'cloud' AND pipeline = 'offload'";
        let row = query_database(&database, sql);
        (!row.trim().is_empty()).then_some(row)
    });
    let bytes: Vec<u64> = stored
        .trim()
        .split('|')
        .map(|bytes| bytes.parse().unwrap_or_else(|_| panic!("{stored:?}")))
        .collect();
    let [sent, cloud_received, received, cloud_sent] = bytes[..] else { panic!("{stored:?}") };
    assert!(cloud_received > 100_000 && cloud_received <= sent, "{stored}");
    assert!(cloud_sent > 100_000 && cloud_sent <= received, "{stored}");
    assert_eq!(aggregator.stop().code(), 0);
}

#[test]
fn lossy_link_shows_retransmissions() {
    let testbed = TwoHostTestbed::new(|_| Network::direct());
    testbed.network.cloud().drop_percent(10);
    let _cloud = testbed.start_cloud("");
    let load = "load = { mode = \"rate\", hz = 20.0 }";
    let _edge = testbed.start_edge(&testbed.pipeline("offload", 100_000, load), &[]);
    let connection = testbed.api.wait_until("/api/v1/links/edge~cloud", |link| {
        let connection = link["now"]["connections"].get(0)?;
        (connection["up"]["retransmitted_datagrams"].as_u64()? > 5).then(|| connection.clone())
    });
    assert_eq!(
        connection["interface"],
        serde_json::json!({ "name": "data", "type": "ethernet", "mtu_bytes": 1500 })
    );
    // Retransmitted datagrams are counted as datagrams as well.
    let datagrams = connection["up"]["datagrams"].as_u64();
    assert!(datagrams > connection["up"]["retransmitted_datagrams"].as_u64(), "{connection}");
    let address = testbed.network.cloud().address;
    assert_eq!(connection["remote_address"], format!("{address}:5551").as_str());
}

#[test]
fn page_api_metrics_show_lost_and_reordered_datagrams() {
    let wire_direction = |delay_ms| WireProperties { delay_ms, jitter_ms: 3, loss_percent: 2 };
    let testbed = TwoHostTestbed::with_scheme("udp", |folder| {
        Network::reordering_wire(folder, wire_direction(30), wire_direction(5))
    });
    let _cloud = testbed.start_cloud("");
    let load = "load = { mode = \"rate\", hz = 20.0 }";
    let _edge = testbed.start_edge(&testbed.pipeline("offload", 20_000, load), &[]);
    let connection = testbed.api.wait_until("/api/v1/links/edge~cloud~zmq-udp", |link| {
        let connection = link["now"]["connections"].get(0)?;
        let is_counted = ["up", "down"].iter().all(|direction| {
            let counts =
                ["lost_datagrams", "reordered_datagrams"].map(|name| connection[direction][name].as_u64());
            counts.iter().all(|count| *count > Some(3))
        });
        (is_counted && connection["lost_messages"].as_u64()? > 3).then(|| connection.clone())
    });
    let (up, down) = (&connection["up"], &connection["down"]);
    // The path loses 2 %, much less than a tenth.
    assert!(up["datagrams"].as_u64() > up["lost_datagrams"].as_u64().map(|lost| 10 * lost), "{connection}");
    assert!(up["duplicated_datagrams"].is_u64() && up["retransmitted_datagrams"].is_u64(), "{connection}");
    assert!(down["datagrams"].is_u64() && down["retransmitted_datagrams"].is_null(), "{connection}");
    assert!(connection["cloud"]["up"]["datagrams"].as_u64() > Some(100), "{connection}");
    let round_trip = connection["transport_round_trip"]["smoothed_s"].as_f64();
    assert!(round_trip.is_some_and(|round_trip| (0.03..1.0).contains(&round_trip)), "{connection}");
    assert_eq!(connection["interface"]["name"], "data");
    let remote = format!("{}:5551", testbed.network.cloud().address);
    assert_eq!(connection["remote_address"], remote.as_str());

    let (_, page) = testbed.api.get("/links/edge~cloud~zmq-udp").expect("the aggregator answers");
    for text in [
        "zmq-udp",
        "by data, ",
        "round trip of the transport&#39;s packets ",
        " messages lost in transit or with the connection",
        remote.as_str(),
    ] {
        assert!(page.contains(text), "the page lacks {text:?}: {page}");
    }
    let (_, metrics) = testbed.api.get("/metrics").expect("the aggregator answers");
    let series = "peernet_link_lost_datagrams_total{edge=\"edge\",cloud=\"cloud\",network=\"zmq-udp\",pipeline=\"offload\",\
                  direction=\"download\"} ";
    assert!(metrics.contains(series), "{metrics}");
}
