//! Tests of errors before the measurement: attempted action, remedy, and exit code.

use std::net::TcpListener;

use peernet_tests::program;

use super::{Lab, picture};

/// Runs a command that must end with this code and print all these texts.
fn assert_refused(lab: &Lab, command: &str, code: i32, texts: &[&str]) {
    let end = lab.start_client(command).wait_for_end();
    assert_eq!(end.code(), code, "{command}\n{}", end.log);
    for text in texts {
        assert!(end.log.contains(text), "{command} does not say {text:?}: {}", end.log);
    }
}

#[test]
fn invalid_command_line_is_refused() {
    let lab = Lab::on_one_machine();
    let client = "PEERNet --client --name jetson-orin --network-config net_config.yaml";
    assert_refused(&lab, &format!("{client} --iterations 0"), 64, &["at least 1"]);
    assert_refused(&lab, &format!("{client} --iterations -5"), 64, &["at least 1"]);
    assert_refused(
        &lab,
        &format!("{client} --iterations 5 --network pgm"),
        64,
        &["the kinds are", "zmq-tcp", "ros"],
    );
    assert_refused(&lab, &format!("{client} --iterations 5 --network carrier-pigeon"), 64, &["zmq-tcp"]);
    assert_refused(&lab, &format!("{client} --iterations 5"), 64, &["--dataset-loc"]);
    assert_refused(
        &lab,
        &format!("{client} --iterations 5 --sensor-type external"),
        64,
        &["--sensor-object"],
    );
    assert_refused(&lab, &format!("{client} --iterations 5 --sensor-type camera"), 64, &["random string"]);
    let server = "PEERNet --server --name cluster --network-config net_config.yaml --iterations 5";
    for (name, text) in [
        ("exec:", "\"exec:\" names no program"),
        ("hollow::", "write module::object"),
        ("::Model", "write module::object"),
    ] {
        assert_refused(&lab, &format!("{client} --iterations 5 --sensor-object {name}"), 64, &[text]);
        assert_refused(&lab, &format!("{server} --model-name {name}"), 64, &[text]);
    }
    assert_refused(&lab, &format!("{client} --server --iterations 5"), 64, &["--server", "--client"]);
    assert_refused(&lab, "PEERNet --client --iterations 5", 64, &["--name", "--network-config"]);
    assert_refused(&lab, "PEERNet", 64, &["Usage"]);
}

#[test]
fn device_or_role_outside_network_configuration_is_refused() {
    let lab = Lab::on_one_machine();
    let command = |name: &str, role: &str| {
        format!(
            "PEERNet {role} --name {name} --network-config net_config.yaml --iterations 5 --dataset-loc x"
        )
    };
    assert_refused(
        &lab,
        &command("jetson", "--client"),
        78,
        &["no device jetson", "cluster, jetson-orin, spare"],
    );
    assert_refused(&lab, &command("spare", "--server"), 78, &["cluster serves", "--client"]);
    assert_refused(&lab, &command("cluster", "--client"), 78, &["--server"]);
    assert_refused(&lab, "PEERNet --name a --network-config no.yaml --iterations 5", 66, &["no.yaml"]);

    let file = lab.folder().join("net_config.yaml");
    for (configuration, text) in [
        ("devices: {a: 10.0.0.1}\nserver: b\n", "the server b is not one of its devices"),
        ("devices: {a: 10.0.0.1}\n", "names no server"),
        ("devices: [\n", "net_config.yaml"),
        ("devices: {a: 10.0.0.1, b: 10.0.0.2}\nserver: b\nstart_port: 0\n", "the device b has port 0"),
        ("devices: {a: 10.0.0.1, b: 'fe80::1%lo'}\nserver: b\n", "a zone such as %eth0"),
    ] {
        std::fs::write(&file, configuration).expect("writable");
        assert_refused(&lab, &command("a", "--client"), 78, &[text]);
    }
}

