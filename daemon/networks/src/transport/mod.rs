//! Transports: they carry whole messages of several frames to and from peers that come and go.
//!
//! A new transport is one file here, registered in [`NetworkKind`]. The scheme of an address selects the network.
//!
//! A transport delivers whole messages. It also reports messages that are incomplete or lost and bytes that are invalid
//! ([`EdgeEvent`], [`ListenerEvent`]). The tag of a message is the number of its request, so that a loss ends that
//! request alone.

mod address;
mod address_group;
mod bind_failure;
pub mod datagram;
mod host_checks;
mod memory;
mod ros;
mod tcp_info;
mod zmq_tcp;
mod zmq_udp;
pub mod zmtp;

pub use address::{
    Address, InvalidAddress, InvalidEventStreamAddress, ListenerLookupError, NetworkMismatch,
    UnsupportedEventStreamNetwork,
};
pub use address_group::AddressGroup;
pub use bind_failure::BindFailure;
pub use host_checks::{UnusableAddress, UnusableSetting};

use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::num::NonZeroUsize;
use std::time::Duration;

use bytes::Bytes;
use futures::future::BoxFuture;
use peernet_clock::SharedClock;
use peernet_logger::HostId;
use peernet_stream::NetworkName;
use serde::{Deserialize, Serialize};
use tokio::sync::mpsc;
use tokio::time::Instant;

use self::address::AddressForm;
use self::host_checks::HostChecks;
use crate::SessionSettings;
use crate::message::SessionHello;
use crate::statistics::{ConnectionAddresses, TransportStatistics};

/// Defines the enum of all networks from lines `Variant = "name" at "scheme" in module`. A network with several schemes
/// lists them all, as in `at "ros1" | "ros2"`; its module reads the scheme from the address.
// This is a macro and not a trait object: the kind is a plain value that is stored, compared and serialised.
macro_rules! networks {
    ($($(#[$about:meta])* $variant:ident = $name:literal at $($scheme:literal)|+ in $module:ident;)*) => {
        /// The networks over which samples can be sent.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
        pub enum NetworkKind {
            $($(#[$about])* #[serde(rename = $name)] $variant,)*
        }

        impl NetworkKind {
            /// Every kind, in the order of declaration.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// Returns the name that configurations, storage and pages use.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),* }
            }

            /// Returns the schemes of the network's addresses, such as `tcp` of `tcp://host:port`. The first scheme is
            /// used for an address that is made without a scheme.
            pub const fn schemes(self) -> &'static [&'static str] {
                match self { $(Self::$variant => &[$($scheme),+]),* }
            }

            /// Returns the form of the network's addresses after the scheme.
            pub(crate) const fn address_form(self) -> AddressForm {
                match self { $(Self::$variant => $module::ADDRESS_FORM),* }
            }

            /// Returns the checks of this network that depend on the build and on this host.
            pub(crate) const fn host_checks(self) -> HostChecks {
                match self { $(Self::$variant => $module::HOST_CHECKS),* }
            }

            /// Binds a socket to an address of this network and closes the socket again. Blocks.
            ///
            /// # Errors
            /// The error of the system. Its kind is `AddrInUse` if the port is in use.
            pub fn try_bind(self, address: &Address) -> io::Result<()> {
                match self { $(Self::$variant => $module::try_bind(address)),* }
            }

            /// Connects to the listener at an address of this network.
            pub(crate) async fn dial(
                self,
                address: &Address,
                settings: &SessionSettings,
                context: &DialContext<'_>,
            ) -> Result<EdgeConnection, DialFailure> {
                match self { $(Self::$variant => $module::dial(address, settings, context).await),* }
            }

            /// Listens on an address of this network. `ports` is the number of data ports of this process. The data
            /// ports share the file descriptors for connections.
            pub(crate) async fn bind(
                self,
                address: &Address,
                settings: &SessionSettings,
                ports: NonZeroUsize,
                clock: &SharedClock,
            ) -> Result<BoundPort, BindFailure> {
                match self { $(Self::$variant => $module::bind(address, settings, ports, clock).await),* }
            }
        }
    };
}

// A new transport is registered here.
networks! {
    /// ZMTP over TCP. The peer can be any ZeroMQ library (DEALER on the edge, ROUTER on the cloud).
    #[default]
    ZmqTcp = "zmq-tcp" at "tcp" in zmq_tcp;
    /// RADIO and DISH datagrams over UDP. Messages may be lost.
    ZmqUdp = "zmq-udp" at "udp" in zmq_udp;
    /// Topics of ROS, which other ROS programs can see.
    Ros = "ros" at "ros1" | "ros2" in ros;
}

impl NetworkKind {
    /// Returns whether listeners of this network are found by name and not by host and port.
    pub fn has_named_listeners(self) -> bool {
        matches!(self.address_form(), AddressForm::Named { .. })
    }

    /// Checks that this host supports the settings that only this network has.
    ///
    /// # Errors
    /// If this host cannot use one of the settings.
    pub fn check_settings(self, settings: &SessionSettings) -> Result<(), UnusableSetting> {
        (self.host_checks().check_settings)(settings)
            .map_err(|(key, problem)| UnusableSetting { key, problem })
    }

    /// Returns the address of the listener with this name. Uses the environment variables of this process and the
    /// version of ROS. `None` if the network does not find listeners by name.
    ///
    /// # Errors
    /// If the environment does not state where names are looked up.
    pub fn find_listener(
        self,
        name: &str,
        ros_version: Option<u64>,
    ) -> Option<Result<Address, ListenerLookupError>> {
        let AddressForm::Named { find, .. } = self.address_form() else { return None };
        let parse_address = |text: String| {
            text.parse().map_err(|error: InvalidAddress| ListenerLookupError(error.to_string()))
        };
        Some(find(name, ros_version).and_then(parse_address))
    }
}

impl fmt::Display for NetworkKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl From<NetworkKind> for NetworkName {
    fn from(kind: NetworkKind) -> Self {
        kind.name().parse().expect("every network name is a valid name")
    }
}

/// Frames of one message, in order.
pub type Frames = Vec<Bytes>;

/// Reason why a message was not handed to the network.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SendFailure {
    /// The send queue is full, because the peer receives messages more slowly than they are sent.
    #[error("the network's send queue is full")]
    Full,
    /// The message can never be sent: for example, the connection is gone, or the message is too long. The text states
    /// the reason.
    #[error("{0}")]
    Gone(String),
}

/// Properties of a message that a transport may use.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SendOptions {
    /// Time after which the message is of no use; `None` if it stays useful.
    pub(crate) deadline: Option<Instant>,
    /// Number that the sender gives the message. If the message is lost, [`MessageLoss::tag`] repeats it. A datagram
    /// transport retransmits a lost message only if the message has no tag.
    pub(crate) tag: Option<u64>,
}

