//! What a transport is: whole messages of several frames, to and from peers that come and go.
//!
//! A new transport is one file here, registered in [`NetworkKind`].

mod address;
mod address_group;
pub mod datagram;
mod host_checks;
mod memory;
mod ros;
mod tcp_info;
mod zmq_tcp;
mod zmq_udp;
pub mod zmtp;

pub use address::{
    Address, InvalidAddress, InvalidEventStreamAddress, NetworkMismatch, NoEventStream, UnknownAddress,
};
pub use address_group::AddressGroup;
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
use tokio::time::Instant;

use self::address::AddressForm;
use self::host_checks::HostChecks;
use crate::SessionSettings;
use crate::message::SessionHello;
use crate::statistics::{ConnectionAddresses, TransportStatistics};

/// Makes the enum of all networks of lines `Variant = "name" at "scheme" in module`. A network whose addresses have one of
/// several schemes lists them all, as in `at "ros1" | "ros2"`; its module asks the address which one it is.
macro_rules! networks {
    ($($(#[$about:meta])* $variant:ident = $name:literal at $($scheme:literal)|+ in $module:ident;)*) => {
        /// The networks a sample can travel over.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
        pub enum NetworkKind {
            $($(#[$about])* #[serde(rename = $name)] $variant,)*
        }

        impl NetworkKind {
            /// Every kind, in the order of declaration.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// The name used in configurations, in storage and on the pages.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),* }
            }

            /// How the addresses of its peers begin: `tcp` of `tcp://host:port`. Where there are several, the first is taken
            /// for an address without one.
            pub const fn schemes(self) -> &'static [&'static str] {
                match self { $(Self::$variant => &[$($scheme),+]),* }
            }

            /// How the addresses of its peers are written after the scheme.
            pub(crate) const fn address_form(self) -> AddressForm {
                match self { $(Self::$variant => $module::ADDRESS_FORM),* }
            }

            /// What this network checks on this host.
            pub(crate) const fn host_checks(self) -> HostChecks {
                match self { $(Self::$variant => $module::HOST_CHECKS),* }
            }

            /// Binds a socket at an address of this network and closes it again. Blocks.
            ///
            /// # Errors
            /// What the system says of it; a port that is in use is told as such.
            pub fn try_bind(self, address: &Address) -> io::Result<()> {
                match self { $(Self::$variant => $module::try_bind(address)),* }
            }

            pub(crate) async fn dial(
                self,
                address: &Address,
                settings: &SessionSettings,
                dialler: &Dialler<'_>,
            ) -> Result<Dialled, DialFailure> {
                match self { $(Self::$variant => $module::dial(address, settings, dialler).await),* }
            }

            pub(crate) async fn bind(
                self,
                address: &Address,
                settings: &SessionSettings,
                ports: NonZeroUsize,
                clock: &SharedClock,
            ) -> Result<Bound, BindFailure> {
                match self { $(Self::$variant => $module::bind(address, settings, ports, clock).await),* }
            }
        }
    };
}

// A new transport is registered here.
networks! {
    /// ZMTP over TCP: any ZeroMQ library can be the peer (DEALER on the edge, ROUTER on the cloud).
    #[default]
    ZmqTcp = "zmq-tcp" at "tcp" in zmq_tcp;
    /// RADIO and DISH datagrams over UDP, of which some may be lost.
    ZmqUdp = "zmq-udp" at "udp" in zmq_udp;
    /// Topics of ROS, which other programs of ROS can see.
    Ros = "ros" at "ros1" | "ros2" in ros;
}

impl NetworkKind {
    /// Whether listeners of this network are found by their names, not at a host and a port of their own.
    pub fn has_named_listeners(self) -> bool {
        matches!(self.address_form(), AddressForm::Named { .. })
    }

    /// Checks on this host the settings that only this network has.
    ///
    /// # Errors
    /// When this host cannot use one of them.
    pub fn check_settings(self, settings: &SessionSettings) -> Result<(), UnusableSetting> {
        (self.host_checks().settings)(settings).map_err(|(key, problem)| UnusableSetting { key, problem })
    }

    /// Returns the address of a listener of which only the name is known, by the environment variables of this process and
    /// the version of ROS; `None` where listeners are not found by their names.
    ///
    /// # Errors
    /// When nothing that can be used says where names are looked up.
    pub fn find_listener(
        self,
        name: &str,
        ros_version: Option<u64>,
    ) -> Option<Result<Address, UnknownAddress>> {
        let AddressForm::Named { find, .. } = self.address_form() else { return None };
        let read =
            |text: String| text.parse().map_err(|error: InvalidAddress| UnknownAddress(error.to_string()));
        Some(find(name, ros_version).and_then(read))
    }
}

impl fmt::Display for NetworkKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl From<NetworkKind> for NetworkName {
    fn from(kind: NetworkKind) -> Self {
        kind.name().parse().expect("the names of networks keep to the rules of names")
    }
}

/// The frames of one message, in order.
pub type Frames = Vec<Bytes>;

/// Why a message was not handed to the network.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SendFailure {
    /// The peer takes messages more slowly than they are made.
    #[error("the network's send queue is full")]
    Full,
    /// There is no connection any more.
    #[error("{0}")]
    Gone(String),
}

/// What a transport may know of a message to carry it well.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SendOptions {
    /// When the message is of no use any more.
    pub(crate) deadline: Option<Instant>,
    /// The sender's number for the message: a loss that is noticed later carries it. A message without a tag is sent
    /// again when it is lost.
    pub(crate) tag: Option<u64>,
}

