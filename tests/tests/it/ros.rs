//! Tests of sensor and actuator `ros` in real agents, with the master of ROS 1 and a node in this process as the
//! robot.

use std::path::Path;
use std::sync::Arc;

use peernet_clock::{Clock, ClockIdentity, SystemClock};
use peernet_ros::messages::{
    CompressedImage, Header, Message, StringMessage, Time, UInt8MultiArray, WireForm,
};
use peernet_ros::ros1::{
    Environment, Node, Publisher, PublisherOptions, RpcUri, Subscriber, SubscriberOptions, TopicType,
    topic_types,
};
use peernet_tests::{LoopbackDeployment, Process, wait_until};
use tokio::runtime::Runtime;

/// A ROS master, and a node that stands for a node of the robot.
struct Robot {
    runtime: Runtime,
    node: Node,
    _master: Process,
}

fn environment(port: u16) -> Environment {
    Environment {
        master: RpcUri::parse(&uri(port)).expect("is a URI"),
        advertised_host: Some("127.0.0.1".to_owned()),
        namespace: "/".to_owned(),
    }
}

fn uri(port: u16) -> String {
    format!("http://127.0.0.1:{port}")
}

fn clock() -> SystemClock {
    SystemClock::new(ClockIdentity::new("test", "test"))
}

impl Robot {
    /// Starts the master on the deployment's data port, which no cloud uses here.
    fn start(deployment: &LoopbackDeployment) -> Self {
        let port = deployment.data_port;
        let arguments = ["--core", "-p", &port.to_string()];
        let home = deployment.folder().display().to_string();
        let master =
            Process::start(Path::new("rosmaster"), &arguments, deployment.folder(), &[("ROS_HOME", &home)]);
        let runtime = Runtime::new().expect("a runtime");
        let environment = environment(port);
        wait_until("the ROS master", || runtime.block_on(topic_types(&environment)).ok());
        let node = runtime.block_on(Node::new(&environment, "robot", Arc::new(clock())));
        Self { node: node.expect("the master answers"), runtime, _master: master }
    }

    fn advertise<M: Message>(&self, topic: &str) -> Publisher {
        let registration =
            self.node.publish(topic, TopicType::from_message::<M>(), PublisherOptions::default());
        self.runtime.block_on(registration).expect("the master answers")
    }

    fn subscribe<M: Message>(&self, topic: &str) -> Subscriber {
        let registration =
            self.node.subscribe(topic, TopicType::from_message::<M>(), SubscriberOptions::default());
        self.runtime.block_on(registration).expect("the master answers")
    }

    fn send<M: Message>(&self, publisher: &Publisher, message: &M) {
        let encoded = message.encode(WireForm::Ros1).expect("can be encoded");
        let sent = self.runtime.block_on(publisher.publish_waiting(encoded)).expect("the node runs");
        assert_eq!(sent.subscribers, 1);
    }

    fn wait_for_subscriber(&self, publisher: &Publisher) {
        self.runtime.block_on(publisher.wait_for_subscribers(1)).expect("the node runs");
    }
}

/// Writes the configuration of an agent that uses the ROS master, and starts it.
fn start_agent(deployment: &LoopbackDeployment, tables: &str) -> Process {
    let head = "[agent]\nname = \"edge\"\nstate_dir = \"{folder}/edge\"\naggregator = \"tcp://127.0.0.1:{events}\"\n";
    deployment.write("edge.toml", &(head.to_owned() + tables));
    deployment.start_with(
        "edge.toml",
        &[("ROS_MASTER_URI", &uri(deployment.data_port)), ("ROS_IP", "127.0.0.1"), ("ROS_VERSION", "1")],
    )
}

const ECHO: &str = r#"
[[model]]
name = "echo"
kind = "echo"

