//! Test of a network that passes data and blocks probes.

use peernet_tests::{Network, Plant};

use super::{hold_to_the_truth, rehearsal};

#[test]
fn without_probes_the_data_itself_bounds_its_delays() {
    let plant = Plant::new(|_| Network::direct());
    plant.network.cloud().block_udp(8620);
    let _cloud = plant.cloud(&rehearsal(1_000.0, 40.0, ""));
    let load = "load = { mode = \"rate\", hz = 50.0 }\nlimit = { iterations = 300 }";
    let _edge = plant.edge(&plant.pipeline("alone", 1000, load), &[]);
    let cloud = plant.clock_of("cloud");
    plant.finished(1);
    let iterations = plant.iterations();
    let edge = peernet_tests::truth::HostClock::kernels();
    let (up, down) = hold_to_the_truth("probes blocked", &iterations, &edge, &cloud);
    let all = iterations.len();
    assert_eq!((all, up.compared, down.compared), (305, all, all));
    let probes = plant.ask("SELECT sum(probes_sent) > 10, sum(probes_answered) FROM clock_sample");
    assert_eq!(probes.trim(), "1|0", "probes were sent, and none came back");
}
