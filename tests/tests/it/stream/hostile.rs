//! Tests of peers that send invalid messages to a real aggregator, while a normal agent is connected.

use peernet_stream::{ToAgent, ToAggregator, codec};
use peernet_tests::fleet::{agent_configuration, echo_pipeline, rate_load};
use peernet_tests::{
    Fleet, InventedHost, MisbehavingPeer, TestRng, record_measurements, thousands, wait_until,
};

use super::{assert_nothing_lost, wait_for_turn};

/// Starts a fleet whose agent measures during the test.
fn start_fleet() -> Fleet {
    let mut fleet =
        Fleet::new(&["edge"], &agent_configuration("", &echo_pipeline("loop", &rate_load(200.0))));
    fleet.start(0);
    fleet.wait_for_counts(0, "something is stored", |counts| counts.stored > 0);
    fleet
}

/// Checks that the normal agent lost nothing and that the aggregator exits with 0. Returns the number of spooled
/// iterations.
fn assert_agent_lost_nothing(mut fleet: Fleet) -> u64 {
    let before = fleet.wait_for_counts(0, "the agent reports", |_| true);
    fleet.wait_for_counts(0, "more is stored", |counts| counts.stored > before.stored + 100);
    fleet.agents[0].stop();
    fleet.deliver_spool(0).assert_balanced();
    let mut stored_events = fleet.stop();
    stored_events.hosts.retain(|name, _| name == "edge");
    assert_nothing_lost(&fleet, &stored_events)
}

/// Returns the sum of a counter over all its labels, by the beginning of its name; 0 if there is no
/// such counter.
fn counter(fleet: &Fleet, name: &str) -> u64 {
    let (status, text) = fleet.api.get("/metrics").expect("the aggregator answers");
    assert_eq!(status, 200, "{text}");
    let lines = text.lines().filter(|line| line.starts_with(name));
    let values = lines.map(|line| {
        let value = line.rsplit_once(' ').and_then(|(_, value)| value.parse::<f64>().ok());
        value.unwrap_or_else(|| panic!("{line:?} does not end with a value"))
    });
    values.sum::<f64>() as u64
}

#[test]
fn damaged_frames_are_refused_and_counted() {
    let _turn = wait_for_turn();
    let mut rng = TestRng::new("damaged frames");
    let fleet = start_fleet();
    let misbehaving_peer = MisbehavingPeer::connect(fleet.deployment.events_port);
    let mut host = InventedHost::new("stranger", &mut rng);
    host.open_session(&misbehaving_peer);
    misbehaving_peer.send(&host.batch(10));
    misbehaving_peer.wait_for_ack(1);

    // Neither beginnings of messages nor noise are valid messages.
    let hello = codec::encode(&ToAggregator::Hello(host.hello.clone()));
    let next = host.batch(10);
    let mut sent = 0;
    for _ in 0..300 {
        let original = if rng.once_in(2) { &hello } else { &next };
        let mut frame = original[..rng.below(original.len())].to_vec();
        if rng.once_in(3) {
            frame.iter_mut().for_each(|byte| *byte = rng.bits() as u8);
        }
        misbehaving_peer.send(&frame);
        sent += 1;
    }
    // Afterwards the batch itself is accepted, perhaps after another hello.
    host.open_session(&misbehaving_peer);
    misbehaving_peer.send(&next);
    misbehaving_peer.wait_for_ack(2);

    // The aggregator notices a flipped bit in any part of a batch.
    for _ in 0..300 {
        let mut frame = next.clone();
        let index = rng.below(frame.len());
        frame[index] ^= 1 << rng.below(8);
        misbehaving_peer.send(&frame);
        sent += 1;
    }
    misbehaving_peer.send_hello_until(&host, |message| matches!(message, ToAgent::Welcome { stored: 2, .. }));
    wait_until("damaged batches are counted", || {
        (counter(&fleet, "peernet_aggregator_damaged_batches_total") > 0).then_some(())
    });
    let damaged = counter(&fleet, "peernet_aggregator_damaged_batches_total");
    let line = fleet.aggregator.process().wait_for("messages were rejected");
    assert!(line.contains("unreadable="), "{line}");
    misbehaving_peer.send_message(&ToAggregator::Goodbye(host.hello.host.id));
    let spooled = assert_agent_lost_nothing(fleet);
    record_measurements(
        "damaged frames",
        &[
            ("sent", thousands(f64::from(sent))),
            ("recognised by their hash", thousands(damaged as f64)),
            ("iterations of the normal agent, spooled and stored", thousands(spooled as f64)),
        ],
    );
}