/// A message that did not arrive as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageLoss {
    /// The sender's number for it; `None` when it gave none, or when nobody can tell.
    pub tag: Option<u64>,
    /// Fragments that arrived.
    pub received: u32,
    /// Fragments that it had; 0 when nobody can tell.
    pub total: u32,
}

impl fmt::Display for MessageLoss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.total {
            0 => f.write_str("nothing of it arrived"),
            total => write!(f, "{} of {total} fragments arrived", self.received),
        }
    }
}

/// Who opens a connection, and by which clock.
pub(crate) struct Dialler<'a> {
    pub(crate) hello: &'a SessionHello,
    pub(crate) clock: &'a SharedClock,
}

/// The edge's end of one connection. It is never re-established: a session lives and dies with it.
pub(crate) struct Dialled {
    /// Hands messages to the network, from any task or thread.
    pub(crate) sender: Box<dyn EdgeSender>,
    /// Takes messages from the network, in one task.
    pub(crate) receiver: Box<dyn EdgeReceiver>,
    /// The other end has introduced itself as a cloud: it is no other program that listens there.
    pub(crate) is_cloud: bool,
}

/// The sending half of the edge's end.
pub(crate) trait EdgeSender: Send + Sync + fmt::Debug {
    /// Hands over a whole message without waiting.
    fn send(&self, frames: Frames, options: SendOptions) -> Result<(), SendFailure>;

    /// Both ends of the connection; `None` where the transport has no such addresses.
    fn addresses(&self) -> Option<ConnectionAddresses> {
        None
    }

    /// What makes the connection worse than it could be, and what to do about it.
    fn caveat(&self) -> Option<&str> {
        None
    }

    /// What the transport knows of the connection beside whole messages. It may ask the system.
    fn statistics(&self) -> TransportStatistics {
        TransportStatistics::default()
    }
}

/// Something that the edge's end of a connection noticed.
#[derive(Debug)]
pub(crate) enum EdgeArrival {
    /// A whole message.
    Message(Frames),
    /// A message of the cloud that did not arrive as a whole.
    Incomplete(MessageLoss),
    /// A message to the cloud that did not arrive as a whole.
    Lost(MessageLoss),
    /// Something that makes no sense; dropped.
    Garbage(String),
    /// What makes the connection worse than it could be, on what object, and what to do.
    Remark(String),
}

/// A connection has ended, and why.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Disconnected(pub(crate) String);

/// The receiving half of the edge's end.
pub(crate) trait EdgeReceiver: Send + fmt::Debug {
    /// What arrives next, or why nothing more will. Dropping the future loses nothing.
    fn receive(&mut self) -> BoxFuture<'_, Result<EdgeArrival, Disconnected>>;

    /// Closes the connection, after what was sent has gone out or `linger` has passed.
    fn close(self: Box<Self>, linger: Duration) -> BoxFuture<'static, ()>;
}

/// The cloud's end: one port, many peers.
pub(crate) struct Bound {
    /// Where it really listens.
    pub(crate) address: Address,
    /// What makes all of its connections worse than they could be, and what to do about it.
    pub(crate) caveat: Option<String>,
    /// Hands messages to the network, from any task or thread.
    pub(crate) sender: Box<dyn CloudSender>,
    /// Takes messages from the network, in one task.
    pub(crate) receiver: Box<dyn CloudReceiver>,
}

/// The sending half of the cloud's end.
pub(crate) trait CloudSender: Send + Sync + fmt::Debug {
    /// Hands over a whole message without waiting.
    fn send(&self, peer: &Peer, frames: Frames, options: SendOptions) -> Result<(), SendFailure>;

    /// A connection's hello has come and is being decided on.
    fn greet(&self, connection: ConnectionId);

    /// A connection has a session: it may send requests.
    fn admit(&self, connection: ConnectionId);

    /// A connection has no session any more.
    fn demote(&self, connection: ConnectionId);

