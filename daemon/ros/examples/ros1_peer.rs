//! A ROS 1 node that publishes, subscribes, echoes or measures, for the tests with programs of other projects
//! (`tests/interop/ros1`). Takes the master and its own address from the environment variables of ROS.
//!
//! ```text
//! ros1_peer publish NAME TOPIC COUNT BYTES      waits for a subscriber, publishes; prints counts at the input's end
//! ros1_peer latch NAME TOPIC TEXT               publishes a latched std_msgs/String, until standard input ends
//! ros1_peer subscribe NAME TOPIC COUNT          prints a line for each message: its number and bytes
//! ros1_peer rate NAME TOPIC COUNT               prints the messages per second between the first and the last
//! ros1_peer state NAME TOPIC                    prints states of a std_msgs/String topic's publishers until one fails
//! ros1_peer echo NAME IN OUT                    publishes what arrives until standard input ends
//! ros1_peer ping NAME OUT IN COUNT BYTES        round trips: prints the median and the 99th percentile in microseconds
//! ```
//! Messages are pictures (`sensor_msgs/CompressedImage`) unless stated otherwise. Byte i of picture n is (i + n) mod
//! 251.
#![expect(clippy::print_stdout, reason = "the tests read its output")]

use std::io::Read;
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::{Context as _, bail};
use bytes::Bytes;
use peernet_clock::{Clock, ClockIdentity, SystemClock};
use peernet_ros::messages::{CompressedImage, Header, Message, StringMessage, Time, WireForm};
use peernet_ros::ros1::{
    Environment, Node, PublishOutcome, PublisherOptions, PublisherState, SubscriberOptions, TopicType,
};

fn picture(number: usize, length: usize) -> CompressedImage {
    let pattern: Vec<u8> = (0..251).map(|index| ((index + number) % 251).to_le_bytes()[0]).collect();
    let mut data = pattern.repeat(length / 251 + 1);
    data.truncate(length);
    CompressedImage {
        header: Header { seq: 0, stamp: Time { sec: number as i64, nanosec: 0 }, frame_id: "camera".into() },
        format: "raw".into(),
        data: data.into(),
    }
}

fn print_line(line: &str) {
    println!("{line}");
}

async fn wait_for_end_of_input() {
    let (end_sender, end_receiver) = tokio::sync::oneshot::channel();
    // A thread outside the runtime does not keep the process alive.
    std::thread::spawn(move || {
        // An error is treated as the end of the input.
        let _ = std::io::stdin().read_to_end(&mut Vec::new());
        end_sender.send(())
    });
    let _ = end_receiver.await;
}

async fn publish(node: &Node, topic: &str, count: usize, length: usize) -> anyhow::Result<()> {
    let kind = TopicType::from_message::<CompressedImage>();
    let publisher = node.publish(topic, kind, PublisherOptions::default()).await?;
    print_line("ready");
    publisher.wait_for_subscribers(1).await?;
    for number in 0..count {
        let PublishOutcome { dropped, .. } =
            publisher.publish_waiting(picture(number, length).encode(WireForm::Ros1)?).await?;
        anyhow::ensure!(dropped == 0, "message {number} was dropped");
    }
    // A message counts as sent when the kernel has accepted it, so the node must not end yet. The test ends the input
    // when the subscriber has printed all messages.
    wait_for_end_of_input().await;
    let counts = publisher.counts();
    print_line(&format!(
        "offered {} sent {} dropped {} lost {}",
        counts.offered, counts.sent, counts.dropped, counts.lost
    ));
    Ok(())
}

async fn latch(node: &Node, topic: &str, text: &str) -> anyhow::Result<()> {
    let options = PublisherOptions { is_latching: true, ..PublisherOptions::default() };
    let publisher = node.publish(topic, TopicType::from_message::<StringMessage>(), options).await?;
    publisher.publish(StringMessage { data: text.into() }.encode(WireForm::Ros1)?)?;
    print_line("ready");
    wait_for_end_of_input().await;
    Ok(())
}

async fn subscribe(node: &Node, topic: &str, count: usize) -> anyhow::Result<()> {
    let mut subscriber = node.subscribe(topic, TopicType::any(), SubscriberOptions::default()).await?;
    print_line("ready");
    for _ in 0..count {
        let message = subscriber.recv().await?;
        if &*message.publisher.kind.name == "std_msgs/String" {
            print_line(&format!("text {}", StringMessage::decode(WireForm::Ros1, message.bytes)?.data));
            continue;
        }
        let image = CompressedImage::decode(WireForm::Ros1, message.bytes)?;
        let number = usize::try_from(image.header.stamp.sec)?;
        let is_intact = image.data == picture(number, image.data.len()).data;
        let state = if is_intact { "intact" } else { "damaged" };
        print_line(&format!("picture {number} {} {state} from {}", image.data.len(), message.publisher.node));
    }
    let counts = subscriber.counts();
    print_line(&format!("messages {} dropped {}", counts.messages, counts.dropped));
    Ok(())
}

