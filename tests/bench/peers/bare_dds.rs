//! Lower bound of sessions over ROS 2: a ping-pong between two participants of `rustdds`, reliable, with messages of
//! bytes that are not serialized. A message that is not answered in time is given up.
//!
//! `bare-dds serve`, and at the same time `bare-dds drive BYTES SECONDS`, which prints one JSON object. They discover
//! each other in domain 77.

mod round_trips;

use std::convert::Infallible;
use std::pin::pin;
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use bytes::Bytes;
use futures::StreamExt;
use rustdds::no_key::{Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter};
use rustdds::policy::{History, Reliability};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, QosPolicyBuilder, RepresentationIdentifier, TopicKind,
    no_key,
};
use serde_json::Value;
use tokio::time::{sleep, timeout};

use self::round_trips::RoundTrips;

const DOMAIN: u16 = 77;

/// Socket buffers, bytes, as large as those that an agent requests.
const SOCKET_BUFFER_BYTES: usize = 4 << 20;

/// Longest wait for an answer, which includes retransmissions.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(2);

/// Longest wait for the other end.
const DISCOVERY_TIMEOUT: Duration = Duration::from_secs(30);

/// Longest wait for the answer to one message during discovery, and the pause after an error.
const DISCOVERY_INTERVAL: Duration = Duration::from_millis(300);

/// Number of messages that each end keeps.
const DEPTH: i32 = 16;

#[tokio::main(flavor = "current_thread")]
async fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["serve"] => serve().await,
        ["drive", bytes, seconds] => {
            let figures = drive(bytes.parse()?, seconds.parse()?).await?;
            #[expect(clippy::print_stdout, reason = "the result that was asked for")]
            {
                println!("{figures}");
            }
            Ok(())
        }
        _ => bail!("usage: bare-dds serve | bare-dds drive BYTES SECONDS"),
    }
}

/// Bytes that are serialized already.
struct Message(Bytes);

struct RawAdapter;

#[derive(Clone)]
struct RawDecoder;

impl SerializerAdapter<Message> for RawAdapter {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(message: &Message) -> Result<Bytes, Infallible> {
        Ok(message.0.clone())
    }
}

impl DeserializerAdapter<Message> for RawAdapter {
    type Error = Infallible;
    type Decoded = Message;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE]
    }

    fn transform_decoded(decoded: Message) -> Message {
        decoded
    }
}

impl DefaultDecoder<Message> for RawAdapter {
    type Decoder = RawDecoder;
    const DECODER: RawDecoder = RawDecoder;
}

impl Decode<'_, Message> for RawDecoder {
    type Error = Infallible;

    fn decode_bytes(self, bytes: &[u8], _: RepresentationIdentifier) -> Result<Message, Infallible> {
        Ok(Message(Bytes::copy_from_slice(bytes)))
    }
}

/// Both directions of one end.
struct Endpoint {
    writer: no_key::DataWriter<Message, RawAdapter>,
    reader: no_key::SimpleDataReader<Message, RawAdapter>,
    /// Participant, whose threads end with it.
    _participant: DomainParticipant,
}

impl Endpoint {
    fn open(outgoing: &str, incoming: &str) -> anyhow::Result<Self> {
        let participant = DomainParticipantBuilder::new(DOMAIN)
            .same_host_loopback(true)
            .socket_receive_buffer_size(SOCKET_BUFFER_BYTES)
            .socket_send_buffer_size(SOCKET_BUFFER_BYTES)
            .build()
            .context("cannot join the domain")?;
        let qos = QosPolicyBuilder::new()
            .reliability(Reliability::Reliable { max_blocking_time: rustdds::Duration::from_secs(1) })
            .history(History::KeepLast { depth: DEPTH })
            .build();
        let topic = |name: &str| {
            participant.create_topic(name.to_owned(), "Bytes".to_owned(), &qos, TopicKind::NoKey)
        };
        let (publisher, subscriber) =
            (participant.create_publisher(&qos)?, participant.create_subscriber(&qos)?);
        Ok(Self {
            writer: publisher.create_datawriter_no_key(&topic(outgoing)?, None)?,
            reader: subscriber.create_simple_datareader_no_key(&topic(incoming)?, None)?,
            _participant: participant,
        })
    }

    async fn send(&self, bytes: Bytes) -> anyhow::Result<()> {
        let result = self.writer.async_write(Message(bytes), None).await;
        result.map_err(|error| anyhow!("cannot send: {}", error.forget_data()))
    }

    async fn receive(&self) -> anyhow::Result<Bytes> {
        let sample = pin!(self.reader.as_async_stream()).next().await;
        Ok(sample.context("the participant has ended")??.into_value().0)
    }
}

async fn serve() -> anyhow::Result<()> {
    let endpoint = Endpoint::open("down", "up")?;
    loop {
        let message = endpoint.receive().await?;
        // A message that the writer cannot accept in time is lost; the other end counts it.
        let _lost = endpoint.send(message).await;
    }
}

async fn drive(length: usize, seconds: u64) -> anyhow::Result<Value> {
    let endpoint = Endpoint::open("up", "down")?;
    // The message begins with its number.
    let mut message = vec![0x5a; length.max(size_of::<u64>())];
    let mut number = 0_u64;
    let mut next_message = || {
        number += 1;
        message[..size_of::<u64>()].copy_from_slice(&number.to_le_bytes());
        Bytes::copy_from_slice(&message)
    };
    timeout(DISCOVERY_TIMEOUT, async {
        // A message that is sent before the other end is discovered does not arrive.
        loop {
            match timeout(DISCOVERY_INTERVAL, exchange(&endpoint, next_message())).await {
                Ok(Ok(())) => break,
                // An error is no answer. The pause lets the time limit end a series of errors that occur at once.
                Ok(Err(_)) => sleep(DISCOVERY_INTERVAL).await,
                Err(_) => {}
            }
        }
    })
    .await
    .map_err(|_| {
        anyhow!("nobody answered within {} s; is `bare-dds serve` running?", DISCOVERY_TIMEOUT.as_secs())
    })?;
    let mut round_trips = RoundTrips::new(seconds)?;
    while let Some(begin) = round_trips.next() {
        match timeout(ANSWER_TIMEOUT, exchange(&endpoint, next_message())).await {
            Ok(Ok(())) => round_trips.record(begin, Some(&[])),
            // The writer is full, or there is no answer.
            Ok(Err(_)) | Err(_) => round_trips.record(begin, None),
        }
    }
    round_trips.figures()
}

/// Sends a message and waits for its answer; answers to earlier messages are skipped.
async fn exchange(endpoint: &Endpoint, message: Bytes) -> anyhow::Result<()> {
    endpoint.send(message.clone()).await?;
    while endpoint.receive().await?[..size_of::<u64>()] != message[..size_of::<u64>()] {}
    Ok(())
}
