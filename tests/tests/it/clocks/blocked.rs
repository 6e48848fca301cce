//! Test of a network that passes data and blocks probes.

use peernet_tests::{Network, TwoHostTestbed};

use super::{assert_contains_truth, faults};

#[test]
fn data_messages_bound_delays_without_probes() {
    let testbed = TwoHostTestbed::new(|_| Network::direct());
    testbed.network.cloud().block_udp(8620);
    let _cloud = testbed.start_cloud(&faults(1_000.0, 40.0, ""));
    let load = "load = { mode = \"rate\", hz = 50.0 }\nlimit = { iterations = 300 }";
    let _edge = testbed.start_edge(&testbed.pipeline("alone", 1000, load), &[]);
    let cloud = testbed.clock_of("cloud");
    testbed.wait_for_runs(1);
    let iterations = testbed.iterations();
    let edge = peernet_tests::truth::HostClock::of_kernel();
    let (up, down) = assert_contains_truth("probes blocked", &iterations, &edge, &cloud);
    let count = iterations.len();
    // The warm-up adds 5 iterations to the limit of 300.
    assert_eq!((count, up.compared, down.compared), (305, count, count));
    let probes =
        testbed.query_database("SELECT sum(probes_sent) > 10, sum(probes_answered) FROM clock_sample");
    assert_eq!(probes.trim(), "1|0", "probes were sent, and none came back");
}
