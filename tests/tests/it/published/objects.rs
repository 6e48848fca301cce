//! Tests of custom objects that were written for the paper's program.

use peernet_tests::ProcessEnd;

use super::{Lab, PUBLISHED_COLUMNS};

/// Sensor in the form of the paper's program: any object with `sample()`.
const SENSOR: &str = r#"
import numpy as np

class Camera:
    def __init__(self):
        self.taken = 0

    def sample(self):
        self.taken += 1
        return np.full((48, 64, 3), self.taken % 256, dtype=np.uint8)
"#;

/// Model in the form of the paper's program: `infer(x)`, and the two optional steps.
const MODEL: &str = r#"
import numpy as np

class Brightness:
    def preprocess(self, x):
        return x.astype(np.float32) / 255

    def infer(self, x):
        return x.mean(axis=(0, 1))

    def postprocess(self, y):
        return "bright" if float(y.mean()) > 0.5 else "dark"
"#;

const FAILING_CAMERA: &str = "
class Camera:
    def __init__(self):
        self.taken = 0

    def sample(self):
        self.taken += 1
        if self.taken == 3:
            raise ValueError('the lens cap is on')
        return b'x' * 100
";

const REFUSING_MODEL: &str = "
class Odd:
    def __init__(self):
        self.asked = 0

    def infer(self, x):
        self.asked += 1
        if self.asked % 2 == 0:
            raise ValueError('not this one')
        return 'well'
";

const HANGING_SENSORS: &str = "
import time

class Slow:
    def sample(self):
        time.sleep(600)

class Stuck:
    def __init__(self):
        time.sleep(600)

    def sample(self):
        return b'x'
";

#[test]
fn hanging_sensor_is_named_in_progress() {
    let lab = Lab::on_one_machine();
    std::fs::write(lab.folder().join("my_camera.py"), HANGING_SENSORS).expect("writable");
    let _server = lab.start_server(
        "PEERNet --server --name cluster --network-config net_config.yaml --model-name dummy --iterations 9",
    );
    for (class, message) in
        [("Slow", "the sensor gave no sample for"), ("Stuck", "the sensor is not ready after")]
    {
        let client = lab.start_client(&format!(
            "PEERNet --client --name jetson-orin --network-config net_config.yaml --sensor-type external \
             --sensor-object my_camera::{class} --iterations 9 --result-loc results"
        ));
        client.wait_for(message);
        client.signal(rustix::process::Signal::INT);
        client.wait_for("Ctrl-C again");
        // A second SIGINT within half a second would count as the same signal.
        client.signal(rustix::process::Signal::TERM);
        let end = client.wait_for_end();
        assert_eq!(end.code(), 130, "{}", end.log);
    }
}

#[test]
fn python_sensor_and_model_run_on_their_hosts() {
    let lab = Lab::new();
    std::fs::write(lab.folder().join("my_camera.py"), SENSOR).expect("writable");
    std::fs::write(lab.folder().join("my_model.py"), MODEL).expect("writable");
    let server = lab.start_server(
        "PEERNet --server --name cluster --network-config net_config.yaml --model-name my_model::Brightness \
         --iterations 20",
    );
    let client = lab.start_client(
        "PEERNet --client --name jetson-orin --network-config net_config.yaml --sensor-type external \
         --sensor-object my_camera::Camera --iterations 20 --result-loc results",
    );
    let (client, server) = (client.wait_for_end(), server.wait_for_end());
    assert_eq!((client.code(), server.code()), (0, 0), "{}\n{}", client.log, server.log);
    let data = lab.data("results");
    assert_eq!(data.header[..PUBLISHED_COLUMNS.len()], PUBLISHED_COLUMNS);
    assert_eq!((data.count_outcome("ok"), data.rows.len()), (20, 20));
    assert!(data.numbers("upload-bytes").iter().all(|bytes| *bytes >= f64::from(48 * 64 * 3)));
    // The time between the processes is separate from that of the custom code.
    assert!(data.numbers("ipc").iter().all(|seconds| *seconds > 0.0));
}