/// A message that did not arrive as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageLoss {
    /// Sender's number for the message; `None` if the message has no number or the number is unknown.
    pub tag: Option<u64>,
    /// Number of fragments that arrived.
    pub received: u32,
    /// Number of fragments of the message; 0 if unknown.
    pub total: u32,
}

impl fmt::Display for MessageLoss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.total {
            0 => f.write_str("no part of the message arrived"),
            // A fragment counts as received even if the receiver had no memory for it.
            total if self.received == total => write!(
                f,
                "all of its {total} fragments arrived, but they were damaged (wrong checksum), or the receiver had no memory for them"
            ),
            total => write!(f, "{} of {total} fragments arrived", self.received),
        }
    }
}

/// Properties of the edge that opens a connection, for the transport.
pub(crate) struct DialContext<'a> {
    pub(crate) hello: &'a SessionHello,
    pub(crate) clock: &'a SharedClock,
}

/// The edge's end of one connection. A transport never re-establishes a connection, because a session exists exactly as
/// long as its connection.
pub(crate) struct EdgeConnection {
    /// Sends messages, from any task or thread.
    pub(crate) sender: Box<dyn EdgeSender>,
    /// Receives messages, in one task.
    pub(crate) receiver: Box<dyn EdgeReceiver>,
    /// `true` if the other end has identified itself as a cloud. If `false`, the other end may be another program.
    pub(crate) peer_is_cloud: bool,
}

/// The sending half of the edge's end.
pub(crate) trait EdgeSender: Send + Sync + fmt::Debug {
    /// Hands over a whole message. Never waits.
    fn send(&self, frames: Frames, options: SendOptions) -> Result<(), SendFailure>;

    /// Returns the addresses of both ends; `None` if the transport has none.
    fn addresses(&self) -> Option<ConnectionAddresses> {
        None
    }

    /// Returns a warning about a limit of the system that slows the connection down, and what to do about it.
    fn caveat(&self) -> Option<&str> {
        None
    }

