//! Ping-pong between two nodes of roslibrust over TCPROS, with messages of bytes that are not serialized. A message
//! that is not answered in time is given up.
//!
//! `roslibrust-peer serve`, and at the same time `roslibrust-peer drive BYTES SECONDS`, which prints one JSON object.
//! `ROS_MASTER_URI` names the master.

#[path = "../peers/round_trips.rs"]
mod round_trips;

use std::time::Duration;

use anyhow::{Context, bail};
use bytes::Bytes;
use roslibrust::ros1::{NodeHandle, PublisherAny, SubscriberAny};
use serde_json::Value;
use tokio::time::timeout;

use self::round_trips::RoundTrips;

/// Capacity of each queue, messages.
const QUEUE_MESSAGES: usize = 16;

/// Longest wait for an answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(2);

/// Longest wait for the other end.
const DISCOVERY_TIMEOUT: Duration = Duration::from_secs(30);

/// Length of the head, bytes: length of the message, length of its text, and its number.
const HEAD_BYTES: usize = 4 + 4 + 8;

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["serve"] => serve().await,
        ["drive", bytes, seconds] => {
            println!("{}", drive(bytes.parse()?, seconds.parse()?).await?);
            Ok(())
        }
        _ => bail!("usage: roslibrust-peer serve | roslibrust-peer drive BYTES SECONDS"),
    }
}

struct Endpoint {
    publisher: PublisherAny,
    subscriber: SubscriberAny,
    _node: NodeHandle,
}

impl Endpoint {
    async fn open(name: &str, outgoing: &str, incoming: &str) -> anyhow::Result<Self> {
        let master = std::env::var("ROS_MASTER_URI").context("ROS_MASTER_URI is not set")?;
        let node = NodeHandle::new(&master, name).await.context("the master does not answer")?;
        Ok(Self {
            publisher: node
                .advertise_any(outgoing, "std_msgs/String", "string data", QUEUE_MESSAGES, false)
                .await?,
            subscriber: node.subscribe_any(incoming, QUEUE_MESSAGES).await?,
            _node: node,
        })
    }

    async fn receive(&mut self) -> anyhow::Result<Bytes> {
        Ok(self.subscriber.next().await.context("the node has ended")??)
    }

    /// Sends a message and waits for its answer; answers to earlier messages are skipped.
    async fn exchange(&mut self, message: &[u8]) -> anyhow::Result<()> {
        self.publisher.publish(message).await?;
        while self.receive().await?.get(..HEAD_BYTES) != message.get(..HEAD_BYTES) {}
        Ok(())
    }
}

async fn serve() -> anyhow::Result<()> {
    let mut endpoint = Endpoint::open("/roslibrust_serve", "/roslibrust_down", "/roslibrust_up").await?;
    loop {
        let message = endpoint.receive().await?;
        endpoint.publisher.publish(&message).await?;
    }
}

async fn drive(length: usize, seconds: u64) -> anyhow::Result<Value> {
    let mut endpoint = Endpoint::open("/roslibrust_drive", "/roslibrust_up", "/roslibrust_down").await?;
    let text_bytes = u32::try_from(length.max(8))?;
    let mut message = [(text_bytes + 4).to_le_bytes(), text_bytes.to_le_bytes()].concat();
    message.resize(8 + text_bytes as usize, 0x5a);
    let mut number = 0_u64;
    let discovery = async {
        // A message that is sent before the other end has subscribed does not arrive.
        loop {
            number += 1;
            message[8..HEAD_BYTES].copy_from_slice(&number.to_le_bytes());
            if let Ok(result) = timeout(Duration::from_millis(300), endpoint.exchange(&message)).await {
                // As in the measurement below, an error ends the program.
                return result;
            }
        }
    };
    timeout(DISCOVERY_TIMEOUT, discovery)
        .await
        .context("nobody answered; is `roslibrust-peer serve` running?")??;
    let mut round_trips = RoundTrips::new(seconds)?;
    while let Some(begin) = round_trips.next() {
        number += 1;
        message[8..HEAD_BYTES].copy_from_slice(&number.to_le_bytes());
        match timeout(ANSWER_TIMEOUT, endpoint.exchange(&message)).await {
            Ok(result) => {
                result?;
                round_trips.record(begin, Some(&[]));
            }
            Err(_) => round_trips.record(begin, None),
        }
    }
    round_trips.figures()
}
