//! Tests with peers of other versions.

use peernet_networks::{OpenError, SESSION_VERSIONS};
use zeromq::Options;

use crate::fake_cloud::FakeCloud;
use crate::support::{Cloud, accepted, hello, open, settings, within};
use crate::wire::{self, Header, Id, PROTOCOL, PlainSocket};

/// Newest version of the session protocol that this release speaks.
const NEWEST_VERSION: u16 = 6;

/// Returns the hello of an edge of a later release, with a field that this release does not know. Release 0.9.0 is the
/// first that speaks the version `oldest`.
fn hello_of_later_release(oldest: u16, newest: u16) -> Header {
    let hello = wire::Hello {
        newest: Some(newest),
        since: Some((0, 9, 0)),
        colour: Some("green".into()),
        ..wire::hello(oldest)
    };
    Header::Open { hello, max_message_bytes: 1_000_000 }
}

#[tokio::test]
async fn edge_of_later_release_is_served_in_common_version() {
    let mut cloud = Cloud::start().await;
    let plain_socket = PlainSocket::dealer(&cloud.address(), Options::default()).await;
    plain_socket.send_message(&hello_of_later_release(PROTOCOL - 1, PROTOCOL + 3), Vec::new()).await;
    let open_request = cloud.next_open().await;
    assert_eq!(open_request.hello.versions.newest(), PROTOCOL + 3);
    assert!(open_request.accept(accepted(cloud.host)));
    let (Header::Accepted { protocol, .. }, _) = plain_socket.receive_message().await else {
        panic!("not accepted")
    };
    assert_eq!(protocol, NEWEST_VERSION);
}

/// The cloud connects to no socket with such a name, and the session is opened nevertheless.
#[tokio::test]
async fn malformed_clock_socket_name_is_ignored() {
    let mut cloud = Cloud::start().await;
    let plain_socket = PlainSocket::dealer(&cloud.address(), Options::default()).await;
    let valid_name = "peernet-clock-000102030405060708090a0b0c0d0e0f";
    let long_name = format!("{valid_name}{}", "0".repeat(10_000));
    let names = [
        valid_name,
        "",
        "peernet-clock-",
        "peernet-clock-/run/docker.sock",
        "/run/systemd/notify",
        "\0peernet-clock-000102030405060708090a0b0c0d0e0f",
        "peernet-probe-000102030405060708090a0b0c0d0e0f",
        &long_name,
    ];
    for name in names {
        let hello = wire::Hello { clock_socket: Some(name.to_owned()), ..wire::hello(PROTOCOL) };
        plain_socket.send_message(&Header::Open { hello, max_message_bytes: 1_000_000 }, Vec::new()).await;
        let open_request = cloud.next_open().await;
        let accepted_name = open_request.hello.clock_socket.map(|name| name.to_string());
        assert_eq!(accepted_name.as_deref(), (name == valid_name).then_some(valid_name));
    }
}

#[tokio::test]
async fn edge_without_common_version_is_refused_with_release() {
    let mut cloud = Cloud::start().await;
    let plain_socket = PlainSocket::dealer(&cloud.address(), Options::default()).await;
    let mut unreadable_hello = wire::hello(PROTOCOL + 5);
    unreadable_hello.name = "names may have spaces then".into();
    let unreadable_hello = Header::Open { hello: unreadable_hello, max_message_bytes: 1 };
    for (hello, expected_reason) in [
        (wire::open(PROTOCOL - 1), "version 3: update the edge to at least PEERNet 0.1.0"),
        (
            hello_of_later_release(PROTOCOL + 5, PROTOCOL + 6),
            "versions 9 to 10: update the cloud to at least PEERNet 0.9.0",
        ),
        (unreadable_hello, "version 9: update the cloud to at least the release of the edge"),
    ] {
        plain_socket.send_message(&hello, Vec::new()).await;
        let (header, _) = tokio::select! {
            received = plain_socket.receive_message() => received,
            incoming = cloud.next() => panic!("the listener returned {incoming:?}"),
        };
        let Header::Refused { protocol, newest, since, kind, reason } = header else { panic!("{header:?}") };
        assert_eq!((protocol, newest, since), (PROTOCOL, Some(NEWEST_VERSION), Some((0, 1, 0))));
        assert_eq!(kind, "incompatible");
        let (expected_versions, advice) = expected_reason.split_once(": ").expect("versions and advice");
        assert!(reason.contains(expected_versions) && reason.ends_with(advice), "{reason}");
    }
}

/// Opens a session at a cloud that sends this answer. Returns the result, the edge's hello and the cloud's address.
async fn open_with_answer(answer: Header) -> (Result<(), OpenError>, wire::Hello, String) {
    let cloud = FakeCloud::start().await;
    let address = cloud.address.clone();
    let edge = tokio::spawn(async move { open(&address, hello(), settings()).await });
    let (edge_identity, Header::Open { hello, .. }) = cloud.receive_message().await else {
        panic!("no hello")
    };
    cloud.send_message(&edge_identity, &answer, Vec::new()).await;
    let result = within(edge).await.expect("no panic").map(|_| ());
    (result, hello, cloud.address.to_string())
}

#[tokio::test]
async fn edge_states_its_versions() {
    let (result, hello, _) = open_with_answer(FakeCloud::accepted(Id::from([3; 16]), PROTOCOL)).await;
    assert_eq!(result, Ok(()));
    assert_eq!((hello.protocol, hello.newest), (SESSION_VERSIONS.oldest(), Some(SESSION_VERSIONS.newest())));
    assert_eq!(hello.since, Some((0, 1, 0)));
}

#[tokio::test]
async fn error_of_refused_edge_says_what_to_update() {
    let refusal = |protocol, newest, since| {
        let (kind, reason) = ("incompatible".into(), "words of the cloud".into());
        Header::Refused { protocol, newest, since, kind, reason }
    };
    let (result, _, address) = open_with_answer(refusal(7, Some(8), Some((0, 4, 0)))).await;
    assert_eq!(
        result.expect_err("refused").to_string(),
        format!(
            "this program speaks versions 4 to 6 of the session protocol, the cloud at {address} speaks versions 7 to 8: \
             update this program to at least PEERNet 0.4.0"
        )
    );
    // PEERNet 0.1.0 (version 4) and builds before it (version 3) state no range: `newest` and `since` are absent.
    let (result, _, address) = open_with_answer(refusal(3, None, None)).await;
    assert_eq!(
        result.expect_err("refused").to_string(),
        format!(
            "the cloud at {address} speaks version 3 of the session protocol, this program speaks versions 4 to 6: \
             update the cloud at {address} to at least PEERNet 0.1.0"
        )
    );
    let (result, ..) = open_with_answer(FakeCloud::accepted(Id::from([3; 16]), NEWEST_VERSION + 1)).await;
    assert!(
        matches!(result, Err(OpenError::Incompatible { .. })),
        "a version that was not offered: {result:?}"
    );
    // The edge speaks the stated version, so the cloud must have another reason.
    let (result, ..) = open_with_answer(refusal(PROTOCOL, None, None)).await;
    assert!(
        matches!(&result, Err(OpenError::Refused { reason, .. }) if reason == "words of the cloud"),
        "{result:?}"
    );
}
