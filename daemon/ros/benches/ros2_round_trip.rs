//! Closed-loop round trips over ROS 2 topics on loopback: our client against `rustdds` alone, in turns, in one run.
//!
//! `cargo bench -p peernet-ros --features ros2 --bench ros2_round_trip -- [BYTES …]`. Up and down goes the same
//! payload, reliable, between two participants of this process.

#![expect(clippy::print_stdout, reason = "a benchmark prints its table")]

use std::convert::Infallible;
use std::error::Error;
use std::pin::pin;
use std::time::{Duration, Instant};

use bytes::{BufMut, Bytes, BytesMut};
use futures::StreamExt;
use peernet_clock::WallTime;
use peernet_ros::ros2::{QosProfile, Ros2Node, Ros2Publisher, Ros2Settings, Ros2Subscription};
use rustdds::no_key::{
    DataWriter, Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter, SimpleDataReader,
};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, QosPolicies, RepresentationIdentifier, TopicKind,
};

type Anyhow<T> = Result<T, Box<dyn Error + Send + Sync>>;

const TYPE: &str = "std_msgs/msg/UInt8MultiArray";
const DDS_TYPE: &str = "std_msgs::msg::dds_::UInt8MultiArray_";
const PATIENCE: Duration = Duration::from_secs(20);
const TURNS: usize = 10;

#[tokio::main]
async fn main() -> Anyhow<()> {
    let given: Vec<usize> = std::env::args().skip(1).filter_map(|argument| argument.parse().ok()).collect();
    let sizes = if given.is_empty() { vec![1_000, 150_000, 1_200_000] } else { given };
    let client = Client::start().await?;
    let bare = Bare::start().await?;
    println!("{:>9}  {:>10}  {:>14}  {:>9}  {:>9}", "bytes", "", "round trips/s", "p50 µs", "p99 µs");
    for size in sizes {
        let rounds = if size > 500_000 { 40 } else { 200 };
        let payload = payload(size);
        let (mut of_client, mut of_bare) = (Vec::new(), Vec::new());
        // The first turn is for warming up.
        for turn in 0..=TURNS {
            let times =
                (client.round_trips(&payload, rounds).await?, bare.round_trips(&payload, rounds).await?);
            if turn > 0 {
                of_client.extend(times.0);
                of_bare.extend(times.1);
            }
        }
        let rates = (report(size, "peernet", of_client), report(size, "rustdds", of_bare));
        println!("{size:>9}  ratio {:.2}", rates.0 / rates.1);
    }
    Ok(())
}

fn payload(size: usize) -> Bytes {
    let mut cdr = BytesMut::from(&[0, 1, 0, 0][..]);
    cdr.put_bytes(7, size);
    cdr.freeze()
}

#[expect(clippy::disallowed_methods, reason = "a benchmark measures with the monotonic clock")]
fn now() -> Instant {
    Instant::now()
}

fn report(size: usize, name: &str, mut times: Vec<Duration>) -> f64 {
    times.sort();
    let total: Duration = times.iter().sum();
    let rate = times.len() as f64 / total.as_secs_f64();
    let at = |share: usize| times[times.len() * share / 100].as_secs_f64() * 1e6;
    println!("{size:>9}  {name:>10}  {rate:>14.0}  {:>9.0}  {:>9.0}", at(50), at(99));
    rate
}

/// Two nodes of ours; the second one echoes.
struct Client {
    publisher: Ros2Publisher,
    subscription: tokio::sync::Mutex<Ros2Subscription>,
    _nodes: [Ros2Node; 2],
}

impl Client {
    async fn start() -> Anyhow<Self> {
        let settings = Ros2Settings {
            domain_id: Some(221),
            interfaces: vec!["127.0.0.1".to_owned()],
            ..Ros2Settings::default()
        };
        let (near, far) = (Ros2Node::new(settings.clone()).await?, Ros2Node::new(settings).await?);
        let qos = QosProfile::default();
        let (publisher, subscription) =
            (near.publisher("/up", TYPE, &qos)?, near.subscription("/down", TYPE, &qos)?);
        let (answers, mut requests) =
            (far.publisher("/down", TYPE, &qos)?, far.subscription("/up", TYPE, &qos)?);
        publisher.await_peer(PATIENCE).await?;
        subscription.await_peer(PATIENCE).await?;
        answers.await_peer(PATIENCE).await?;
        requests.await_peer(PATIENCE).await?;
        tokio::spawn(async move {
            while let Ok(request) = requests.receive().await {
                if answers.publish(request.payload, WallTime::from_unix_nanos(1)).await.is_err() {
                    return;
                }
            }
        });
        Ok(Self { publisher, subscription: subscription.into(), _nodes: [near, far] })
    }

