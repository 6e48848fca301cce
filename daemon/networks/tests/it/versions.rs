//! Tests with peers of other versions.

use peernet_networks::{OpenError, SESSION_VERSIONS};
use zeromq::Options;

use crate::fake_cloud::FakeCloud;
use crate::support::{Cloud, accepted, hello, open, settings, within};
use crate::wire::{self, Header, Id, PROTOCOL, PlainSocket};

const NEWEST: u16 = 6;

/// Returns the hello of an edge that speaks other versions, with names that this version does not know.
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
async fn later_edge_is_served_in_common_version() {
    let mut cloud = Cloud::start().await;
    let plain = PlainSocket::dealer(&cloud.address(), Options::default()).await;
    plain.send_message(&hello_of_later_release(PROTOCOL - 1, PROTOCOL + 3), Vec::new()).await;
    let wish = cloud.next_open().await;
    assert_eq!(wish.hello.versions.newest(), PROTOCOL + 3);
    assert!(wish.accept(accepted(cloud.host)));
    let (Header::Accepted { protocol, .. }, _) = plain.receive_message().await else {
        panic!("not accepted")
    };
    assert_eq!(protocol, NEWEST);
}

/// Nothing connects to such a socket, and the session is opened all the same.
#[tokio::test]
async fn malformed_clock_socket_name_is_ignored() {
    let mut cloud = Cloud::start().await;
    let plain = PlainSocket::dealer(&cloud.address(), Options::default()).await;
    let good = "peernet-clock-000102030405060708090a0b0c0d0e0f";
    let long = format!("{good}{}", "0".repeat(10_000));
    let names = [
        good,
        "",
        "peernet-clock-",
        "peernet-clock-/run/docker.sock",
        "/run/systemd/notify",
        "\0peernet-clock-000102030405060708090a0b0c0d0e0f",
        "peernet-probe-000102030405060708090a0b0c0d0e0f",
        &long,
    ];
    for name in names {
        let hello = wire::Hello { clock_socket: Some(name.to_owned()), ..wire::hello(PROTOCOL) };
        plain.send_message(&Header::Open { hello, max_message_bytes: 1_000_000 }, Vec::new()).await;
        let wish = cloud.next_open().await;
        let taken = wish.hello.clock_socket.map(|name| name.to_string());
        assert_eq!(taken.as_deref(), (name == good).then_some(good));
    }
}

#[tokio::test]
async fn edge_without_common_version_is_refused_with_release() {
    let mut cloud = Cloud::start().await;
    let plain = PlainSocket::dealer(&cloud.address(), Options::default()).await;
    let mut unreadable = wire::hello(PROTOCOL + 5);
    unreadable.name = "names may have spaces then".into();
    let unreadable = Header::Open { hello: unreadable, max_message_bytes: 1 };
    for (said, needed) in [
        (wire::open(PROTOCOL - 1), "version 3: update the edge to at least PEERNet 0.1.0"),
        (
            hello_of_later_release(PROTOCOL + 5, PROTOCOL + 6),
            "versions 9 to 10: update the cloud to at least PEERNet 0.9.0",
        ),
        (unreadable, "version 9: update the cloud to at least the release of the edge"),
    ] {
        plain.send_message(&said, Vec::new()).await;
        let (header, _) = tokio::select! {
            received = plain.receive_message() => received,
            incoming = cloud.next() => panic!("handed out {incoming:?}"),
        };
        let Header::Refused { protocol, newest, since, kind, reason } = header else { panic!("{header:?}") };
        assert_eq!((protocol, newest, since), (PROTOCOL, Some(NEWEST), Some((0, 1, 0))));
        assert_eq!(kind, "incompatible");
        let (spoken, update) = needed.split_once(": ").expect("two parts");
        assert!(reason.contains(spoken) && reason.ends_with(update), "{reason}");
    }
}

/// Returns the result of an edge for a cloud's answer, and the hello that it sent.
async fn open_with_answer(answer: Header) -> (Result<(), OpenError>, wire::Hello, String) {
    let cloud = FakeCloud::start().await;
    let address = cloud.address.clone();
    let edge = tokio::spawn(async move { open(&address, hello(), settings()).await });
    let (to, Header::Open { hello, .. }) = cloud.receive_message().await else { panic!("no hello") };
    cloud.send_message(&to, &answer, Vec::new()).await;
    let opened = within(edge).await.expect("no panic").map(|_| ());
    (opened, hello, cloud.address.to_string())
}

#[tokio::test]
async fn edge_states_its_versions() {
    let (opened, hello, _) = open_with_answer(FakeCloud::accepted(Id::from([3; 16]), PROTOCOL)).await;
    assert_eq!(opened, Ok(()));
    assert_eq!((hello.protocol, hello.newest), (SESSION_VERSIONS.oldest(), Some(SESSION_VERSIONS.newest())));
    assert_eq!(hello.since, Some((0, 1, 0)));
}

#[tokio::test]
async fn refused_edge_says_what_to_update() {
    let refused = |protocol, newest, since| {
        let (kind, reason) = ("incompatible".into(), "words of the cloud".into());
        Header::Refused { protocol, newest, since, kind, reason }
    };
    let (opened, _, address) = open_with_answer(refused(7, Some(8), Some((0, 4, 0)))).await;
    assert_eq!(
        opened.expect_err("refused").to_string(),
        format!(
            "this program speaks versions 4 to 6 of the session protocol, the cloud at {address} versions 7 to 8: update this \
             program to at least PEERNet 0.4.0"
        )
    );
    // The answers of PEERNet 0.1.0 and older builds.
    let (opened, _, address) = open_with_answer(refused(3, None, None)).await;
    assert_eq!(
        opened.expect_err("refused").to_string(),
        format!(
            "the cloud at {address} speaks version 3 of the session protocol, this program versions 4 to 6: update the cloud at \
             {address} to at least PEERNet 0.1.0"
        )
    );
    let (opened, ..) = open_with_answer(FakeCloud::accepted(Id::from([3; 16]), NEWEST + 1)).await;
    assert!(
        matches!(opened, Err(OpenError::Incompatible { .. })),
        "a version that was not offered: {opened:?}"
    );
    let (opened, ..) = open_with_answer(refused(PROTOCOL, None, None)).await;
    assert!(
        matches!(&opened, Err(OpenError::Refused { reason, .. }) if reason == "words of the cloud"),
        "{opened:?}"
    );
}
