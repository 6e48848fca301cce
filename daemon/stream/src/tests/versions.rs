//! Agents of other versions.

use super::super::codec::{decode, encode};
use super::admission::{expect_refusal, expect_welcome, hello, record_with};
use super::*;

/// Returns the hello of an agent that supports other versions.
fn hello_of(oldest: u16, extension: Option<HelloExtension>) -> Hello {
    let hello = hello(HostId::random(), "edge", 1, StreamId::random(), 1);
    Hello { protocol: oldest, extension, ..hello }
}

fn extension(newest: u16) -> Option<HelloExtension> {
    Some(HelloExtension { newest: Some(newest), since: Some(Release(0, 9, 0)) })
}

/// Returns the version in the challenge to a hello.
fn chosen_version(hello: &Hello) -> Option<u16> {
    let mut challenges = Challenges::new("base".parse().expect("a name"));
    match challenges.challenge(1, hello.clone(), false, Nonce::from_bytes([5; 32]), at(0).mono) {
        ToAgent::Challenge { version, .. } => version,
        other => panic!("expected a challenge, got {other:?}"),
    }
}

#[test]
fn agent_of_first_version_gets_only_messages_of_that_version() {
    let old = hello_of(5, None);
    assert_eq!((chosen_version(&old), HelloExtension::from_versions(&VersionRange::single(5))), (None, None));
    expect_welcome(&receiving().handle_hello(&old, record_with(None), at(0).mono));
    let frame = encode(&ToAggregator::Hello(old.clone()));
    assert_eq!(decode(&frame), Ok(ToAggregator::Hello(old)));
}

#[test]
fn later_agent_is_served_in_newest_common_version() {
    let newest = STREAM_VERSIONS.newest();
    let later = hello_of(STREAM_VERSIONS.oldest(), extension(newest + 3));
    expect_welcome(&receiving().handle_hello(&later, record_with(None), at(0).mono));
    let (oldest, version) = (later.protocol, chosen_version(&later));
    assert_eq!(version.unwrap_or(oldest), newest);
    assert_eq!(chosen_version(&hello_of(newest - 1, extension(newest + 1))), Some(newest));
}

#[test]
fn unknown_keys_of_hello_extension_are_ignored() {
    let later = hello_of(STREAM_VERSIONS.oldest(), extension(9));
    let mut frame = encode(&ToAggregator::Hello(later.clone()));
    // The extension is a map with two keys and the last value in the frame. A key can therefore be appended to the
    // frame.
    let mut extension = Vec::new();
    codec::encode_into(&mut extension, &later.extension);
    let map_start = frame.len() - extension.len();
    assert_eq!((&frame[map_start..], frame[map_start]), (&extension[..], 0x82));
    frame[map_start] += 1;
    codec::encode_into(&mut frame, &"colour");
    codec::encode_into(&mut frame, &["green"]);
    assert_eq!(decode(&frame), Ok(ToAggregator::Hello(later)));
}

#[test]
fn agent_without_common_version_is_refused_with_release() {
    let refusal = |hello: Hello| {
        let stated_reason = expect_refusal(receiving().handle_hello(&hello, record_with(None), at(0).mono));
        assert_eq!(Receiving::version_refusal(&hello), Some(stated_reason.clone()));
        stated_reason
    };
    assert_eq!(
        refusal(hello_of(4, None)),
        "the agent on edge speaks version 4 of the event stream, the aggregator speaks versions 5 to 7: update the \
         agent on edge to at least PEERNet 0.1.0"
    );
    assert_eq!(
        refusal(hello_of(8, extension(9))),
        "the aggregator speaks versions 5 to 7 of the event stream, the agent on edge speaks versions 8 to 9: update the \
         aggregator to at least PEERNet 0.9.0"
    );
}

#[test]
fn proof_covers_newest_version_of_hello() {
    let (secret, nonce) = (HostSecret::random(), Nonce::from_bytes([5; 32]));
    let (hello, aggregator) = (hello_of(5, extension(6)), "base".parse().expect("a name"));
    let proof = secret.prove(&nonce, &hello, &aggregator);
    assert!(secret.verify(&proof, &nonce, &hello, &aggregator));
    for newest in [None, extension(5), extension(7)] {
        let changed = Hello { extension: newest, ..hello.clone() };
        assert!(!secret.verify(&proof, &nonce, &changed, &aggregator), "{newest:?}");
    }
}
