//! Test of the output of custom code during an experiment.

use peernet_tests::{LoopbackDeployment, Process, program};

const SENSOR: &str = r#"
class Camera:
    def __init__(self):
        self.taken = 0

    def sample(self):
        self.taken += 1
        print("frame", self.taken)
        return b"x"

camera = Camera()
"#;

const EXPERIMENT: &str = "
[experiment]
name = 'printing'
iterations = 4
warm_up = { iterations = 0 }
plots = false

[pipeline]
sensor = { kind = 'python', object = 'mine::camera' }
placement = { kind = 'none' }
";

#[test]
fn program_output_is_printed_with_its_source() {
    let deployment = LoopbackDeployment::new();
    deployment.write("mine.py", SENSOR);
    deployment.write("experiment.toml", EXPERIMENT);
    let arguments = ["run", "experiment.toml", "--result-loc", "results"];
    let end = Process::start(&program("peernet"), &arguments, deployment.folder(), &[]).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);
    let begin = end.log.find(": begins").expect("the begin of the run is printed");
    let finish = end.log.find(": finished after").expect("the end of the run is printed");
    let run = &end.log[begin..finish];
    for frame in 1..=4 {
        assert!(run.contains(&format!("\nsensor mine::camera: frame {frame}\n")), "{frame}: {}", end.log);
    }
    assert!(end.log.contains("1 of 1 run finished"), "{}", end.log);
}
