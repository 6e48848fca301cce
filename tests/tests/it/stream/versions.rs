//! Test of agents with other versions of the event stream at a real aggregator.

use peernet_stream::{Hello, HelloExtension, Release, STREAM_VERSIONS, ToAgent, ToAggregator, codec};
use peernet_tests::{Fleet, InventedHost, MisbehavingPeer, TestRng, wait_until};

use super::wait_for_turn;

/// Returns a hello of a later version, whose extension has a name that this version does not know.
fn encode_later_hello(hello: &Hello) -> Vec<u8> {
    let encode = |extension| rmp_serde::to_vec(&extension).expect("plain data serialises");
    let mut frame = codec::encode(&ToAggregator::Hello(hello.clone()));
    // The extension is a map and the last value of the frame. The first byte of the map contains the number of entries.
    let map = frame.len() - encode(hello.extension).len();
    frame[map] += 1;
    for text in ["colour", "green"] {
        frame.extend(rmp_serde::to_vec(text).expect("plain data serialises"));
    }
    frame
}

#[test]
fn newer_agent_is_served_unknown_versions_refused() {
    let _turn = wait_for_turn();
    let mut rng = TestRng::new("other versions");
    let mut fleet = Fleet::new(&[], "");
    let newest = STREAM_VERSIONS.newest();
    let since = Some(Release(0, 9, 0));

    let mut later_host = InventedHost::new("later", &mut rng);
    later_host.hello.extension = Some(HelloExtension { newest: Some(newest + 4), since });
    let misbehaving_peer = MisbehavingPeer::connect(fleet.deployment.events_port);
    misbehaving_peer.send(&encode_later_hello(&later_host.hello));
    let challenge = misbehaving_peer.receive();
    // A challenge without a version means the version `protocol` of the hello.
    let ToAgent::Challenge { version, .. } = challenge else { panic!("{challenge:?}") };
    assert_eq!(version.unwrap_or(later_host.hello.protocol), newest, "the newest version that both support");
    misbehaving_peer.answer_challenge(&later_host.hello, &later_host.secret, &challenge);
    misbehaving_peer.receive_until(|message| matches!(message, ToAgent::Welcome { .. }).then_some(()));
    misbehaving_peer.send(&later_host.batch(3));
    misbehaving_peer.wait_for_ack(1);

    let mut too_new = InventedHost::new("too-new", &mut rng);
    too_new.hello.protocol = newest + 3;
    too_new.hello.extension = Some(HelloExtension { newest: Some(newest + 4), since });
    let reason = too_new.expect_refusal(&misbehaving_peer);
    assert!(reason.ends_with("update the aggregator to at least PEERNet 0.9.0"), "{reason}");
    let mut too_old = InventedHost::new("too-old", &mut rng);
    too_old.hello.protocol = STREAM_VERSIONS.oldest() - 1;
    let reason = too_old.expect_refusal(&misbehaving_peer);
    assert!(reason.contains("update the agent on too-old to at least PEERNet"), "{reason}");

    wait_until("both refusals are shown with the remedy", || {
        let hosts = fleet.api.json("/api/v1/hosts");
        let reasons: Vec<_> =
            hosts["refused"].as_array()?.iter().map(|host| host["reason"].as_str()).collect();
        let is_reported =
            |host: &str| reasons.iter().flatten().any(|reason| reason.contains(&format!("update {host}")));
        (is_reported("the aggregator") && is_reported("the agent on too-old")).then_some(())
    });
    let stored_events = fleet.stop();
    assert_eq!(stored_events.hosts["later"].quarantined, 0, "{stored_events:?}");
}