async fn rate(node: &Node, topic: &str, count: usize) -> anyhow::Result<()> {
    let mut subscriber = node.subscribe(topic, TopicType::any(), SubscriberOptions::default()).await?;
    print_line("ready");
    let first = subscriber.recv().await?.received.mono;
    let mut last = first;
    for _ in 1..count {
        last = subscriber.recv().await?.received.mono;
    }
    let seconds = (last - first).nanos() as f64 / 1e9;
    print_line(&format!("rate {:.0} dropped {}", (count - 1) as f64 / seconds, subscriber.counts().dropped));
    Ok(())
}

async fn state(node: &Node, topic: &str) -> anyhow::Result<()> {
    let kind = TopicType::from_message::<StringMessage>();
    let subscriber = node.subscribe(topic, kind, SubscriberOptions::default()).await?;
    loop {
        let changed = subscriber.publishers_changed();
        for publisher in subscriber.publishers() {
            match publisher.state {
                PublisherState::Connecting => {}
                PublisherState::Connected(info) => print_line(&format!("connected to {}", info.node)),
                PublisherState::Failed(reason) => {
                    print_line(&format!("failed: {reason}"));
                    return Ok(());
                }
            }
        }
        changed.await;
    }
}

async fn echo(node: &Node, input_topic: &str, output_topic: &str) -> anyhow::Result<()> {
    let kind = TopicType::from_message::<CompressedImage>();
    let publisher = node.publish(output_topic, kind.clone(), PublisherOptions::default()).await?;
    let mut subscriber = node.subscribe(input_topic, kind, SubscriberOptions::default()).await?;
    print_line("ready");
    tokio::select! {
        () = wait_for_end_of_input() => Ok(()),
        result = async {
            loop {
                let message = subscriber.recv().await?;
                publisher.publish_waiting(message.bytes).await?;
            }
        } => result,
    }
}

async fn ping(
    node: &Node,
    request_topic: &str,
    response_topic: &str,
    count: usize,
    length: usize,
) -> anyhow::Result<()> {
    let clock = SystemClock::new(ClockIdentity::new("peer", "peer"));
    let kind = TopicType::from_message::<CompressedImage>();
    let mut subscriber = node.subscribe(response_topic, kind.clone(), SubscriberOptions::default()).await?;
    let publisher = node.publish(request_topic, kind, PublisherOptions::default()).await?;
    publisher.wait_for_subscribers(1).await?;
    subscriber.wait_for_publishers(1).await?;
    let image = picture(0, length);
    // A rospy node may be listed as connected before it sends messages, so the message is repeated until an answer
    // arrives. The answers to the repeated messages are then read until no more arrive.
    let retry_interval = std::time::Duration::from_millis(300);
    let mut has_answer = false;
    loop {
        if !has_answer {
            publisher.publish(image.encode(WireForm::Ros1)?)?;
        }
        match tokio::time::timeout(retry_interval, subscriber.recv()).await {
            Ok(message) => has_answer = message.is_ok(),
            Err(_) if has_answer => break,
            Err(_) => {}
        }
    }
    let mut micros = Vec::with_capacity(count);
    for _ in 0..count {
        let start = clock.mono();
        publisher.publish_waiting(image.encode(WireForm::Ros1)?).await?;
        let bytes: Bytes = subscriber.recv().await?.bytes;
        micros.push((clock.mono() - start).nanos() / 1000);
        anyhow::ensure!(
            CompressedImage::decode(WireForm::Ros1, bytes)?.data == image.data,
            "the answer has another picture"
        );
    }
    micros.sort_unstable();
    let quantile = |percent: usize| micros[(micros.len() - 1) * percent / 100];
    let total: i64 = micros.iter().sum();
    let rate = count as f64 * 1e6 / total as f64;
    print_line(&format!("median {} p99 {} rate {rate:.0}", quantile(50), quantile(99)));
    Ok(())
}

async fn run(arguments: &[String]) -> anyhow::Result<()> {
    let [command, name, parameters @ ..] = arguments else { bail!("usage: see the head of ros1_peer.rs") };
    let clock = Arc::new(SystemClock::new(ClockIdentity::new("peer", "peer")));
    let node = Node::new(&Environment::from_process()?, name, clock).await?;
    let parameters: Vec<&str> = parameters.iter().map(String::as_str).collect();
    match (command.as_str(), parameters.as_slice()) {
        ("publish", [topic, count, length]) => publish(&node, topic, count.parse()?, length.parse()?).await,
        ("latch", [topic, text]) => latch(&node, topic, text).await,
        ("subscribe", [topic, count]) => subscribe(&node, topic, count.parse()?).await,
        ("rate", [topic, count]) => rate(&node, topic, count.parse()?).await,
        ("state", [topic]) => state(&node, topic).await,
        ("echo", [from, to]) => echo(&node, from, to).await,
        ("ping", [out, back, count, length]) => ping(&node, out, back, count.parse()?, length.parse()?).await,
        _ => bail!("unknown command {command} with {} arguments", parameters.len()),
    }?;
    node.shutdown().await.context("cannot shut down the node")
}

#[tokio::main]
async fn main() -> ExitCode {
    tracing_subscriber::fmt().with_writer(std::io::stderr).init();
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match run(&arguments).await {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            print_line(&format!("error: {error:#}"));
            ExitCode::FAILURE
        }
    }
}