#[test]
fn invalid_batch_is_quarantined_and_stream_continues() {
    let _turn = wait_for_turn();
    let mut rng = TestRng::new("wrong batches");
    let fleet = start_fleet();
    let misbehaving_peer = MisbehavingPeer::connect(fleet.deployment.events_port);
    let mut host = InventedHost::new("stranger", &mut rng);
    host.open_session(&misbehaving_peer);

    // Batches with correct hashes, but with an invalid body or an invalid number of events.
    let noise: Vec<u8> = (0..10_000).map(|_| rng.bits() as u8).collect();
    // A whole batch is not a valid body. The clone makes it, so that the stream of `host` does not advance.
    let whole_batch = host.clone().batch(1);
    let invalid_batches =
        [(7, noise.clone(), false), (u32::MAX, noise, true), (3, whole_batch, false), (0, vec![], false)];
    for (number, (events, body, compress)) in (1..).zip(invalid_batches) {
        let batch = host.batch_of(events, &body, compress);
        misbehaving_peer.send(&batch);
        misbehaving_peer.wait_for_ack(number);
    }
    misbehaving_peer.send(&host.batch(10));
    misbehaving_peer.wait_for_ack(5);
    // The bytes never match their hash, however often they are sent. After some arrivals, the aggregator quarantines
    // and acknowledges the batch.
    let mut damaged = host.batch(10);
    let last = damaged.len() - 1;
    damaged[last] ^= 1;
    for _ in 0..8 {
        misbehaving_peer.send(&damaged);
    }
    misbehaving_peer.wait_for_ack(6);
    // Zeros whose unpacked size is four thousand times the packed one.
    misbehaving_peer.send(&host.batch_of(9, &vec![0; 64 << 20], true));
    misbehaving_peer.send(&host.batch(10));
    let stored = wait_until("quarantined batches", || {
        let stranger = fleet.api.json("/api/v1/hosts/stranger");
        let quarantined = stranger["stored"]["quarantined"].as_u64()?;
        (quarantined >= 4).then(|| stranger["stored"].clone())
    });
    assert!(stored["gaps"].as_u64() >= Some(4), "{stored}");
    // An impossible number of events in a batch is not counted as missing.
    assert!(stored["missing"].as_u64() < Some(1_000), "{stored}");
    assert_agent_lost_nothing(fleet);
}

#[test]
fn foreign_batches_are_refused_and_repeated_ones_ignored() {
    let _turn = wait_for_turn();
    let mut rng = TestRng::new("replayed batches");
    let fleet = start_fleet();
    let (own_peer, other_peer) = (
        MisbehavingPeer::connect(fleet.deployment.events_port),
        MisbehavingPeer::connect(fleet.deployment.events_port),
    );
    let mut host = InventedHost::new("victim", &mut rng);
    host.open_session(&own_peer);
    let batches: Vec<Vec<u8>> = (0..5).map(|_| host.batch(20)).collect();
    batches[..4].iter().for_each(|batch| own_peer.send(batch));
    own_peer.wait_for_ack(4);

    // Batches of another host, recorded and sent again: old batches and the next batch.
    for batch in &batches {
        other_peer.send(batch);
        other_peer.receive_until(|message| (*message == ToAgent::Unknown).then_some(()));
    }
    // Three hellos: one with the victim's stream, one with the victim's name, and one with neither.
    let mut thief = InventedHost::new("thief", &mut rng);
    thief.hello.stream = host.hello.stream;
    let reason = thief.expect_refusal(&other_peer);
    assert!(reason.contains(&host.hello.host.id.to_string()), "{reason}");
    let mut impostor = InventedHost::new("victim", &mut rng);
    let reason = impostor.expect_refusal(&other_peer);
    assert!(reason.contains("name"), "{reason}");
    impostor.hello.host.name = "impostor".parse().expect("a name");
    impostor.open_session(&other_peer);
    // A session of another host does not permit batches of the victim either.
    batches.iter().for_each(|batch| other_peer.send(batch));

    // The host itself may repeat batches.
    for batch in batches.iter().chain(&batches) {
        own_peer.send(batch);
    }
    own_peer.wait_for_ack(5);
    let stored = wait_until("all is stored and duplicates are counted", || {
        let victim = fleet.api.json("/api/v1/hosts/victim");
        let stored = &victim["stored"];
        // Repeated batches are visible at once, new batches with the first live update after their commit.
        let is_complete = stored["duplicates"].as_u64()? >= 8 && stored["events"].as_u64()? >= 100;
        is_complete.then(|| stored.clone())
    });
    assert_eq!((stored["events"].as_u64(), stored["gaps"].as_u64()), (Some(100), Some(0)), "{stored}");
    assert_agent_lost_nothing(fleet);
}

#[test]
fn hello_flood_excludes_no_agent() {
    let _turn = wait_for_turn();
    let mut rng = TestRng::new("hello storm");
    let fleet = start_fleet();
    let misbehaving_peer = MisbehavingPeer::connect(fleet.deployment.events_port);
    // More hosts than one connection may represent.
    for number in 0..200 {
        let host = InventedHost::new(&format!("crowd-{number}"), &mut rng);
        let is_answer =
            |message: &ToAgent| matches!(message, ToAgent::Welcome { .. } | ToAgent::Refused { .. });
        misbehaving_peer.send_hello_until(&host, is_answer);
    }
    let reason = InventedHost::new("one-more", &mut rng).expect_refusal(&misbehaving_peer);
    assert!(reason.contains("connection"), "{reason}");
    // Many connections, every second one with the normal agent's name. Each has a wrong version, a
    // long text, or an impossible number of the oldest batch.
    let peers: Vec<MisbehavingPeer> =
        (0..60).map(|_| MisbehavingPeer::connect(fleet.deployment.events_port)).collect();
    for (number, misbehaving_peer) in peers.iter().enumerate() {
        let name = if number % 2 == 0 { "edge" } else { "somebody" };
        let mut hello = InventedHost::new(name, &mut rng).hello;
        match number % 3 {
            0 => hello.protocol = u16::MAX,
            1 => hello.host.hardware.cpu = "x".repeat(3 << 20),
            _ => hello.oldest = u64::MAX,
        }
        for _ in 0..20 {
            misbehaving_peer.send_message(&ToAggregator::Hello(hello.clone()));
        }
    }
    let reason = peers[0].wait_for_refusal();
    assert!(reason.contains("version"), "{reason}");
    wait_until("refusals are shown", || {
        let hosts = fleet.api.json("/api/v1/hosts");
        (!hosts["refused"].as_array()?.is_empty()).then_some(())
    });
    wait_until("refusals are counted", || {
        (counter(&fleet, "peernet_aggregator_refused_hosts") > 0).then_some(())
    });
    assert_agent_lost_nothing(fleet);
}