    /// Returns the transport's statistics of the connection. May query the system.
    fn statistics(&self) -> TransportStatistics {
        TransportStatistics::default()
    }
}

/// Event at the edge's end of a connection.
#[derive(Debug)]
pub(crate) enum EdgeEvent {
    /// A whole message arrived.
    Message(Frames),
    /// A message from the cloud did not arrive as a whole.
    IncomingLost(MessageLoss),
    /// A message to the cloud did not arrive as a whole.
    OutgoingLost(MessageLoss),
    /// Invalid data arrived and was dropped. The text says what is invalid.
    InvalidData(String),
    /// The connection works, but worse than it could. The text says why, and what to do about it.
    Remark(String),
}

/// The connection has ended, for this reason.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Disconnection(pub(crate) String);

/// Reason for the end of a connection that this program closed.
pub(crate) const CLOSED_HERE: &str = "the connection was closed here";

/// Closes a connection's or port's queue of deliveries and discards the deliveries in it. They are of no use any more,
/// and the task that delivers must not wait until they are received.
pub(crate) fn discard_deliveries<T>(deliveries: &mut mpsc::Receiver<T>) {
    deliveries.close();
    while deliveries.try_recv().is_ok() {}
}

/// The receiving half of the edge's end.
pub(crate) trait EdgeReceiver: Send + fmt::Debug {
    /// Waits for the next event. An error means that the connection has ended. Cancel safe: dropping the future loses
    /// nothing.
    fn receive(&mut self) -> BoxFuture<'_, Result<EdgeEvent, Disconnection>>;

    /// Closes the connection after all messages have been sent, or after `linger`.
    fn close(self: Box<Self>, linger: Duration) -> BoxFuture<'static, ()>;
}

/// The cloud's end: one port with many peers.
pub(crate) struct BoundPort {
    /// Actual address of the port.
    pub(crate) address: Address,
    /// Warning about a limit of the system that slows all connections of the port down, and what to do about it.
    pub(crate) caveat: Option<String>,
    /// Sends messages, from any task or thread.
    pub(crate) sender: Box<dyn CloudSender>,
    /// Receives messages, in one task.
    pub(crate) receiver: Box<dyn CloudReceiver>,
}

/// The sending half of the cloud's end.
pub(crate) trait CloudSender: Send + Sync + fmt::Debug {
    /// Hands over a whole message. Never waits.
    fn send(&self, peer: &Peer, frames: Frames, options: SendOptions) -> Result<(), SendFailure>;

    /// Notes that a connection has asked for a session and waits for the decision.
    fn note_hello(&self, connection: ConnectionId);

    /// Notes that a connection has a session and may send requests.
    fn admit(&self, connection: ConnectionId);

    /// Notes that a connection has no session any more.
    fn demote(&self, connection: ConnectionId);

    /// Returns the transport's statistics of a connection. May query the system.
    fn statistics(&self, connection: ConnectionId) -> TransportStatistics;
}

/// The receiving half of the cloud's end.
pub(crate) trait CloudReceiver: Send + fmt::Debug {
    /// Waits for the next event. `None` means that the socket is closed. Cancel safe: dropping the future loses
    /// nothing.
    fn receive(&mut self) -> BoxFuture<'_, Option<ListenerEvent>>;

    /// Closes all connections after all messages have been sent, or after `linger`.
    fn close(self: Box<Self>, linger: Duration) -> BoxFuture<'static, ()>;
}

/// Event at a listening transport.
#[derive(Debug)]
pub enum ListenerEvent {
    /// A whole message arrived.
    Message(Peer, Frames),
    /// A message from a peer did not arrive as a whole.
    IncomingLost(ConnectionId, MessageLoss),
    /// A message to a peer did not arrive as a whole.
    OutgoingLost(ConnectionId, MessageLoss),
    /// The address of a connection's peer has changed.
    Moved(ConnectionId, SocketAddr),
    /// A connection ended, for this reason.
    Gone(ConnectionId, String),
    /// Bytes that violate the transport's protocol arrived from this address. The text says what is invalid. `zmq-tcp`
    /// has closed the connection that sent the bytes.
    InvalidData(Option<SocketAddr>, String),
    /// A connection works, but worse than it could. The text says why, and what to do about it.
    Remark(ConnectionId, String),
    /// An edge was refused: the id of the host that the edge claims to be, and the reason.
    Refused(Option<HostId>, String),
}