[[pipeline]]
name = "look"
sensor = { kind = "ros", topic = "/camera", stamp_clock = "host" }
placement = { kind = "local", model = "echo" }
actuator = { kind = "ros", topic = "/seen", type = "std_msgs/UInt8MultiArray" }
warm_up = { iterations = 0 }
limit = { total = 10 }
"#;

#[test]
fn topic_is_sensed_and_answers_are_published() {
    let deployment = LoopbackDeployment::new();
    let (_aggregator, api) = deployment.start_aggregator();
    let robot = Robot::start(&deployment);
    let camera = robot.advertise::<CompressedImage>("/camera");
    let mut answers = robot.subscribe::<UInt8MultiArray>("/seen");
    let edge = start_agent(&deployment, ECHO);
    robot.wait_for_subscriber(&camera);
    robot.runtime.block_on(answers.wait_for_publishers(1)).expect("the node runs");
    for number in 0..10_u8 {
        let stamp = Time::from_nanos(clock().wall().unix_nanos() - 20_000_000);
        let header = Header { stamp, ..Header::default() };
        let data = vec![number; 1_000_000].into();
        robot.send(&camera, &CompressedImage { header, format: "jpeg".into(), data });
        let answer = robot.runtime.block_on(answers.recv()).expect("the node runs").bytes;
        let answer = UInt8MultiArray::decode(WireForm::Ros1, answer).expect("the answer has this type");
        assert_eq!((answer.data.len(), answer.data[999_999]), (1_000_000, number));
    }
    let run = api.wait_for_finished_run();
    assert_eq!(api.json(&format!("/api/v1/runs/{run}"))["counts"]["ok"].as_u64(), Some(10));
    assert_eq!((api.mean(run, "dropped-samples"), api.mean(run, "dropped-answers")), (0.0, 0.0));
    // Each message was stamped 20 ms before it was published.
    let delay = api.mean(run, "capture-delay");
    assert!((0.02..5.0).contains(&delay), "{delay}");
    assert_eq!(edge.stop().code(), 0);
}

const BUSY_PIPELINE: &str = r#"
[[model]]
name = "slow"
kind = "sleep"
inference_ms = 1000

[[pipeline]]
name = "listen"
sensor = { kind = "ros", topic = "/words", type = "std_msgs/String" }
placement = { kind = "local", model = "slow" }
warm_up = { iterations = 0 }
limit = { total = 2 }
"#;

#[test]
fn busy_pipeline_counts_dropped_messages() {
    let deployment = LoopbackDeployment::new();
    let (_aggregator, api) = deployment.start_aggregator();
    let robot = Robot::start(&deployment);
    let words = robot.advertise::<StringMessage>("/words");
    let edge = start_agent(&deployment, BUSY_PIPELINE);
    robot.wait_for_subscriber(&words);
    for number in 0..10 {
        robot.send(&words, &StringMessage { data: format!("word {number}") });
    }
    let run = api.wait_for_finished_run();
    // One or two messages were sensed, the newest among them: the first one may have been replaced before the sensor
    // read it. In that case, no second message arrives, and the second iteration fails.
    let sensed = api.json(&format!("/api/v1/runs/{run}"))["counts"]["ok"].as_f64().expect("a number");
    // A sensed message has the number of messages that it replaced, so all ten are counted.
    assert_eq!(sensed + sensed * api.mean(run, "dropped-samples"), 10.0);
    // Texts have no header, so there is no capture time.
    assert!(api.stage_statistics(run, "capture-delay").is_none());
    assert_eq!(edge.stop().code(), 0);
}

const SENSOR_ALONE: &str = r#"
[[pipeline]]
name = "listen"
sensor = { kind = "ros", topic = "/words", type = "std_msgs/String", timeout_ms = 300 }
placement = { kind = "none" }
warm_up = { iterations = 0 }
"#;

