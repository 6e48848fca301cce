//! Tests of an agent that listens at several addresses.

use peernet_tests::{LoopbackDeployment, free_port};

const CLOUD: &str = r#"
[serve]
listen = ["tcp://127.0.0.1:{data}", "tcp://127.0.0.1:SECOND"]

[[model]]
name = "echo"
kind = "echo"
"#;

fn edge_tables(port: &str) -> String {
    format!(
        "[[pipeline]]\nname = \"line\"\nsensor = {{ kind = \"synthetic\", size_bytes = 1000 }}\n\
         placement = {{ kind = \"remote\", peer = \"tcp://127.0.0.1:{port}\", model = \"echo\" }}\n\
         load = {{ mode = \"rate\", hz = 50.0 }}\n"
    )
}

#[test]
fn two_addresses_are_served_concurrently() {
    let (deployment, second_port) = (LoopbackDeployment::new(), free_port().to_string());
    let (_aggregator, api) = deployment.start_aggregator();
    let cloud = deployment.start_agent("cloud", &CLOUD.replace("SECOND", &second_port));
    for port in [deployment.data_port.to_string(), second_port.clone()] {
        cloud.wait_for(&format!("tcp://127.0.0.1:{port}"));
    }
    let edges = [
        deployment.start_agent("left", &edge_tables("{data}")),
        deployment.start_agent("right", &edge_tables(&second_port)),
    ];

    // The pipelines have no limit, so both run during the checks.
    for host in ["left", "right"] {
        api.wait_until(&format!("/api/v1/pipelines/{host}/line"), |pipeline| {
            // Window 2 is the last minute.
            (pipeline["windows"][2]["counts"]["ok"].as_f64()? > 10.0).then_some(())
        });
        let link = api.json(&format!("/api/v1/links/{host}~cloud"));
        assert_eq!((&link["network"], &link["connected"]), (&"zmq-tcp".into(), &true.into()), "{link}");
        let link_by_network = api.json(&format!("/api/v1/links/{host}~cloud~zmq-tcp"));
        assert_eq!(link_by_network["name"], link["name"], "a path with the network leads to the same link");
    }
    let cloud_host = api.json("/api/v1/hosts/cloud");
    let serves = format!("tcp://127.0.0.1:{}, tcp://127.0.0.1:{second_port}", deployment.data_port);
    assert_eq!(cloud_host["description"]["serves"], serves.as_str(), "{cloud_host}");
    for edge in edges {
        assert_eq!(edge.stop().code(), 0);
    }
    assert_eq!(cloud.stop().code(), 0);
}

#[test]
fn network_and_address_must_agree() {
    let deployment = LoopbackDeployment::new();
    for tables in [
        "[serve]\nlisten = \"tcp://127.0.0.1:{data}\"\nnetwork = \"zmq-udp\"\n".to_owned(),
        edge_tables("{data}").replace("model =", "network = \"zmq-udp\", model ="),
    ] {
        deployment
            .write("it.toml", &format!("[agent]\nname = \"a\"\nstate_dir = \"{{folder}}/a\"\n{tables}"));
        let end = deployment.peernetd(&["check", "it.toml"]).wait_for_end();
        assert_eq!(end.code(), 78, "{}", end.log);
        for part in ["it.toml:", "zmq-udp", "zmq-tcp"] {
            assert!(end.log.contains(part), "{part} is missing in:\n{}", end.log);
        }
    }
}

#[test]
fn invalid_lists_of_addresses_are_refused() {
    let deployment = LoopbackDeployment::new();
    for (listen, message) in [
        ("[]", "the list is empty"),
        (
            "[\"tcp://127.0.0.1:7001\", \"tcp://127.0.0.1:7001\"]",
            "the list contains tcp://127.0.0.1:7001 twice",
        ),
        ("[\"tcp://127.0.0.1:7001\", \"127.0.0.1:7002\"]", "the scheme is missing"),
        ("[\"tcp://127.0.0.1:7001\", \"carrier-pigeon://b:1\"]", "unknown scheme"),
    ] {
        deployment.write(
            "it.toml",
            &format!("[agent]\nname = \"a\"\nstate_dir = \"{{folder}}/a\"\n[serve]\nlisten = {listen}\n"),
        );
        let end = deployment.peernetd(&["check", "it.toml"]).wait_for_end();
        assert_eq!(end.code(), 78, "{}", end.log);
        assert!(end.log.contains(message) && end.log.contains("serve.listen"), "{message} in {}", end.log);
    }
}
