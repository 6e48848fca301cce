//! Tests of the limits of the paper's commands: the time for an answer, and the size of a sample.

use peernet_tests::ProcessEnd;

use super::Lab;

/// Model that takes longer than the limits of the tests.
const MODEL: &str = "
import time

class Slow:
    def infer(self, x):
        time.sleep(1.5)
        return 'well'
";

/// Runs a client against a server that serves `model`, each with its own options; returns the client's end.
fn measure(lab: &Lab, model: &str, server_options: &str, client_options: &str, results: &str) -> ProcessEnd {
    let server = lab.start_server(&format!(
        "PEERNet --server --name cluster --network-config net_config.yaml --model-name {model} --iterations 2 {server_options}"
    ));
    let client = lab.start_client(&format!(
        "PEERNet --client --name jetson-orin --network-config net_config.yaml --sensor-type synthetic --iterations 2 \
         --result-loc {results} {client_options}"
    ));
    let end = client.wait_for_end();
    server.terminate();
    drop(server);
    end
}

#[test]
fn slow_model_is_measured_with_longer_timeout() {
    let lab = Lab::on_one_machine();
    std::fs::write(lab.folder().join("my_model.py"), MODEL).expect("writable");
    // Returns the outcomes of all iterations, after a check that each reason contains all parts.
    let outcomes_with_reason = |results: &str, parts: &[&str]| {
        let data = lab.data(results);
        for reason in data.column("reason") {
            assert!(parts.iter().all(|part| reason.contains(part)), "{parts:?} in {reason:?}");
        }
        data.column("outcome").into_iter().map(str::to_owned).collect::<Vec<_>>()
    };

    // The client waits for a shorter time than the model takes.
    let end = measure(&lab, "my_model::Slow", "", "--timeout 0.5", "client");
    assert_eq!(end.code(), 75, "{}", end.log);
    let parts = ["no answer of cloud cluster", "within 500 ms", "timeout_ms", "--timeout"];
    assert_eq!(outcomes_with_reason("client", &parts), ["timeout", "timeout"]);
    assert!(parts.iter().all(|part| end.log.contains(part)), "{}", end.log);

    // The server's limit for the model is shorter than the client's default limit, so the client
    // gets the model's reason.
    let end = measure(&lab, "my_model::Slow", "--timeout 0.4", "", "server");
    assert_eq!(end.code(), 75, "{}", end.log);
    let parts = ["my_model::Slow did not answer within 0.4 s", "timeout_ms", "--timeout"];
    assert_eq!(outcomes_with_reason("server", &parts), ["failed", "failed"]);

    let end = measure(&lab, "my_model::Slow", "--timeout 20", "--timeout 30", "both");
    assert_eq!((end.code(), lab.data("both").count_outcome("ok")), (0, 2), "{}", end.log);
}

#[test]
fn refusal_of_large_sample_names_option_for_size() {
    let lab = Lab::on_one_machine();
    let size_option = "--text-size 300000";
    let end = measure(&lab, "echo", "--max-message-bytes 100000", size_option, "refused");
    assert_eq!(end.code(), 75, "{}", end.log);
    let refused = lab.data("refused");
    assert_eq!((refused.rows.len(), refused.count_outcome("ok")), (2, 0), "{}", end.log);
    for reason in refused.column("reason") {
        assert!(reason.contains("300") && reason.contains("--max-message-bytes"), "{reason}");
    }
    let (server, client) =
        ("--max-message-bytes 400000", format!("{size_option} --max-message-bytes 400000"));
    let end = measure(&lab, "echo", server, &client, "passed");
    assert_eq!((end.code(), lab.data("passed").count_outcome("ok")), (0, 2), "{}", end.log);
}