    /// What the transport knows of a connection beside whole messages. It may ask the system.
    fn statistics(&self, connection: ConnectionId) -> TransportStatistics;
}

/// The receiving half of the cloud's end.
pub(crate) trait CloudReceiver: Send + fmt::Debug {
    /// What happened next; `None` when the socket is closed. Dropping the future loses nothing.
    fn receive(&mut self) -> BoxFuture<'_, Option<Arrival>>;

    /// Closes all connections, after what was sent has gone out or `linger` has passed.
    fn close(self: Box<Self>, linger: Duration) -> BoxFuture<'static, ()>;
}

/// Something that a listening transport noticed.
#[derive(Debug)]
pub enum Arrival {
    /// A whole message.
    Message(Peer, Frames),
    /// A message of a peer that did not arrive as a whole.
    Incomplete(ConnectionId, MessageLoss),
    /// A message to a peer that did not arrive as a whole.
    Lost(ConnectionId, MessageLoss),
    /// A connection's peer has another address from now on.
    Moved(ConnectionId, SocketAddr),
    /// A connection ended.
    Gone(ConnectionId, String),
    /// Bytes that are not even of the transport's own protocol; a connection that sent them was dropped.
    Garbage(Option<SocketAddr>, String),
    /// What makes a connection worse than it could be, on what object, and what to do.
    Remark(ConnectionId, String),
    /// An edge gets no connection: which host it says it is, and why.
    Refused(Option<HostId>, String),
}

/// One connection of a listener, never used again after it ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ConnectionId(pub(crate) u64);

/// Who sent a message and how to answer.
#[derive(Clone, Debug)]
pub struct Peer {
    /// The connection it came on.
    pub connection: ConnectionId,
    /// Where the peer is.
    pub address: Option<SocketAddr>,
}

/// Why there is no connection.
#[derive(Debug)]
pub(crate) enum DialFailure {
    /// Nobody answers there, or not in this protocol.
    Unreachable(String),
    /// The cloud is there, and gives no connection.
    Refused(String),
    /// The time for it is over.
    TimedOut,
}

/// Why a listener could not be bound.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BindFailure {
    /// Another socket has the port.
    #[error("another program uses the port")]
    InUse,
    /// The port needs a privilege.
    #[error("permission denied")]
    Denied,
    /// The address is not one of this machine.
    #[error("this machine has no such address")]
    NotLocal,
    /// Anything else.
    #[error("{0}")]
    Other(String),
}

#[cfg(test)]
mod tests {
    /// A module as a transport's is, which only has to compile.
    mod nowhere {
        use std::io;
        use std::num::NonZeroUsize;

        use peernet_clock::SharedClock;

        use super::super::{
            Address, AddressForm, BindFailure, Bound, DialFailure, Dialled, Dialler, HostChecks,
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
            _: &Dialler<'_>,
        ) -> Result<Dialled, DialFailure> {
            Err(DialFailure::Unreachable(address.to_string()))
        }

        pub(super) async fn bind(
            _: &Address,
            _: &SessionSettings,
            _: NonZeroUsize,
            _: &SharedClock,
        ) -> Result<Bound, BindFailure> {
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
            Address, AddressForm, BindFailure, Bound, DialFailure, Dialled, Dialler, HostChecks,
        };
        use super::nowhere;
        use crate::SessionSettings;

        networks! {
            /// Has one scheme.
            #[default]
            Wire = "wire" at "wire" in nowhere;
            /// Has two.
            Robot = "robot" at "robot1" | "robot2" in nowhere;
        }
    }

    use std::num::NonZeroUsize;
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, SharedClock, SystemClock};
    use peernet_logger::HostId;
    use registered::NetworkKind;

    use super::{Address, AddressForm, BindFailure, DialFailure, Dialler};
    use crate::message::SessionHello;
    use crate::{SESSION_VERSIONS, SessionSettings};

    #[tokio::test]
    async fn one_name_may_stand_for_several_schemes() {
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
        let dialler = Dialler { hello: &hello, clock: &clock };
        let dialled = NetworkKind::Robot.dial(&address, &settings, &dialler).await;
        assert!(matches!(dialled, Err(DialFailure::Unreachable(where_to)) if where_to == "tcp://a:1"));
        let bound = NetworkKind::Robot.bind(&address, &settings, NonZeroUsize::MIN, &clock).await;
        assert!(matches!(bound, Err(BindFailure::NotLocal)));
        assert!(NetworkKind::Robot.try_bind(&address).is_ok());
        assert!((NetworkKind::Robot.host_checks().settings)(&settings).is_ok());
        assert!(matches!(NetworkKind::Robot.address_form(), AddressForm::HostPort));
    }
}
