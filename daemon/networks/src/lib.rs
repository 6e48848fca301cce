//! Networks: messages, sessions, and one module for each transport.
//!
//! An edge [opens](Session::open) a session with a cloud's [`Listener`] and then sends samples with the logger tree of
//! their iteration. The cloud answers with a sample and with the nodes that the cloud added to the tree. All
//! transports ([`NetworkKind`] lists them) carry the same frames, and one session logic serves all transports. The
//! session's state machines in `session/{client,server}.rs` do no I/O; `session/{edge,cloud}.rs` drive them.

pub mod descriptors;
mod interface;
mod message;
mod session;
mod settings;
mod statistics;
mod transport;

pub use interface::{is_wireless, outgoing_interface};
pub use message::{
    ClockSocketName, InvalidClockSocketName, MAX_CONDITIONS, PeerClock, ProbeKey, RAW_STAMPS_SINCE, RawClock,
    SESSION_VERSIONS, SessionAccepted, SessionHello, SessionId,
};
pub use session::{
    Announcer, AwaitedEvent, BindError, CloseReason, CompletedRequest, FIRST_PART, FIRST_PART_DOWNLOAD,
    Failure, Incoming, IncomingRequest, Listener, OpenError, OpenRequest, PARTS, PARTS_SENT,
    PartialAnswerError, PartialAnswerHandler, PartialAnswerSender, RequestCancelled, RequestError, Responder,
    Session, StatisticsReader,
};
pub use settings::{InvalidSettings, MAX_IN_FLIGHT, Ros2SessionSettings, SessionSettings};
pub use statistics::{ConnectionAddresses, ConnectionStatistics, DirectionStatistics, TransportRoundTrip};
pub use transport::{
    Address, AddressGroup, BindFailure, ConnectionId, Frames, InvalidAddress, InvalidEventStreamAddress,
    ListenerEvent, ListenerLookupError, MessageLoss, NetworkKind, NetworkMismatch, Peer, SendFailure,
    UnsupportedEventStreamNetwork, UnusableAddress, UnusableSetting, datagram, zmtp,
};
