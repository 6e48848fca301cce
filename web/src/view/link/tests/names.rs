//! Tests of the names of links.

use super::super::*;
use crate::tests::samples::link;

#[test]
fn link_is_found_by_names_of_both_hosts() {
    let snapshot = peernet_aggregator::LiveState {
        links: vec![std::sync::Arc::new(link(Some(0.00065), &[]))],
        ..crate::tests::samples::snapshot(Vec::new(), Vec::new())
    };
    assert!(find(&snapshot, "cam-1~rack-a").is_some());
    for other in ["rack-a~cam-1", "cam-1", "cam-1~", "~", "cam-1~rack-a~"] {
        assert!(find(&snapshot, other).is_none(), "{other}");
    }
}

#[test]
fn name_of_link_omits_zmq_tcp() {
    let udp: NetworkName = "zmq-udp".parse().expect("a name");
    assert_eq!(name("cam-1", "rack-a", &NetworkName::default()), "cam-1~rack-a");
    assert_eq!(name("cam-1", "rack-a", &udp), "cam-1~rack-a~zmq-udp");
    for (wanted, same) in [
        ("cam-1~rack-a", "cam-1~rack-a"),
        ("cam-1~rack-a~zmq-tcp", "cam-1~rack-a"),
        ("cam-1~rack-a~zmq-udp", "cam-1~rack-a~zmq-udp"),
        ("cam-1", "cam-1"),
        ("cam-1~rack-a~zmq-udp~", "cam-1~rack-a~zmq-udp~"),
    ] {
        assert_eq!(canonical(wanted.to_owned()), same);
    }
}

#[test]
fn placement_uses_link_over_its_network() {
    let mut live_state = crate::tests::samples::snapshot(Vec::new(), Vec::new());
    live_state.links = vec![Arc::new(crate::tests::samples::link_over_udp(None))];
    let placement = |network: Option<&str>| Placement {
        kind: PlacementKind::Remote,
        peer: "rack-a".parse().ok(),
        network: network.map(str::to_owned),
        ..Placement::sensor_alone()
    };
    let page = |network| href_of_placement(&live_state, "cam-1", &placement(network));
    assert_eq!(page(Some("zmq-udp")).as_deref(), Some("/links/cam-1~rack-a~zmq-udp"));
    assert_eq!((page(Some("zmq-tcp")), page(None), page(Some("~"))), (None, None, None));
}
