//! Tests of links in the live state: their number is bounded, their history follows the edge's clock, and they are kept
//! while the edge is disconnected.

use peernet_clock::{ClockFaultStep, ClockFaults, DelaySource, ExchangeCounts, Interval, Offset, Verdict};
use peernet_stream::{ClockSample, DelayPoint, DelaySecond, LinkLive, NetworkName, ProbeCounts, Probing};

use super::*;
use crate::live::MAX_HOST_LINKS;
use crate::live_state::LinkSnapshot;

/// Returns the state of a link in the second that ends `end_s` seconds after the start.
fn link(peer: HostId, name: &str, end_s: f64, lost: u32) -> LinkLive {
    LinkLive {
        peer,
        peer_name: slug(name),
        networks: vec!["zmq-tcp".into()],
        pipelines: vec![slug("line")],
        same_clock: false,
        probing: Probing::Off("a test".into()),
        edge: None,
        cloud: None,
        latest_sample: ClockSample {
            peer,
            peer_name: slug(name),
            at: wall(end_s),
            relation_period: 7,
            max_drift_ppm: 50.0,
            upper: None,
            lower: None,
            offset: None,
            probes: ProbeCounts { sent: 10, answered: 10 - lost, lost, refused: 0 },
            exchanges: ExchangeCounts::default(),
            round_trip: None,
            up: None,
            down: None,
            network: NetworkName::default(),
            basis: None,
        },
        connections: Vec::new(),
        reflector: None,
    }
}

/// Applies an update with these links, sent at `at` on both clocks.
fn report(testbed: &mut Testbed, at: f64, links: Vec<LinkLive>) {
    let LiveEvent::Update(mut event) = update(testbed.host, wall(at), vec![]) else { panic!("an update") };
    event.links = links;
    assert!(testbed.live.apply(LiveEvent::Update(event), now(at)));
}

/// Returns each point of the history: its second since the start, and the number of lost probes.
fn seconds(link: &LinkSnapshot) -> Vec<(i64, u32)> {
    link.history.iter().map(|point| (point.at.unix_seconds() - START, point.probes.lost)).collect()
}

#[test]
fn repeated_report_replaces_point_and_history_is_bounded() {
    let mut testbed = Testbed::new();
    let cloud = HostId::random();
    for second in 0..700 {
        for (fraction, lost) in [(0.3, 0), (0.9, 1)] {
            let at = f64::from(second) + fraction;
            report(&mut testbed, at, vec![link(cloud, "cloud", f64::from(second) + 1.0, lost)]);
        }
    }
    let snapshot = testbed.snapshot(699.9);
    let [shown] = &snapshot.links[..] else { panic!("one link") };
    assert_eq!((shown.edge, shown.edge_name.as_str(), shown.connected), (testbed.host, "edge", true));
    assert_eq!((shown.last_seen, shown.live.latest_sample.at), (wall(699.9), wall(700.0)));
    let history = seconds(shown);
    assert_eq!((history.len(), history[0], history[599]), (600, (101, 1), (700, 1)));
    assert_eq!(snapshot.hosts[0].live_left_out, 0);
}

