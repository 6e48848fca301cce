//! ROS 1 node for tests: a camera, or a node that answers after a known time.
//!
//! ```text
//! ros1-node camera NAME TOPIC HZ              publishes stamped messages
//! ros1-node relay NAME IN OUT DELAY_MS DROP   publishes messages DELAY_MS later, not every DROPth (0: all)
//! ros1-node restamp NAME IN OUT DELAY_MS      as relay; keeps the sequence number and stamps each message with the present time
//! ros1-node talk NAME TOPIC                   publishes texts, which have no header
//! ```
//! A relay prints the median of its actual delay, in microseconds, after each 20 messages.
#![expect(clippy::print_stdout, reason = "the tests read what it prints")]

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context as _, bail};
use bytes::Bytes;
use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
use peernet_ros::messages::{CompressedImage, Header, Message, StringMessage, Time, WireForm};
use peernet_ros::ros1::{Environment, Node, PublisherOptions, SubscriberOptions, TopicType};

/// Number of messages after which a relay prints its delay.
const REPORTED_MESSAGES: usize = 20;

/// Treatment of the messages that a relay receives.
struct Relay {
    /// Time before a message is published.
    delay: Duration,
    /// Every message whose number is a multiple of this is not published; 0: all are.
    drop_interval: usize,
    /// `true` to set `header.stamp` to the time of publishing.
    restamps: bool,
}

fn print_line(line: &str) {
    println!("{line}");
}

async fn run_camera(node: &Node, clock: &SharedClock, topic: &str, hz: f64) -> anyhow::Result<()> {
    let publisher = node
        .publish(topic, TopicType::from_message::<CompressedImage>(), PublisherOptions::default())
        .await?;
    print_line("ready");
    let mut ticks = tokio::time::interval(Duration::from_secs_f64(1.0 / hz));
    for seq in 0.. {
        ticks.tick().await;
        let stamp = Time::from_nanos(clock.wall().unix_nanos());
        let header = Header { seq, stamp, frame_id: "camera".into() };
        let picture =
            CompressedImage { header, format: "jpeg".into(), data: Bytes::from_static(&[7; 10_000]) };
        publisher.publish(picture.encode(WireForm::Ros1)?)?;
    }
    Ok(())
}

async fn run_relay(
    node: &Node,
    clock: &SharedClock,
    [from, to]: [&str; 2],
    Relay { delay, drop_interval, restamps }: Relay,
) -> anyhow::Result<()> {
    let kind = TopicType::from_message::<CompressedImage>();
    let publisher = node.publish(to, kind.clone(), PublisherOptions::default()).await?;
    let mut subscriber = node.subscribe(from, kind, SubscriberOptions::default()).await?;
    print_line("ready");
    let mut delays_us = Vec::new();
    for number in 1.. {
        let message = subscriber.recv().await?;
        let begin = clock.mono();
        if drop_interval > 0 && number % drop_interval == 0 {
            continue;
        }
        // Timers of tokio would round up to whole milliseconds.
        std::thread::sleep(delay);
        if restamps {
            let mut picture = CompressedImage::decode(WireForm::Ros1, message.bytes)?;
            picture.header.stamp = Time::from_nanos(clock.wall().unix_nanos());
            publisher.publish(picture.encode(WireForm::Ros1)?)?;
        } else {
            publisher.publish(message.bytes)?;
        }
        delays_us.push((clock.mono() - begin).nanos() / 1000);
        if delays_us.len() == REPORTED_MESSAGES {
            delays_us.sort_unstable();
            print_line(&format!("median {} us", delays_us[REPORTED_MESSAGES / 2]));
            delays_us.clear();
        }
    }
    Ok(())
}

async fn publish_texts(node: &Node, topic: &str) -> anyhow::Result<()> {
    let publisher =
        node.publish(topic, TopicType::from_message::<StringMessage>(), PublisherOptions::default()).await?;
    print_line("ready");
    let mut ticks = tokio::time::interval(Duration::from_millis(50));
    loop {
        ticks.tick().await;
        publisher.publish(StringMessage { data: "hello".into() }.encode(WireForm::Ros1)?)?;
    }
}

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [command, name, rest @ ..] = arguments.as_slice() else { bail!("usage: see the head of node.rs") };
    let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("test", "test")));
    let node = Node::new(&Environment::from_process()?, name, Arc::clone(&clock)).await?;
    let rest: Vec<&str> = rest.iter().map(String::as_str).collect();
    match (command.as_str(), rest.as_slice()) {
        ("camera", [topic, hz]) => run_camera(&node, &clock, topic, hz.parse()?).await,
        ("relay", [from, to, delay, drop_interval]) => {
            let delay = Duration::from_millis(delay.parse()?);
            run_relay(
                &node,
                &clock,
                [from, to],
                Relay { delay, drop_interval: drop_interval.parse()?, restamps: false },
            )
            .await
        }
        ("restamp", [from, to, delay]) => {
            let delay = Duration::from_millis(delay.parse()?);
            run_relay(&node, &clock, [from, to], Relay { delay, drop_interval: 0, restamps: true }).await
        }
        ("talk", [topic]) => publish_texts(&node, topic).await,
        _ => bail!("unknown command {command} with {} arguments", rest.len()),
    }?;
    node.shutdown().await.context("cannot shut down the node")
}