#[test]
fn missing_files_are_named() {
    let lab = Lab::on_one_machine();
    let client = "PEERNet --client --name jetson-orin --network-config net_config.yaml --iterations 5";
    let server = "PEERNet --server --name cluster --network-config net_config.yaml --iterations 5";
    assert_refused(&lab, &format!("{client} --dataset-loc nowhere.jpg"), 66, &["nowhere.jpg"]);
    std::fs::create_dir(lab.folder().join("empty")).expect("writable");
    assert_refused(&lab, &format!("{client} --dataset-loc empty"), 66, &["empty"]);
    assert_refused(
        &lab,
        &format!("{server} --model-name efficientnet_v9"),
        66,
        &["efficientnet_v9", "export_torchvision.py"],
    );
    assert_refused(&lab, &format!("{server} --model-name ./nothing"), 66, &["nothing"]);

    let module = ["no Python module no_such", "no_such.py", "start in the module's folder"];
    assert_refused(&lab, &format!("{client} --sensor-object no_such::Camera"), 66, &module);
    assert_refused(&lab, &format!("{server} --model-name no_such::Model"), 66, &module);
    std::fs::write(lab.folder().join("hollow.py"), "pass\n").expect("writable");
    let server_end = lab.start_client(&format!("{server} --model-name hollow::Model")).wait_for_end();
    assert_eq!(server_end.code(), 69, "{}", server_end.log);
    assert!(server_end.log.contains("Model") && !server_end.log.contains("answers"), "{}", server_end.log);

    // Without --device, the device is cuda:0. The ONNX Runtime of the tests cannot use it.
    let model = peernet_tests::root().join("models/quality-control");
    let command = format!("{server} --model-name {}", model.display());
    assert_refused(&lab, &command, 69, &["cuda:0", "--device cpu"]);
    assert_refused(&lab, &format!("{command} --device toaster"), 64, &["toaster", "cpu"]);
}

#[test]
fn used_port_and_existing_results_are_reported() {
    let lab = Lab::on_one_machine();
    let configuration = std::fs::read_to_string(lab.folder().join("net_config.yaml")).expect("is there");
    let port = configuration.lines().find_map(|line| line.strip_prefix("start_port: ")).expect("a port");
    let _listener = TcpListener::bind(format!("0.0.0.0:{port}")).expect("the port is free");
    let server = "PEERNet --server --name cluster --network-config net_config.yaml --iterations 5";
    assert_refused(&lab, server, 69, &[port, "start_port", "another program"]);

    let results = lab.folder().join("results");
    std::fs::create_dir(&results).expect("writable");
    std::fs::write(results.join("data.csv"), "mine\n").expect("writable");
    let client = format!(
        "PEERNet --client --name jetson-orin --network-config net_config.yaml --iterations 5 --dataset-loc {} \
         --result-loc results",
        picture().display()
    );
    assert_refused(&lab, &client, 64, &["results", "--overwrite"]);
    assert_eq!(std::fs::read_to_string(results.join("data.csv")).expect("is there"), "mine\n");
}

#[test]
fn unwritable_output_leads_to_exit_code() {
    for arguments in [["models", "list"], ["completions", "bash"], ["run", "--help"]] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").expect("Linux has /dev/full");
        let output = std::process::Command::new(program("peernet")).args(arguments).stdout(full).output();
        let output = output.expect("the program is there");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(73), "{arguments:?}: {errors}");
        assert_eq!(errors.matches("cannot write the result").count(), 1, "{errors}");
    }
}

#[test]
fn client_gives_up_without_server() {
    let lab = Lab::on_one_machine();
    let client = format!(
        "PEERNet --client --name jetson-orin --network-config net_config.yaml --iterations 5 --dataset-loc {} \
         --result-loc results --patience 1",
        picture().display()
    );
    assert_refused(&lab, &client, 69, &["is away", "gave up", "is it running"]);
    assert!(!lab.folder().join("results").exists(), "a result folder exists, although nothing was measured");
}

#[test]
fn failed_start_replaces_no_results() {
    let lab = Lab::on_one_machine();
    let results = lab.folder().join("results");
    std::fs::create_dir(&results).expect("writable");
    for name in ["data.csv", "run.json", "notes.txt"] {
        std::fs::write(results.join(name), "earlier\n").expect("writable");
    }
    let client = "PEERNet --client --name jetson-orin --network-config net_config.yaml --iterations 5 \
                  --sensor-type synthetic --result-loc results --overwrite --patience 1";
    assert_refused(&lab, client, 69, &["is away", "gave up"]);
    for name in ["data.csv", "run.json", "notes.txt"] {
        assert_eq!(std::fs::read_to_string(results.join(name)).expect("is there"), "earlier\n");
    }
    assert_eq!(std::fs::read_dir(&results).expect("a folder").count(), 3, "other files are left");
}