    async fn round_trips(&self, payload: &Bytes, count: usize) -> Anyhow<Vec<Duration>> {
        let mut subscription = self.subscription.lock().await;
        let mut times = Vec::with_capacity(count);
        for _ in 0..count {
            let start = now();
            self.publisher.publish(payload.clone(), WallTime::from_unix_nanos(1)).await?;
            subscription.receive().await?;
            times.push(start.elapsed());
        }
        Ok(times)
    }
}

/// Two participants of `rustdds`; the second one echoes.
struct Bare {
    writer: DataWriter<Bytes, Raw>,
    reader: SimpleDataReader<Bytes, Raw>,
    _participants: [DomainParticipant; 2],
}

impl Bare {
    async fn start() -> Anyhow<Self> {
        let participant =
            || DomainParticipantBuilder::new(222).with_only_networks([std::net::Ipv4Addr::LOCALHOST]).build();
        let (near, far) = (participant()?, participant()?);
        let bare = Self {
            writer: writer(&near, "rt/up")?,
            reader: reader(&near, "rt/down")?,
            _participants: [near, far.clone()],
        };
        let (answers, requests) = (writer(&far, "rt/down")?, reader(&far, "rt/up")?);
        tokio::spawn(async move {
            let mut incoming = pin!(requests.as_async_stream());
            while let Some(Ok(request)) = incoming.next().await {
                if answers.async_write(request.into_value(), None).await.is_err() {
                    return;
                }
            }
        });
        // Until both directions are matched, messages go nowhere.
        let probe = Bytes::from_static(&[0]);
        for _ in 0..PATIENCE.as_secs() * 10 {
            bare.writer.async_write(probe.clone(), None).await.map_err(|_| "cannot write")?;
            if bare.hears_something(Duration::from_millis(100)).await {
                // What else was under way arrives before the first turn.
                while bare.hears_something(Duration::from_millis(500)).await {}
                return Ok(bare);
            }
        }
        Err("rustdds did not match its own participants".into())
    }

    async fn hears_something(&self, patience: Duration) -> bool {
        let mut incoming = pin!(self.reader.as_async_stream());
        tokio::time::timeout(patience, incoming.next()).await.is_ok()
    }

    async fn round_trips(&self, payload: &Bytes, count: usize) -> Anyhow<Vec<Duration>> {
        let body = payload.slice(4..);
        let mut incoming = pin!(self.reader.as_async_stream());
        let mut times = Vec::with_capacity(count);
        for _ in 0..count {
            let start = now();
            self.writer.async_write(body.clone(), None).await.map_err(|_| "cannot write")?;
            incoming.next().await.ok_or("the stream ended")??;
            times.push(start.elapsed());
        }
        Ok(times)
    }
}

fn qos() -> QosPolicies {
    QosPolicies::builder()
        .reliable(rustdds::Duration::from_secs(1))
        .history(rustdds::policy::History::KeepLast { depth: 10 })
        .build()
}

fn writer(participant: &DomainParticipant, topic: &str) -> Anyhow<DataWriter<Bytes, Raw>> {
    let topic = participant.create_topic(topic.to_owned(), DDS_TYPE.to_owned(), &qos(), TopicKind::NoKey)?;
    Ok(participant.create_publisher(&qos())?.create_datawriter_no_key(&topic, None)?)
}

fn reader(participant: &DomainParticipant, topic: &str) -> Anyhow<SimpleDataReader<Bytes, Raw>> {
    let topic = participant.create_topic(topic.to_owned(), DDS_TYPE.to_owned(), &qos(), TopicKind::NoKey)?;
    Ok(participant.create_subscriber(&qos())?.create_simple_datareader_no_key(&topic, None)?)
}

/// Bytes that are serialized already.
#[derive(Clone)]
struct Raw;

impl SerializerAdapter<Bytes> for Raw {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(message: &Bytes) -> Result<Bytes, Infallible> {
        Ok(message.clone())
    }
}

impl DeserializerAdapter<Bytes> for Raw {
    type Error = Infallible;
    type Decoded = Bytes;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        const { &[RepresentationIdentifier::CDR_LE] }
    }

    fn transform_decoded(decoded: Bytes) -> Bytes {
        decoded
    }
}

impl DefaultDecoder<Bytes> for Raw {
    type Decoder = Self;
    const DECODER: Self = Self;
}

impl Decode<'_, Bytes> for Raw {
    type Error = Infallible;

    fn decode_bytes(self, bytes: &[u8], _encoding: RepresentationIdentifier) -> Result<Bytes, Infallible> {
        Ok(Bytes::copy_from_slice(bytes))
    }
}