/// Runs client and server for this number of iterations with this camera and an echo; returns both results.
fn run_with_camera(camera: &str, iterations: u32, lab: &Lab) -> (ProcessEnd, ProcessEnd) {
    std::fs::write(lab.folder().join("my_camera.py"), camera).expect("writable");
    let server = lab.start_server(&format!(
        "PEERNet --server --name cluster --network-config net_config.yaml --model-name echo --iterations {iterations}"
    ));
    let client = lab.start_client(&format!(
        "PEERNet --client --name jetson-orin --network-config net_config.yaml --sensor-object my_camera::Camera \
         --iterations {iterations} --result-loc results"
    ));
    (client.wait_for_end(), server.wait_for_end())
}

#[test]
fn exception_gives_failed_iteration() {
    let lab = Lab::on_one_machine();
    // The third sample fails at the client and never reaches the server. The server does not wait for it.
    let (client, server) = run_with_camera(FAILING_CAMERA, 20, &lab);
    assert_eq!((client.code(), server.code()), (75, 75), "{}\n{}", client.log, server.log);
    let message = "1 of 5 warm-up iterations failed; iteration 3 failed: ";
    assert!(client.log.contains(message), "{}", client.log);
    // The reason is printed as soon as it is known, and in the last line.
    assert_eq!(client.log.matches("ValueError: the lens cap is on").count(), 2, "{}", client.log);
    assert!(server.log.contains("19 answers, 1 iteration did not arrive here"), "{}", server.log);
    assert!(
        server.log.contains("1 of 20 iterations did not arrive here: the clients' results say why"),
        "{}",
        server.log
    );
    let data = lab.data("results");
    assert_eq!((data.count_outcome("ok"), data.count_outcome("failed")), (19, 1));
}

/// After consecutive failures the client waits longer and longer; the server must end all the same.
#[test]
fn server_ends_when_all_samples_failed() {
    let lab = Lab::on_one_machine();
    let unplugged = "class Camera:\n    def sample(self):\n        raise OSError('unplugged')\n";
    let (client, server) = run_with_camera(unplugged, 14, &lab);
    assert_eq!((client.code(), server.code()), (75, 75), "{}\n{}", client.log, server.log);
    assert!(server.log.contains("14 of 14 iterations did not arrive here"), "{}", server.log);
    assert_eq!(lab.data("results").count_outcome("failed"), 14);
}

#[test]
fn restart_of_python_process_is_recorded() {
    let lab = Lab::on_one_machine();
    // The process of the class exits in call `last`. Each start of the process takes at least 0.3 s.
    let class_that_exits = |class: &str, method: &str, last: u32| {
        format!(
            "
import os, time
time.sleep(0.3)

class {class}:
    def __init__(self):
        self.calls = 0

    def {method}:
        self.calls += 1
        return b'x' if self.calls < {last} else os._exit(3)
"
        )
    };
    std::fs::write(lab.folder().join("my_camera.py"), class_that_exits("Camera", "sample(self)", 12))
        .expect("writable");
    std::fs::write(lab.folder().join("my_model.py"), class_that_exits("Model", "infer(self, x)", 8))
        .expect("writable");
    let server = lab.start_server(
        "PEERNet --server --name cluster --network-config net_config.yaml --model-name my_model::Model --iterations 16",
    );
    let client = lab.start_client(
        "PEERNet --client --name jetson-orin --network-config net_config.yaml --sensor-object my_camera::Camera \
         --iterations 16 --result-loc results",
    );
    let client = client.wait_for_end();
    assert_eq!(client.code(), 75, "{}", client.log);
    assert!(
        client.log.contains("The model's process was restarted in 1 iteration (number 9)"),
        "{}",
        client.log
    );
    assert!(
        client.log.contains("The sensor's process was restarted in 1 iteration (number 13)"),
        "{}",
        client.log
    );
    let data = lab.data("results");
    assert_eq!((data.count_outcome("ok"), data.count_outcome("failed")), (14, 2));
    let cells_of = |column: &str| -> Vec<f64> {
        let cells = data.column(column).into_iter().filter(|cell| !cell.is_empty());
        cells.map(|cell| cell.parse().expect("a number")).collect()
    };
    for column in ["restart", "capture_capture-restart"] {
        let seconds = cells_of(column);
        assert!(seconds.len() == 1 && seconds[0] >= 0.3, "{column}: {seconds:?}");
    }
    // The time of the restart belongs neither to the model nor to the transfer, so it is unattributed.
    assert!(cells_of("unattributed").into_iter().fold(0.0, f64::max) >= cells_of("restart")[0]);
    drop(server);
}

