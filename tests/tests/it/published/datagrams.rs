//! Tests of the paper's commands over datagrams, of which some are lost.

use peernet_tests::Network;
use peernet_tests::network::WireProperties;

use super::{Data, Lab};

/// Sensor with payloads of all sizes, and a model that checks each payload before it returns it.
const PAYLOADS: &str = "\
SIZES = [0, 1, 1_000, 60_000, 1_200_000, 20_000_000]

def payload(size):
    return (bytes(range(251)) * (size // 251 + 1))[:size]

class Sensor:
    def __init__(self):
        self.count = 0

    def sample(self):
        size = SIZES[self.count % len(SIZES)]
        self.count += 1
        return payload(size)

class Model:
    def infer(self, sent):
        if sent != payload(len(sent)):
            raise ValueError('the payload was altered')
        return sent
";

fn numbers(data: &Data, name: &str) -> Vec<Option<f64>> {
    data.column(name).into_iter().map(|cell| cell.parse().ok()).collect()
}

#[test]
fn payloads_of_all_sizes_cross_datagrams_whole() {
    const ITERATIONS: usize = 12;
    let lab = Lab::new();
    std::fs::write(lab.folder().join("payloads.py"), PAYLOADS).expect("writable");
    let options = format!("--network zmq-udp --network-config net_config.yaml --iterations {ITERATIONS}");
    let server =
        lab.start_server(&format!("PEERNet --server --name cluster {options} --model-name payloads::Model"));
    let client = lab.start_client(&format!(
        "PEERNet --client --name jetson-orin {options} --sensor-object payloads::Sensor --result-loc results"
    ));
    let (client, server) = (client.wait_for_end(), server.wait_for_end());
    let data = lab.data("results");
    let (answered, lost) = (data.count_outcome("ok"), data.count_outcome("lost"));
    assert_eq!((answered + lost, data.rows.len()), (ITERATIONS, ITERATIONS), "{}", client.log);
    // A lost payload makes the client's run incomplete. The server's run is incomplete only if the request was
    // lost, not the answer.
    assert_eq!(client.code(), if lost == 0 { 0 } else { 75 }, "{}", client.log);
    assert!([0, client.code()].contains(&server.code()), "{}", server.log);
    // The same numbers as SIZES of the sensor.
    let sizes = [0.0, 1.0, 1e3, 6e4, 1.2e6, 2e7];
    let (outcomes, sent, returned) =
        (data.column("outcome"), numbers(&data, "upload-bytes"), numbers(&data, "download-bytes"));
    for (row, size) in sizes.into_iter().cycle().take(ITERATIONS).enumerate() {
        assert_eq!(sent[row], Some(size));
        if outcomes[row] == "ok" {
            assert_eq!(returned[row], Some(size));
        } else {
            // On this cable only a full buffer loses datagrams.
            assert!(size > 1e5, "{size} bytes were lost: {}", client.log);
        }
    }
    let record = lab.record("results");
    assert_eq!(record["placement"]["network"], "zmq-udp", "{record:#}");
}

#[test]
fn iterations_over_bad_path_are_answered_or_lost() {
    const ITERATIONS: usize = 150;
    let sockets = tempfile::tempdir().expect("the temporary folder is writable");
    let wire_direction = |delay_ms| WireProperties { delay_ms, jitter_ms: 3, loss_percent: 2 };
    let lab =
        Lab::with_network(Network::reordering_wire(sockets.path(), wire_direction(30), wire_direction(5)));
    std::fs::write(lab.folder().join("edge.toml"), "[agent]\n[clock_fault]\noffset_ms = 5000\n")
        .expect("writable");
    let options = format!("--network zmq-udp --network-config net_config.yaml --iterations {ITERATIONS}");
    let server = lab.start_server(&format!("PEERNet --server --name cluster {options} --model-name echo"));
    let client = lab.start_client(&format!(
        "PEERNet --client --name jetson-orin {options} --sensor-type synthetic --text-size 5000 --result-loc results \
         --config edge.toml"
    ));
    let (client, server) = (client.wait_for_end(), server.wait_for_end());
    assert_eq!((client.code(), server.code()), (75, 75), "{}\n{}", client.log, server.log);
    let data = lab.data("results");
    let (answered, lost) = (data.count_outcome("ok"), data.count_outcome("lost"));
    assert_eq!((answered + lost, data.rows.len()), (ITERATIONS, ITERATIONS), "{}", client.log);
    assert!(answered > 75 && lost > 5, "{answered} answered, {lost} lost");
    let reasons = data.column("reason").into_iter().zip(data.column("outcome"));
    for (reason, outcome) in reasons {
        assert!(outcome == "ok" || reason.contains("of 5 fragments arrived"), "{outcome}: {reason}");
    }
    // Both hosts read this machine's clock; the edge's has an injected fault.
    // `receiver_ahead` is the receiver's clock minus the sender's clock, seconds.
    for (name, receiver_ahead, delay) in [("upload", -5.0, 0.03), ("download", 5.0, 0.005)] {
        let [raw, lo, hi] = ["raw", "lo", "hi"].map(|bound| numbers(&data, &format!("{name}-{bound}")));
        let mut compared = 0;
        for ((raw, lo), hi) in raw.into_iter().zip(lo).zip(hi) {
            let (Some(raw), Some(lo), Some(hi)) = (raw, lo, hi) else { continue };
            let truth = raw - receiver_ahead;
            // The jitter of 3 ms may shorten the delay of the wire; 1 ms is a margin.
            assert!(truth >= delay - 0.004, "{name}: {truth}");
            // The interval is for the free-running clocks; the wall clocks are read up to 3 µs later.
            assert!(lo - 3e-6 <= truth && truth <= hi + 3e-6, "{name}: {truth} is not in [{lo}, {hi}]");
            compared += 1;
        }
        assert!(compared > 50, "{name}: {compared}");
    }
}
