//! Test of large payloads over a slow link: reported delays are compared with a capture at the router.

use peernet_clock::{Span, WallTime};
use peernet_tests::TwoHostTestbed;
use peernet_tests::network::{Host, Network, Packet};
use peernet_tests::truth::{Delay, HostClock};

use super::{assert_contains_truth, faults, print_line};

const ITERATIONS: usize = 15;

/// Returns the time from the first byte that enters the router to the last byte that leaves it, for a message in
/// transit from `sent` to `received`.
fn router_transit_time(packets: &[Packet], from: &Host, sent: WallTime, received: WallTime) -> Span {
    let is_of_message = |packet: &&Packet| {
        packet.source == from.address && packet.payload > 0 && (sent..=received).contains(&packet.at)
    };
    let first = packets
        .iter()
        .filter(is_of_message)
        .find(|packet| !packet.is_outgoing)
        .expect("a packet entered the router");
    let last = packets
        .iter()
        .filter(is_of_message)
        .rfind(|packet| packet.is_outgoing)
        .expect("a packet left the router");
    last.at - first.at
}

#[test]
fn large_transfer_time_matches_capture() {
    let testbed = TwoHostTestbed::new(|_| Network::routed());
    let router = testbed.network.router();
    router.limit_rate("cloud", 20);
    router.limit_rate("edge", 100);
    let capture = router.capture("tcp port 5551", testbed.folder());
    let _cloud = testbed.start_cloud(&faults(1_000.0, 30.0, ""));
    let limit = format!("limit = {{ iterations = {ITERATIONS} }}\nwarm_up = {{ iterations = 2 }}");
    let pipeline = testbed.pipeline("images", 1_200_000, &limit);
    let _edge = testbed.start_edge(&format!("{}{pipeline}", faults(-1_000.0, -15.0, "")), &[]);
    let (edge, cloud) = (testbed.clock_of("edge"), testbed.clock_of("cloud"));
    testbed.wait_for_runs(1);
    let packets = capture.finish();
    let iterations = &testbed.iterations()[2..];
    assert_eq!(iterations.len(), ITERATIONS);
    assert_contains_truth("1.2 MB, 20 Mbit/s up, 100 Mbit/s down", iterations, &edge, &cloud);

    let network = &testbed.network;
    assert_delays_match_capture(
        "upload",
        iterations.iter().map(|iteration| &iteration.up),
        network.edge(),
        &packets,
        [&edge, &cloud],
    );
    assert_delays_match_capture(
        "download",
        iterations.iter().map(|iteration| &iteration.down),
        network.cloud(),
        &packets,
        [&cloud, &edge],
    );
}

/// Checks that reported delays match captured ones, message by message. A busy machine can delay a program after the last
/// byte has passed; the median of the ratios is robust against a few such pauses.
fn assert_delays_match_capture<'a>(
    direction: &str,
    delays: impl Iterator<Item = &'a Delay>,
    from: &Host,
    packets: &[Packet],
    [sender, receiver]: [&HostClock; 2],
) {
    let pairs = delays.map(|delay| {
        let captured =
            router_transit_time(packets, from, sender.truth(delay.sent), receiver.truth(delay.received));
        (delay.value.expect("a value").seconds(), captured.seconds())
    });
    let pairs: Vec<(f64, f64)> = pairs.collect();
    let mean =
        |field: fn(&(f64, f64)) -> f64| 1e3 * pairs.iter().map(field).sum::<f64>() / pairs.len() as f64;
    let mut ratios: Vec<f64> = pairs.iter().map(|(reported, captured)| reported / captured).collect();
    ratios.sort_by(f64::total_cmp);
    let median = ratios[ratios.len() / 2];
    let (reported, captured) = (mean(|pair| pair.0), mean(|pair| pair.1));
    print_line(&format!(
        "{direction}: mean reported {reported:.3} ms, captured at the router {captured:.3} ms, ratio {:.4}, median {median:.4}",
        reported / captured
    ));
    assert!((median - 1.0).abs() <= 0.02, "{direction}: {median}");
}