#[test]
fn links_are_disconnected_with_edge_or_when_unreported() {
    let mut testbed = Testbed::new();
    let (first_cloud, second_cloud) = (HostId::random(), HostId::random());
    report(&mut testbed, 0.5, vec![link(second_cloud, "b", 1.0, 0), link(first_cloud, "a", 1.0, 0)]);
    let names = |snapshot: &LiveState| {
        let name = |link: &Arc<LinkSnapshot>| (link.live.peer_name.to_string(), link.connected);
        snapshot.links.iter().map(name).collect::<Vec<_>>()
    };
    assert_eq!(names(&testbed.snapshot(0.6)), [("a".to_owned(), true), ("b".to_owned(), true)]);
    report(&mut testbed, 1.5, vec![link(first_cloud, "a", 2.0, 0)]);
    assert_eq!(names(&testbed.snapshot(1.6)), [("a".to_owned(), true), ("b".to_owned(), false)]);
    assert!(testbed.live.expire(now(6.0)));
    assert_eq!(names(&testbed.snapshot(6.0)), [("a".to_owned(), false), ("b".to_owned(), false)]);
    report(&mut testbed, 7.5, vec![link(first_cloud, "c", 8.0, 0), link(second_cloud, "b", 8.0, 0)]);
    assert_eq!(names(&testbed.snapshot(7.6)), [("b".to_owned(), true), ("c".to_owned(), true)]);
    assert_eq!(seconds(&testbed.snapshot(7.6).links[1]), [(1, 0), (2, 0), (8, 0)]);
    assert!(testbed.live.apply(LiveEvent::Goodbye(testbed.host), now(8.0)));
    assert!(testbed.snapshot(8.0).links.iter().all(|link| !link.connected));
    testbed.live.expire(now(3_700.0));
    assert!(testbed.snapshot(3_700.0).links.is_empty(), "forgotten after a long absence");
}

#[test]
fn clock_set_back_keeps_earlier_link_history() {
    let mut testbed = Testbed::new();
    let cloud = HostId::random();
    for second in 0..10 {
        report(&mut testbed, f64::from(second) + 0.5, vec![link(cloud, "cloud", f64::from(second) + 1.0, 0)]);
    }
    // The clock is set back by 5 s.
    let LiveEvent::Update(mut event) = update(testbed.host, wall(5.5), vec![]) else { panic!("an update") };
    event.links = vec![link(cloud, "cloud", 6.0, 9)];
    testbed.live.apply(LiveEvent::Update(event), now(10.5));
    let history = seconds(&testbed.snapshot(10.5).links[0]);
    assert_eq!(history, [(1, 0), (2, 0), (3, 0), (4, 0), (5, 0), (6, 9)]);
}

#[test]
fn two_networks_of_one_pair_are_two_links() {
    let (mut testbed, cloud) = (Testbed::new(), HostId::random());
    let link_over = |network: &str, lost| {
        let network: NetworkName = network.parse().expect("a name");
        let mut link = link(cloud, "cloud", 1.0, lost);
        link.latest_sample.network = network;
        link
    };
    report(&mut testbed, 0.5, vec![link_over("zmq-udp", 3), link_over("zmq-tcp", 1)]);
    report(&mut testbed, 0.6, vec![link_over("zmq-udp", 4)]);
    let snapshot = testbed.snapshot(0.6);
    let shown = snapshot.links.iter().map(|link| {
        (link.live.network().to_string(), link.live.peer, link.live.latest_sample.probes.lost, link.connected)
    });
    let expected = [("zmq-tcp".to_owned(), cloud, 1, false), ("zmq-udp".to_owned(), cloud, 4, true)];
    assert_eq!(shown.collect::<Vec<_>>(), expected, "each link has its own counts");
}

#[test]
fn reported_link_is_first_of_its_name() {
    let mut testbed = Testbed::new();
    // The order of the ids is the opposite of the expected order.
    let [old, new] = [1, 2].map(|byte| HostId::from_bytes([byte; 16]));
    report(&mut testbed, 0.5, vec![link(old, "cloud", 1.0, 0)]);
    report(&mut testbed, 1.5, vec![link(new, "cloud", 2.0, 0)]);
    let snapshot = testbed.snapshot(1.6);
    assert_eq!(snapshot.links.iter().map(|link| link.live.peer).collect::<Vec<_>>(), [new, old]);
}

