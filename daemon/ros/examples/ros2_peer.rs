//! Publishes, receives or echoes patterned messages, for the tests with ROS 2 programs of other projects.
//!
//! `ros2_peer publish|receive TOPIC string|image COUNT BYTES`, `ros2_peer echo TOPIC string|image COUNT`. Domain and
//! interface come from `ROS_DOMAIN_ID` and `ROS_LOCALHOST_ONLY`.

#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a test program prints its results")]

use std::error::Error;
use std::time::Duration;

use bytes::{BufMut, Bytes, BytesMut};
use peernet_clock::{Clock, ClockIdentity, SystemClock};
use peernet_ros::ros2::{QosProfile, Ros2Node, Ros2Settings};

type PeerResult = Result<(), Box<dyn Error + Send + Sync>>;

/// Size from which on messages are acknowledged one by one, bytes.
const LARGE_BYTES: usize = 500_000;

/// Longest wait for a peer, a message or an acknowledgement.
const TIME_LIMIT: Duration = Duration::from_secs(20);

#[derive(Clone, Copy)]
enum Kind {
    String,
    Image,
}

impl Kind {
    fn type_name(self) -> &'static str {
        match self {
            Self::String => "std_msgs/msg/String",
            Self::Image => "sensor_msgs/msg/CompressedImage",
        }
    }

    /// Returns message `number` of a sequence.
    fn message(self, size: usize, number: usize) -> Bytes {
        let mut cdr = BytesMut::from(&[0, 1, 0, 0][..]);
        match self {
            Self::String => {
                cdr.put_u32_le(u32::try_from(size + 1).unwrap_or(u32::MAX));
                cdr.extend((0..size).map(|index| b'a' + ((index + number) % 26) as u8));
                cdr.put_u8(0);
            }
            Self::Image => {
                // The seconds of `stamp` are the number of the message. The nanoseconds have no meaning.
                cdr.put_u32_le(u32::try_from(number).unwrap_or(u32::MAX));
                cdr.put_u32_le(7);
                // `frame_id` and `format`, both with the terminating zero and padded to four bytes.
                cdr.put_slice(b"\x04\0\0\0cam\0\x05\0\0\0jpeg\0\0\0\0");
                cdr.put_u32_le(u32::try_from(size).unwrap_or(u32::MAX));
                cdr.extend((0..size).map(|index| ((index * 31 + number) % 256) as u8));
            }
        }
        cdr.freeze()
    }
}

/// The arguments of the program.
struct Plan {
    topic: String,
    kind: Kind,
    count: usize,
    size: usize,
}

#[tokio::main]
async fn main() -> PeerResult {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let usage = "ros2_peer publish|receive|echo TOPIC string|image COUNT [BYTES]";
    let [mode, topic, kind, count, size @ ..] = &arguments[..] else { return Err(usage.into()) };
    let kind = match kind.as_str() {
        "string" => Kind::String,
        "image" => Kind::Image,
        _ => return Err(usage.into()),
    };
    let size = size.first().map_or(Ok(0), |size| size.parse())?;
    let plan = Plan { topic: topic.clone(), kind, count: count.parse()?, size };
    let node = Ros2Node::new(Ros2Settings::default()).await?;
    for warning in node.socket_buffer_warnings() {
        eprintln!("warning: {warning}");
    }
    match mode.as_str() {
        "publish" => publish(&node, &plan).await?,
        "receive" => receive(&node, &plan).await?,
        "echo" => echo(&node, &plan).await?,
        _ => return Err(usage.into()),
    }
    Ok(node.shut_down().await?)
}

fn clock() -> Result<SystemClock, Box<dyn Error + Send + Sync>> {
    Ok(SystemClock::new(ClockIdentity::from_system("system")?))
}

/// Returns a profile that keeps more messages than are sent. With the usual depth of ten, a lost message may be
/// replaced before it is sent again.
fn deep_queue_qos() -> QosProfile {
    QosProfile { depth: 100, ..QosProfile::default() }
}

async fn publish(node: &Ros2Node, plan: &Plan) -> PeerResult {
    let clock = clock()?;
    let publisher = node.create_publisher(&plan.topic, plan.kind.type_name(), &deep_queue_qos())?;
    publisher.wait_for_peer(TIME_LIMIT).await?;
    // The subscription may not have discovered this publisher yet, and would then miss messages. DDS does not report
    // when the subscription has discovered the publisher.
    tokio::time::sleep(Duration::from_secs(1)).await;
    for number in 0..plan.count {
        publisher.publish(plan.kind.message(plan.size, number), clock.wall()).await?;
        // Cyclone DDS skips the messages that its first received heartbeat announces. This heartbeat may arrive only
        // after the first message. The wait after the first message keeps later messages out of this heartbeat.
        // Large messages are acknowledged one by one: if all were sent at once, 40 MB would overflow the sockets'
        // buffers, and Fast DDS might never get a message repaired.
        if number == 0 || plan.size >= LARGE_BYTES {
            publisher.wait_for_acknowledgment(TIME_LIMIT).await?;
        }
    }
    publisher.wait_for_acknowledgment(TIME_LIMIT).await?;
    println!("published and acknowledged: {}", plan.count);
    Ok(())
}

async fn receive(node: &Ros2Node, plan: &Plan) -> PeerResult {
    let mut subscription = node.create_subscription(&plan.topic, plan.kind.type_name(), &deep_queue_qos())?;
    let mut payloads = Vec::with_capacity(plan.count);
    while payloads.len() < plan.count {
        let received = tokio::time::timeout(TIME_LIMIT, subscription.receive()).await;
        let received =
            received.map_err(|_| format!("only {} of {} messages arrived", payloads.len(), plan.count))??;
        payloads.push(received.payload);
    }
    // The messages are compared after all have arrived, because messages that are not read before the publisher leaves
    // are lost.
    for (number, payload) in payloads.iter().enumerate() {
        let expected = plan.kind.message(plan.size, number);
        // Up to three bytes of padding may follow a message in CDR.
        if !payload.starts_with(&expected) || payload.len() >= expected.len() + 4 {
            return Err(format!("message {number} differs from the published message").into());
        }
    }
    // The publisher waits for acknowledgements, so the subscription stays open until the publisher has ended.
    let mut peers = subscription.peers();
    let publisher_lost = peers.wait_for(|peers| peers.matched.is_empty());
    tokio::time::timeout(TIME_LIMIT, publisher_lost)
        .await
        .map_err(|_| "the publisher did not end in time")??;
    let counts = subscription.counts();
    println!("received unchanged: {} (lost {})", counts.received, counts.lost);
    if counts.lost == 0 { Ok(()) } else { Err("messages were lost".into()) }
}

/// Echoes every message of `TOPIC/ping` on `TOPIC/pong`.
async fn echo(node: &Ros2Node, plan: &Plan) -> PeerResult {
    let clock = clock()?;
    let (ping, pong) = (format!("{}/ping", plan.topic), format!("{}/pong", plan.topic));
    let publisher = node.create_publisher(&pong, plan.kind.type_name(), &QosProfile::default())?;
    let mut subscription = node.create_subscription(&ping, plan.kind.type_name(), &QosProfile::default())?;
    for _ in 0..plan.count {
        let received = tokio::time::timeout(TIME_LIMIT, subscription.receive()).await??;
        publisher.publish(received.payload, clock.wall()).await?;
    }
    Ok(publisher.wait_for_acknowledgment(TIME_LIMIT).await?)
}
