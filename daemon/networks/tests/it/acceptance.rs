//! Tests of the values in hello and acceptance, except for the identities of the hosts.

use peernet_networks::MAX_CONDITIONS;
use peernet_stream::{Condition, Grade, Hardware};
use zeromq::Options;

use crate::fake_cloud::FakeCloud;
use crate::support::{Cloud, accepted, hello, open, settings, within};
use crate::wire::{self, Header, Id, PROTOCOL, PlainSocket};

#[tokio::test]
async fn hello_without_model_lets_cloud_choose_model() {
    let mut cloud = Cloud::start().await;
    let plain_socket = PlainSocket::dealer(&cloud.address(), Options::default()).await;
    let hello = wire::Hello { model: None, ..wire::hello(PROTOCOL) };
    plain_socket.send_message(&Header::Open { hello, max_message_bytes: 1_000_000 }, Vec::new()).await;
    let open_request = cloud.next_open().await;
    assert_eq!(open_request.hello.model, None);
    open_request.accept(accepted(cloud.host));
    let (Header::Accepted { accepted, .. }, _) = plain_socket.receive_message().await else {
        panic!("not accepted")
    };
    assert_eq!(accepted.model, "echo", "the cloud says which model it has chosen");
}

fn condition(host: &str) -> wire::Condition {
    wire::Condition {
        host: host.into(),
        about: "CPU governor".into(),
        found: "powersave\n\u{1b}[2J".into(),
        grade: "doubtful".into(),
        advice: "set it to performance".into(),
    }
}

/// Returns an acceptance with these conditions.
fn accepted_with_conditions(session: Id, conditions: Vec<wire::Condition>) -> Header {
    match FakeCloud::accepted(session, PROTOCOL) {
        Header::Accepted { protocol, session, accepted, max_message_bytes, max_in_flight } => {
            let accepted = wire::Accepted { conditions, ..accepted };
            Header::Accepted { protocol, session, accepted, max_message_bytes, max_in_flight }
        }
        header => header,
    }
}

#[tokio::test]
async fn conditions_of_cloud_are_bounded_and_printable() {
    let cloud = FakeCloud::start().await;
    let address = cloud.address.clone();
    let edge = tokio::spawn(async move { open(&address, hello(), settings()).await });
    let (edge_identity, _) = cloud.receive_message().await;
    let id = Id::from([3; 16]);
    // The edge ignores an acceptance with too many conditions.
    let too_many = accepted_with_conditions(id.clone(), vec![condition("too many"); MAX_CONDITIONS + 1]);
    cloud.send_message(&edge_identity, &too_many, Vec::new()).await;
    cloud
        .send_message(
            &edge_identity,
            &accepted_with_conditions(id, vec![condition("fake"); MAX_CONDITIONS]),
            Vec::new(),
        )
        .await;
    let session = within(edge).await.expect("no panic").expect("accepted");
    let expected = Condition {
        host: "fake".into(),
        about: "CPU governor".into(),
        found: "powersave  [2J".into(),
        grade: Grade::Doubtful,
        advice: "set it to performance".into(),
    };
    assert_eq!(session.accepted().conditions, vec![expected; MAX_CONDITIONS]);
}

#[tokio::test]
async fn hardware_of_cloud_is_bounded_and_printable() {
    let cloud = FakeCloud::start().await;
    let address = cloud.address.clone();
    let edge = tokio::spawn(async move { open(&address, hello(), settings()).await });
    let (edge_identity, _) = cloud.receive_message().await;
    let Header::Accepted { protocol, session, accepted, max_message_bytes, max_in_flight } =
        FakeCloud::accepted(Id::from([3; 16]), PROTOCOL)
    else {
        panic!("not accepted")
    };
    let hardware = wire::Hardware {
        cpu: "x".repeat(5_000),
        cores: 64,
        memory_bytes: 1 << 40,
        gpus: vec!["a card\u{1b}[2J".into(); 5_000],
        system: "a system".into(),
        architecture: "x86_64".into(),
    };
    let accepted = wire::Accepted { hardware: Box::new(hardware), ..accepted };
    let answer = Header::Accepted { protocol, session, accepted, max_message_bytes, max_in_flight };
    cloud.send_message(&edge_identity, &answer, Vec::new()).await;
    let session = within(edge).await.expect("no panic").expect("accepted");
    let expected = Hardware {
        cpu: "x".repeat(128),
        cores: 64,
        memory_bytes: 1 << 40,
        gpus: vec!["a card [2J".into(); 16],
        system: "a system".into(),
        architecture: "x86_64".into(),
    };
    assert_eq!(session.accepted().hardware, expected);
}