#[test]
fn pipeline_waits_for_late_master() {
    let deployment = LoopbackDeployment::new();
    let (_aggregator, api) = deployment.start_aggregator();
    let edge = start_agent(&deployment, SENSOR_ALONE);
    let wait_for_incident = |text: &str| {
        api.wait_until("/api/v1/incidents", |incidents| incidents.to_string().contains(text).then_some(()));
    };
    wait_for_incident("start roscore there, or set ROS_MASTER_URI");
    let robot = Robot::start(&deployment);
    let words = robot.advertise::<StringMessage>("/words");
    robot.wait_for_subscriber(&words);
    robot.send(&words, &StringMessage { data: "at last".into() });
    api.wait_until("/api/v1/runs", |runs| (runs["runs"][0]["counts"]["ok"].as_u64()? > 0).then_some(()));
    assert_eq!(edge.stop().code(), 0);
}

/// Checks one pipeline; returns the exit code and the output.
fn check(deployment: &LoopbackDeployment, sensor: &str, actuator: &str) -> (i32, String) {
    let text = format!(
        "[agent]\nstate_dir = \"{{folder}}/edge\"\n[[model]]\nname = \"echo\"\nkind = \"echo\"\n[[pipeline]]\nname = \"one\"\n\
         sensor = {{ kind = \"ros\", {sensor} }}\nactuator = {{ kind = \"ros\", {actuator} }}\n\
         placement = {{ kind = \"local\", model = \"echo\" }}\n"
    );
    let file = deployment.write("check.toml", &text).display().to_string();
    let uri = uri(deployment.data_port);
    let environment = [("ROS_MASTER_URI", uri.as_str()), ("ROS_IP", "127.0.0.1")];
    let program = peernet_tests::program("peernetd");
    let end = Process::start(&program, &["check", &file], deployment.folder(), &environment).wait_for_end();
    (end.code(), end.log)
}

#[test]
fn check_names_topic_errors() {
    let deployment = LoopbackDeployment::new();
    let [sensor, actuator] = ["topic = \"/words\", ros_version = 1", "topic = \"/answers\", ros_version = 1"];
    let (code, output) = check(&deployment, "topic = \"/words\"", actuator);
    assert_eq!(code, 78, "{output}");
    assert!(
        output.contains("pipeline[0].sensor: the version of ROS is not configured; set ros_version = 1 or 2"),
        "{output}"
    );
    let (code, output) =
        check(&deployment, "topic = \"/words\", type = \"words\", ros_version = 1", actuator);
    assert_eq!(code, 78, "{output}");
    assert!(output.contains("`words` is not the name of a ROS message type"), "{output}");
    if !peernet_ros::ros2::IS_BUILT {
        let (code, output) = check(&deployment, sensor, "topic = \"/answers\", ros_version = 2");
        assert_eq!(code, 78, "{output}");
        assert!(output.contains("pipeline[0].actuator: this build has no ROS 2"), "{output}");
    }
    // A condition that may soon change leads to a note, not to an error.
    let (code, output) = check(&deployment, sensor, actuator);
    assert_eq!(code, 0, "{output}");
    assert!(
        output.contains("note: pipeline[0].sensor: no ROS master answers at http://127.0.0.1:"),
        "{output}"
    );
    let robot = Robot::start(&deployment);
    let (_, output) = check(&deployment, sensor, actuator);
    assert!(output.contains("does not know topic /words yet; it knows no topic at all"), "{output}");
    let _words = robot.advertise::<StringMessage>("/words");
    let _answers = robot.advertise::<CompressedImage>("/answers");
    let (code, output) = check(&deployment, &format!("{sensor}, type = \"sensor_msgs/Image\""), actuator);
    assert_eq!(code, 0, "{output}");
    for part in [
        "pipeline[0].sensor: topic /words has the type std_msgs/String, not sensor_msgs/Image",
        "pipeline[0].actuator: topic /answers has the type sensor_msgs/CompressedImage, not std_msgs/String",
    ] {
        assert!(output.contains(part), "{part} is missing in:\n{output}");
    }
}
