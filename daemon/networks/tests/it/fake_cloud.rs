//! A cloud made of a plain ZeroMQ socket.

use bytes::Bytes;
use peernet_networks::Address;
use serde::Serialize;
use zeromq::{Message, Options, Socket, SocketType};

use crate::support::{hello, open, settings, within};
use crate::wire::{self, Header, Id, PROTOCOL};

/// A cloud that sends arbitrary messages.
pub(crate) struct FakeCloud {
    socket: zeromq::IdentitySocket,
    pub(crate) address: Address,
}

impl FakeCloud {
    pub(crate) async fn start() -> Self {
        Self::start_with_identity("").await
    }

    /// Starts a cloud that sends an identity in the ZMTP handshake.
    pub(crate) async fn start_with_identity(identity: &'static str) -> Self {
        let options = Options::default().identity(Bytes::from_static(identity.as_bytes()));
        let socket = Socket::new(SocketType::Router, options);
        let endpoint = socket.bind("tcp://127.0.0.1:0").await.expect("a free port");
        let socket = socket.identity_routing().expect("a router");
        Self { socket, address: endpoint.to_string().parse().expect("an address") }
    }

    pub(crate) async fn receive_message(&self) -> (zeromq::Identity, Header) {
        let (identity, message) = within(self.socket.recv_from()).await.expect("a message");
        (identity, rmp_serde::from_slice(&message[0]).expect("a header"))
    }

    pub(crate) async fn send_message(
        &self,
        edge_identity: &zeromq::Identity,
        header: &impl Serialize,
        frames: Vec<Bytes>,
    ) {
        let header = rmp_serde::to_vec_named(header).expect("serialises");
        let message = Message::multipart([vec![header.into()], frames].concat());
        within(self.socket.send_to(edge_identity, message)).await.expect("sent");
    }

    pub(crate) fn accepted(session: Id, protocol: u16) -> Header {
        let accepted = wire::Accepted {
            host: Id::from([2; 16]),
            name: "fake".into(),
            clock: wire::Clock { boot: "b".into(), clock: "c".into() },
            version: "9".into(),
            model: "echo".into(),
            device: "cpu".into(),
            facts: Vec::new(),
            host_clock: wire::host_clock(0),
            probes: None,
            instance: 1,
            conditions: Vec::new(),
            hardware: Box::default(),
        };
        Header::Accepted { protocol, session, accepted, max_message_bytes: 1_000_000, max_in_flight: 8 }
    }

    /// Opens a session with an edge. Returns the session, the edge's routing identity and the session id.
    pub(crate) async fn session(&self) -> (peernet_networks::Session, zeromq::Identity, Id) {
        self.session_of_version(PROTOCOL).await
    }

    pub(crate) async fn session_of_version(
        &self,
        version: u16,
    ) -> (peernet_networks::Session, zeromq::Identity, Id) {
        let address = self.address.clone();
        let edge = tokio::spawn(async move { open(&address, hello(), settings()).await });
        let (edge_identity, header) = self.receive_message().await;
        assert!(matches!(header, Header::Open { .. }));
        let id = Id::from([3; 16]);
        // The edge must ignore a goodbye before the session is accepted.
        self.send_message(
            &edge_identity,
            &Header::Goodbye { session: id.clone(), reason: String::new(), ordered: None },
            Vec::new(),
        )
        .await;
        self.send_message(&edge_identity, &Self::accepted(id.clone(), version), Vec::new()).await;
        (within(edge).await.expect("no panic").expect("accepted"), edge_identity, id)
    }
}