#[test]
fn server_prints_number_of_error_answers() {
    let lab = Lab::on_one_machine();
    std::fs::write(lab.folder().join("my_model.py"), REFUSING_MODEL).expect("writable");
    let server = lab.start_server(
        "PEERNet --server --name cluster --network-config net_config.yaml --model-name my_model::Odd --iterations 10",
    );
    let client = lab.start_client(
        "PEERNet --client --name jetson-orin --network-config net_config.yaml --sensor-type synthetic --iterations 10 \
         --result-loc results",
    );
    let (client, server) = (client.wait_for_end(), server.wait_for_end());
    assert_eq!((client.code(), server.code()), (75, 0), "{}\n{}", client.log, server.log);
    assert!(server.log.contains("10 answers, 5 of them errors"), "{}", server.log);
    assert_eq!(lab.data("results").count_outcome("failed"), 5);
}

#[test]
fn programs_run_on_their_hosts() {
    let lab = Lab::on_one_machine();
    let light = peernet_tests::root().join("docs/examples/external/light.sh");
    let server = lab.start_server(
        "PEERNet --server --name cluster --network-config net_config.yaml --model-name echo --iterations 20",
    );
    let client = lab.start_client(&format!(
        "PEERNet --client --name jetson-orin --network-config net_config.yaml --sensor-object exec:{} \
         --iterations 20 --result-loc results",
        light.display()
    ));
    let (client, server) = (client.wait_for_end(), server.wait_for_end());
    assert_eq!((client.code(), server.code()), (0, 0), "{}\n{}", client.log, server.log);
    let sizes = lab.data("results").numbers("upload-bytes");
    assert!(sizes.len() == 20 && sizes.iter().all(|bytes| *bytes == 3072.0), "{sizes:?}");
}

#[test]
fn output_of_objects_is_printed_in_quiet_mode() {
    let lab = Lab::on_one_machine();
    let sensor = "
class Camera:
    def sample(self):
        print('the lens is clean')
        return b'x' * 100
";
    std::fs::write(lab.folder().join("my_camera.py"), sensor).expect("writable");
    let model = "
import sys

class Echo:
    def infer(self, x):
        print('a picture came', file=sys.stderr)
        return x
";
    std::fs::write(lab.folder().join("my_model.py"), model).expect("writable");
    let server = lab.start_server(
        "PEERNet --server --name cluster --network-config net_config.yaml --model-name my_model::Echo \
         --iterations 8 --quiet",
    );
    let client = lab.start_client(
        "PEERNet --client --name jetson-orin --network-config net_config.yaml --sensor-object my_camera::Camera \
         --iterations 8 --result-loc results --quiet",
    );
    let (client, server) = (client.wait_for_end(), server.wait_for_end());
    assert_eq!((client.code(), server.code()), (0, 0), "{}\n{}", client.log, server.log);
    let count_printed =
        |log: &str, line: &str| log.lines().filter(|printed_line| *printed_line == line).count();
    assert!(count_printed(&client.log, "sensor my_camera::Camera: the lens is clean") >= 8, "{}", client.log);
    assert_eq!(count_printed(&server.log, "model my_model-Echo: a picture came"), 8, "{}", server.log);
}
