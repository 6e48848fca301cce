//! Independent description of the wire form: the messages that any ZeroMQ program has to send.

use bytes::Bytes;
use serde::{Deserialize, Serialize};
use zeromq::{Message, Options, Socket, SocketType};

use crate::support::within;

/// Version of the protocol in these messages, unless a test states another version.
pub(crate) const PROTOCOL: u16 = 4;

#[derive(Serialize, Deserialize, Debug)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Header {
    Open {
        hello: Hello,
        max_message_bytes: u64,
    },
    Accepted {
        protocol: u16,
        session: Id,
        accepted: Accepted,
        max_message_bytes: u64,
        max_in_flight: u32,
    },
    Refused {
        protocol: u16,
        #[serde(default)]
        newest: Option<u16>,
        /// First release that speaks the version `protocol`.
        #[serde(default)]
        since: Option<Release>,
        kind: String,
        reason: String,
    },
    /// Session, number of the request, departure, and the sample: descriptions of the parts, source and label.
    Request(Id, u64, Departure, (Vec<Description>, String, Option<String>)),
    /// Session, number of the request, departure of the reply, epoch at the arrival of the request, and outcome.
    Reply(Id, u64, Option<Departure>, u32, Outcome),
    Clock {
        session: Id,
        clock: HostClock,
    },
    UnknownSession {
        session: Id,
        request: u64,
    },
    Goodbye {
        session: Id,
        reason: String,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        ordered: Option<u64>,
    },
}

/// Major, minor and patch version.
pub(crate) type Release = (u16, u16, u16);

/// Wall clock, offset on the monotonic clock, and epoch. Since version 5 also the free-running clock.
#[derive(Serialize, Deserialize, Debug)]
pub(crate) struct Departure(
    pub(crate) i64,
    pub(crate) i64,
    pub(crate) u32,
    #[serde(default, skip_serializing_if = "Option::is_none")] pub(crate) Option<i64>,
);

/// Sixteen random bytes.
pub(crate) type Id = serde_bytes::ByteBuf;

/// Media type, shape, element type.
pub(crate) type Description = (String, Vec<u32>, Option<String>);

#[derive(Serialize, Deserialize, Debug)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Outcome {
    Answer((Vec<Description>, String, Option<String>)),
    Failed(String),
    Overloaded(String),
}

#[derive(Serialize, Deserialize, Debug)]
pub(crate) struct Hello {
    /// Oldest version that the edge speaks.
    pub(crate) protocol: u16,
    #[serde(default)]
    pub(crate) newest: Option<u16>,
    /// First release that speaks the version `protocol`.
    #[serde(default)]
    pub(crate) since: Option<Release>,
    pub(crate) host: Id,
    pub(crate) name: String,
    pub(crate) clock: Clock,
    pub(crate) pipeline: String,
    pub(crate) model: Option<String>,
    pub(crate) device: Option<String>,
    /// Exists since release 0.3.0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) clock_socket: Option<String>,
    /// A field that a later version may add.
    #[serde(default)]
    pub(crate) colour: Option<String>,
}

#[derive(Serialize, Deserialize, Debug)]
pub(crate) struct Clock {
    pub(crate) boot: String,
    pub(crate) clock: String,
}

#[derive(Serialize, Deserialize, Debug)]
pub(crate) struct Accepted {
    pub(crate) host: Id,
    pub(crate) name: String,
    pub(crate) clock: Clock,
    pub(crate) version: String,
    pub(crate) model: String,
    pub(crate) device: String,
    pub(crate) facts: Vec<(String, String)>,
    pub(crate) host_clock: HostClock,
    pub(crate) probes: Option<u16>,
    pub(crate) instance: u64,
    pub(crate) conditions: Vec<Condition>,
    pub(crate) hardware: Box<Hardware>,
}

#[derive(Clone, Default, Serialize, Deserialize, Debug)]
pub(crate) struct Hardware {
    pub(crate) cpu: String,
    pub(crate) cores: u32,
    pub(crate) memory_bytes: u64,
    pub(crate) gpus: Vec<String>,
    pub(crate) system: String,
    pub(crate) architecture: String,
}

#[derive(Clone, Serialize, Deserialize, Debug)]
pub(crate) struct Condition {
    pub(crate) host: String,
    pub(crate) about: String,
    pub(crate) found: String,
    pub(crate) grade: String,
    pub(crate) advice: String,
}

#[derive(Serialize, Deserialize, Debug)]
pub(crate) struct HostClock {
    pub(crate) epoch: u32,
    #[serde(rename = "discipline")]
    pub(crate) claim: Option<ClockClaim>,
    pub(crate) text: String,
    #[serde(rename = "rehearsal")]
    pub(crate) faults: Option<ClockFault>,
}

#[derive(Serialize, Deserialize, Debug)]
pub(crate) struct ClockClaim {
    pub(crate) source: String,
    pub(crate) error: Interval,
}

#[derive(Serialize, Deserialize, Debug)]
pub(crate) struct Interval {
    pub(crate) lo: i64,
    pub(crate) hi: i64,
}

#[derive(Serialize, Deserialize, Debug)]
pub(crate) struct ClockFault {
    pub(crate) offset: i64,
    pub(crate) drift_ppm: f64,
    pub(crate) steps: Vec<Step>,
    pub(crate) since: i64,
}

#[derive(Serialize, Deserialize, Debug)]
pub(crate) struct Step {
    pub(crate) at: i64,
    pub(crate) by: i64,
}

/// Returns the state of a clock without claim, text and faults.
pub(crate) fn host_clock(epoch: u32) -> HostClock {
    HostClock { epoch, claim: None, text: String::new(), faults: None }
}

pub(crate) fn hello(protocol: u16) -> Hello {
    Hello {
        protocol,
        newest: None,
        since: None,
        host: Id::from([1; 16]),
        name: "plain".into(),
        clock: Clock { boot: "b".into(), clock: "c".into() },
        pipeline: "p".into(),
        model: Some("echo".into()),
        device: None,
        clock_socket: None,
        colour: None,
    }
}

pub(crate) fn open(protocol: u16) -> Header {
    Header::Open { hello: hello(protocol), max_message_bytes: 1_000_000 }
}

/// A socket of the ZeroMQ library, without the session logic.
pub(crate) struct PlainSocket(pub(crate) Socket);

impl PlainSocket {
    pub(crate) async fn dealer(address: &peernet_networks::Address, options: Options) -> Self {
        let socket = Socket::new(SocketType::Dealer, options);
        within(socket.connect(address.to_string())).await.expect("a socket");
        Self(socket)
    }

    pub(crate) async fn send_frames(&self, frames: Vec<Bytes>) {
        within(self.0.send(Message::multipart(frames))).await.expect("sent");
    }

    pub(crate) async fn send_message(&self, header: &Header, frames: Vec<Bytes>) {
        let header = rmp_serde::to_vec_named(header).expect("serialises");
        self.send_frames([vec![header.into()], frames].concat()).await;
    }

    pub(crate) async fn receive_message(&self) -> (Header, Vec<Bytes>) {
        let message = within(self.0.recv()).await.expect("an answer");
        let frames: Vec<Bytes> = message.iter().collect();
        (rmp_serde::from_slice(&frames[0]).expect("a header"), frames[1..].to_vec())
    }
}