/// Number of a connection of a listener. Numbers are not reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ConnectionId(pub(crate) u64);

/// Sender of a message, and destination of the answer.
#[derive(Clone, Debug)]
pub struct Peer {
    /// Connection of the message.
    pub connection: ConnectionId,
    /// Address of the peer.
    pub address: Option<SocketAddr>,
}

/// Reason why a connection could not be opened.
#[derive(Debug)]
pub(crate) enum DialFailure {
    /// Nothing answers at the address, or the answer is not of this protocol.
    Unreachable(String),
    /// The cloud answers and refuses the connection.
    Refused(String),
    /// The time limit has passed.
    TimedOut,
}

#[cfg(test)]
mod tests {
    /// A module with the items of a transport, which only has to compile.
    mod stub_transport {
        use std::io;
        use std::num::NonZeroUsize;

        use peernet_clock::SharedClock;

        use super::super::{
            Address, AddressForm, BindFailure, BoundPort, DialContext, DialFailure, EdgeConnection,
            HostChecks,
        };
        use crate::SessionSettings;

        pub(super) const ADDRESS_FORM: AddressForm = AddressForm::HostPort;

        pub(super) const HOST_CHECKS: HostChecks = HostChecks::NONE;

        pub(super) fn try_bind(_: &Address) -> io::Result<()> {
            Ok(())
        }

        pub(super) async fn dial(
            address: &Address,
            _: &SessionSettings,
            _: &DialContext<'_>,
        ) -> Result<EdgeConnection, DialFailure> {
            Err(DialFailure::Unreachable(address.to_string()))
        }

        pub(super) async fn bind(
            _: &Address,
            _: &SessionSettings,
            _: NonZeroUsize,
            _: &SharedClock,
        ) -> Result<BoundPort, BindFailure> {
            Err(BindFailure::NotLocal)
        }
    }

    /// Networks that are registered like the real ones.
    #[expect(unreachable_pub, reason = "the macro makes a public enum")]
    mod registered {
        use std::io;
        use std::num::NonZeroUsize;

        use serde::{Deserialize, Serialize};

        use peernet_clock::SharedClock;

        use super::super::{
            Address, AddressForm, BindFailure, BoundPort, DialContext, DialFailure, EdgeConnection,
            HostChecks,
        };
        use super::stub_transport;
        use crate::SessionSettings;

        networks! {
            /// A network with one scheme.
            #[default]
            Wire = "wire" at "wire" in stub_transport;
            /// A network with two schemes.
            Robot = "robot" at "robot1" | "robot2" in stub_transport;
        }
    }

    use std::num::NonZeroUsize;
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
    use peernet_logger::HostId;
    use registered::NetworkKind;

    use super::{Address, AddressForm, BindFailure, DialContext, DialFailure};
    use crate::message::SessionHello;
    use crate::{SESSION_VERSIONS, SessionSettings};

    #[tokio::test]
    async fn network_may_have_several_schemes() {
        let schemes = NetworkKind::ALL.iter().map(|kind| (kind.name(), kind.schemes()));
        let expected: [(&str, &[&str]); 2] = [("wire", &["wire"]), ("robot", &["robot1", "robot2"])];
        assert_eq!(schemes.collect::<Vec<_>>(), expected);
        let (address, settings): (Address, _) =
            ("tcp://a:1".parse().expect("an address"), SessionSettings::default());
        let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "clock")));
        let hello = SessionHello {
            versions: SESSION_VERSIONS,
            host: HostId::random(),
            name: "robot".parse().expect("a name"),
            clock: clock.identity().clone(),
            pipeline: "line".parse().expect("a name"),
            model: None,
            device: None,
            clock_socket: None,
        };
        let context = DialContext { hello: &hello, clock: &clock };
        let dialled = NetworkKind::Robot.dial(&address, &settings, &context).await;
        assert!(matches!(dialled, Err(DialFailure::Unreachable(reason)) if reason == "tcp://a:1"));
        let bound = NetworkKind::Robot.bind(&address, &settings, NonZeroUsize::MIN, &clock).await;
        assert!(matches!(bound, Err(BindFailure::NotLocal)));
        assert!(NetworkKind::Robot.try_bind(&address).is_ok());
        assert!((NetworkKind::Robot.host_checks().check_settings)(&settings).is_ok());
        assert!(matches!(NetworkKind::Robot.address_form(), AddressForm::HostPort));
    }
}