#[test]
fn excess_links_and_texts_are_cut_and_counted() {
    let mut testbed = Testbed::new();
    let mut links: Vec<LinkLive> =
        (0..1_000).map(|n| link(HostId::random(), &format!("c{n}"), 1.0, 0)).collect();
    let long = "ä".repeat(100_000);
    let steps = vec![ClockFaultStep::wall_step(Span::ZERO, Span::ZERO); 1_000];
    let clock = HostClock {
        text: long.clone(),
        faults: Some(ClockFaults { offset: Span::ZERO, drift_ppm: 0.0, steps, since: wall(0.0) }),
        ..HostClock::default()
    };
    let oversized = &mut links[0];
    oversized.networks = vec![long.clone(); 1_000];
    oversized.pipelines = vec![slug("line"); 1_000];
    oversized.probing = Probing::On { address: long.clone(), rate_hz: f64::NAN, stamps: long };
    (oversized.edge, oversized.cloud) = (Some(clock.clone()), Some(clock.clone()));
    let peer = oversized.peer;
    let LiveEvent::Update(mut event) = update(testbed.host, wall(0.5), vec![]) else { panic!("an update") };
    (event.links, event.clock) = (links, clock);
    testbed.live.apply(LiveEvent::Update(event), now(0.5));
    let snapshot = testbed.snapshot(0.5);
    assert_eq!(snapshot.links.len(), MAX_HOST_LINKS);
    let shown = snapshot.links.iter().find(|link| link.live.peer == peer).expect("the first link");
    assert!(serde_json::to_string(&**shown).expect("serialises").len() < 64 * 1024);
    assert_eq!((shown.live.networks.len(), shown.live.pipelines.len()), (32, 32));
    assert!(snapshot.hosts[0].clock.text.len() <= 512 && snapshot.hosts[0].clock.text.starts_with('ä'));
    // Five lists of 1,000 items are cut to 32: the networks and the pipelines of the link, and the steps of its two
    // clocks and of the clock of the update.
    let left_out = 1_000 - MAX_HOST_LINKS as u64 + 5 * (1_000 - 32);
    assert_eq!(snapshot.hosts[0].live_left_out, left_out);
}

#[test]
fn impossible_clock_values_are_not_shown() {
    let mut testbed = Testbed::new();
    let interval = |lo, hi| Interval { lo: Span::from_millis(lo), hi: Span::from_millis(hi) };
    let link_with_extreme_time = |unix_nanos: i64| {
        let mut link = link(HostId::random(), "cloud", 1.0, 0);
        link.latest_sample.at = WallTime::from_unix_nanos(unix_nanos);
        link
    };
    let mut links: Vec<LinkLive> = [i64::MIN, i64::MAX, 0].map(link_with_extreme_time).into();
    let mut inverted = link(HostId::random(), "inverted", 1.0, 0);
    inverted.latest_sample.offset = Some(Offset {
        at: wall(1.0),
        estimate: Span::ZERO,
        bounds: interval(1, -1),
        source: DelaySource::InBand,
        sources: vec![(DelaySource::InBand, interval(1, -1)); 1_000],
        verdict: Verdict::Ok,
        skew_ppm: Some(f64::NAN),
        exchanges: 0,
        age: None,
    });
    let median = DelayPoint { value: Span::from_millis(-1), bounds: interval(-2, 0), bits_per_second: None };
    inverted.latest_sample.up = Some(DelaySecond { count: 1, median: Some(median), verdict: Verdict::Ok });
    let mut crowded = link(HostId::random(), "crowded", 1.0, 0);
    crowded.latest_sample.offset = inverted.latest_sample.offset.clone().map(|offset| Offset {
        bounds: interval(-1, 1),
        sources: vec![(DelaySource::InBand, interval(-1, 1)); 1_000],
        ..offset
    });
    links.extend([inverted, crowded]);
    report(&mut testbed, 0.5, links);
    let snapshot = testbed.snapshot(0.5);
    let shown = |name: &str| {
        snapshot.links.iter().filter(|link| link.live.peer_name.as_str() == name).cloned().collect::<Vec<_>>()
    };
    assert!(shown("cloud").iter().all(|link| link.history.is_empty()) && shown("cloud").len() == 3);
    let point = &shown("inverted")[0].history[0];
    assert_eq!((&point.offset, point.up.expect("judged").median), (&None, None));
    let offset = shown("crowded")[0].live.latest_sample.offset.clone().expect("known");
    assert_eq!((offset.sources.len(), offset.skew_ppm), (1, None));
    // The times of three links, and values of `inverted` and of `crowded`.
    assert_eq!(snapshot.hosts[0].live_left_out, 5);
}
