//! Tests of the two commands over topics of ROS 1.

use peernet_tests::Ros1System;

use super::{Lab, picture};

/// Starts a ROS 1 master, and creates a lab whose programs use it.
fn create_lab() -> (Lab, Ros1System) {
    let system = Ros1System::new();
    (Lab { ros_master: Some(system.uri()), ..Lab::on_one_machine() }, system)
}

const SERVER: &str = "PEERNet --server --name cluster --network ros --network-config net_config.yaml";
const CLIENT: &str = "PEERNet --client --name jetson-orin --network ros --network-config net_config.yaml";

#[test]
fn published_commands_work_over_ros() {
    let (lab, system) = create_lab();
    std::fs::copy(picture(), lab.folder().join("sample-image.JPEG")).expect("writable");
    let server = lab.start_server(&format!("{SERVER} --model-name dummy --device cuda:6 --iterations 12"));
    let client = lab.start_client(&format!(
        "{CLIENT} --dataset-loc sample-image.JPEG --iterations 12 --result-loc results"
    ));
    let (client, server) = (client.wait_for_end(), server.wait_for_end());
    assert_eq!((client.code(), server.code()), (0, 0), "{}\n{}", client.log, server.log);
    let address = format!("ros1://127.0.0.1:{}/cluster", system.port());
    assert!(server.log.contains(&address) && server.log.contains("12 answers"), "{}", server.log);
    let data = lab.data("results");
    assert_eq!((data.count_outcome("ok"), data.rows.len()), (12, 12));
    let picture_bytes = f64::from(1280 * 960 * 3);
    assert!(data.numbers("upload-bytes").iter().all(|bytes| *bytes == picture_bytes));
    let (upload, low, high) = (data.numbers("upload"), data.numbers("upload-lo"), data.numbers("upload-hi"));
    assert!(upload.iter().zip(low).zip(high).all(|((value, low), high)| low <= *value && *value <= high));
}

#[test]
fn run_continues_after_master_and_server_restart() {
    let (lab, mut system) = create_lab();
    let server = lab.start_server(&format!("{SERVER} --model-name dummy --iterations 1000"));
    server.wait_for("serving dummy");
    let client = lab.start_client(&format!(
        "{CLIENT} --sensor-type synthetic --text-size 1200000 --iterations 150 --result-loc results"
    ));
    server.wait_for("1 session");
    system.kill_master();
    system.start_master();
    server.kill();
    let server = lab.start_server(&format!("{SERVER} --model-name dummy --iterations 1000"));
    let client = client.wait_for_end();
    assert_eq!(client.code(), 75, "iterations in flight are lost: {}", client.log);
    let data = lab.data("results");
    assert_eq!(data.rows.len(), 150);
    assert!(
        data.count_outcome("lost") >= 1 && data.count_outcome("ok") + data.count_outcome("lost") == 150,
        "{}",
        client.log
    );
    assert_eq!(server.stop().code(), 130);
}

#[test]
fn missing_master_is_named_with_advice() {
    let (lab, mut system) = create_lab();
    system.kill_master();
    let client = lab.start_client(&format!("{CLIENT} --sensor-type synthetic --iterations 5 --patience 0"));
    let end = client.wait_for_end();
    assert_eq!(end.code(), 69, "{}", end.log);
    for part in ["no ROS master answers", &system.uri(), "start roscore", "ROS_MASTER_URI"] {
        assert!(end.log.contains(part), "{part} is missing in:\n{}", end.log);
    }
}
