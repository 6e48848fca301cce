//! Tests of hosts with real time daemons: chrony's claims and the exchanges are shown side by side.

use std::path::Path;

use peernet_clock::Span;
use peernet_tests::network::{Network, TimeDaemons, WireProperties};
use peernet_tests::truth::{Delay, HostClock, Iteration, compare, true_delay};
use peernet_tests::{Process, TwoHostTestbed, wait_until};
use serde_json::Value;

use super::{assert_contains_truth, faults, print_line};

/// Clock identity by which the machine's clock counts as a separate clock.
const EDGE_IDENTITY: &str = "clock_identity = \"edge\"\n";

/// Number of delays to be examined, both directions together.
const MIN_DELAYS: u64 = 600;

/// Beginning of the text of a daemon that is synchronised. The server of the tests has stratum 10, and its address
/// begins with `10.`.
const SYNCHRONISED: &str = "chrony, stratum 11, to 10.";

/// Whether the edge trusts the claims of the time daemons.
#[derive(Clone, Copy, PartialEq)]
enum Trust {
    Trusted,
    NotTrusted,
}

/// Two hosts whose time daemons are synchronised, and a pipeline that runs until the edge is stopped.
struct TimeDaemonTestbed {
    edge: Process,
    _cloud: Process,
    _daemons: TimeDaemons,
    hosts: TwoHostTestbed,
}

impl TimeDaemonTestbed {
    /// Starts the hosts. `identity` and `faults` are the edge's. A clock with injected faults has a separate identity
    /// by itself.
    fn new(network: impl FnOnce(&Path) -> Network, identity: &str, faults: &str, trust: Trust) -> Self {
        let hosts = TwoHostTestbed::new(network);
        let daemons = TimeDaemons::start(&hosts.network, hosts.folder());
        let clock = TimeDaemons::table();
        let cloud = hosts.start_cloud(&clock);
        let load = "load = { mode = \"rate\", hz = 50.0 }\nmax_in_flight = 64";
        let pipeline = hosts.pipeline("kept", 1000, load);
        let trust = if trust == Trust::Trusted { "trust_time_daemons = true\n" } else { "" };
        let edge = hosts.start_edge(&format!("{identity}{clock}{trust}{faults}{pipeline}"), &[]);
        Self { edge, _cloud: cloud, _daemons: daemons, hosts }
    }

    /// Waits until the link has a claim of chrony and this verdict; returns the offset.
    fn wait_for_offset(&self, verdict: &str) -> Value {
        self.hosts.api.wait_until("/api/v1/links/edge~cloud", |link| {
            let offset = &link["now"]["offset"];
            let sources = offset["sources"].as_array()?.iter().map(|source| &source["source"]);
            let has_both = sources.eq(["in-band", "chrony"]);
            (has_both && offset["verdict"] == verdict).then(|| offset.clone())
        })
    }

    /// Waits until the aggregator shows a text of a host's time daemon that begins like this. The offset of the link
    /// may be shown earlier.
    fn wait_for_daemon(&self, host: &str, beginning: &str) {
        self.hosts.api.wait_until(&format!("/api/v1/hosts/{host}"), |host| {
            host["clock"]["text"].as_str().is_some_and(|text| text.starts_with(beginning)).then_some(())
        });
    }

    /// Waits until [`MIN_DELAYS`] more delays that fulfil an SQL condition are stored, and stops the edge. Returns all
    /// iterations.
    fn stop_with_iterations(self, condition: &str) -> Vec<Iteration> {
        let sql = format!(
            "SELECT count(*) FROM transit AS t LEFT JOIN verdict ON verdict.id = t.verdict \
             LEFT JOIN source ON source.id = t.source WHERE {condition}"
        );
        let count = || self.hosts.query_database(&sql).trim().parse::<u64>().expect("a number");
        let before = count();
        wait_until(condition, || (count() >= before + MIN_DELAYS).then_some(()));
        assert_eq!(self.edge.stop().code(), 0);
        self.hosts
            .api
            .wait_until("/api/v1/runs", |runs| (runs["runs"][0]["reason"] == "stopped").then_some(()));
        self.hosts.iterations()
    }
}

/// Returns the bounds of the offset from one source.
fn bounds_of_source(offset: &Value, source: &str) -> (Span, Span) {
    let sources = offset["sources"].as_array().expect("a list");
    let source_bounds =
        sources.iter().find(|candidate| candidate["source"] == source).expect("the offset has this source");
    let bound = |name: &str| Span::from_seconds_f64(source_bounds[name].as_f64().expect("a number"));
    let bounds = (bound("lo_s"), bound("hi_s"));
    print_line(&format!("  {source} alone: {} to {}", bounds.0, bounds.1));
    bounds
}

fn contains((lo, hi): (Span, Span), offset: Span) -> bool {
    lo <= offset && offset <= hi
}

/// Runs a case with the machine's clock on both hosts: the true offset is zero.
fn check_correct_clocks(case: &str, network: impl FnOnce(&Path) -> Network, condition: &str) {
    let testbed = TimeDaemonTestbed::new(network, EDGE_IDENTITY, "", Trust::Trusted);
    let offset = testbed.wait_for_offset("ok");
    for source in ["in-band", "chrony"] {
        assert!(contains(bounds_of_source(&offset, source), Span::ZERO), "{source}: {offset}");
    }
    for host in ["edge", "cloud"] {
        testbed.wait_for_daemon(host, SYNCHRONISED);
    }
    let iterations = testbed.stop_with_iterations(condition);
    let of_kernel = HostClock::of_kernel();
    let (up, down) = assert_contains_truth(case, &iterations, &of_kernel, &of_kernel);
    for comparison in [&up, &down] {
        assert!(comparison.without_value.is_empty(), "{case}: {:?}", comparison.without_value);
    }
}

#[test]
fn right_daemons_agree_with_exchanges() {
    check_correct_clocks("chrony, a cable", |_| Network::direct(), "verdict.text IN ('ok', 'limited')");
}

/// The daemons' server is not behind the wire, so the daemons can measure the wire's asymmetry.
#[test]
fn correct_claims_bound_delays_on_asymmetric_path() {
    let wire_direction = |delay_ms| WireProperties { delay_ms, jitter_ms: 0, loss_percent: 0 };
    let wire = |folder: &Path| Network::wire(folder, wire_direction(40), wire_direction(5));
    check_correct_clocks("chrony, 40 ms up, 5 ms down", wire, "source.text IN ('chrony', 'intersection')");
}

/// The edge's daemon synchronises the machine's clock and does not know that the agent reads another one: this looks
/// like a peer that lies in all exchanges.
#[test]
fn wrong_clock_with_confident_daemon_is_detected() {
    const AHEAD: Span = Span::from_millis(50);
    let fault = faults(50.0, 0.0, "discipline = \"unaware\"");
    let testbed = TimeDaemonTestbed::new(|_| Network::direct(), "", &fault, Trust::Trusted);
    let offset = testbed.wait_for_offset("inconsistent");
    let (in_band, chrony) = (bounds_of_source(&offset, "in-band"), bounds_of_source(&offset, "chrony"));
    // The offset is that of the cloud's clock from the edge's clock, which is ahead.
    assert!(contains(in_band, -AHEAD) && !contains(in_band, Span::ZERO), "{offset}");
    assert!(contains(chrony, Span::ZERO) && !contains(chrony, -AHEAD), "{offset}");

    let iterations = testbed.stop_with_iterations("verdict.text = 'inconsistent'");
    let delays = iterations.iter().flat_map(|iteration| [&iteration.up, &iteration.down]);
    let contradictory = delays.filter(|delay| is_contradictory(delay)).count() as u64;
    print_line(&format!(
        "unaware by {AHEAD}: {contradictory} of {} delays are contradictory",
        2 * iterations.len()
    ));
    assert!(contradictory >= MIN_DELAYS);
}

/// Returns whether a delay is reported as contradictory, and checks that only a delay that is not
/// contradictory has a value and bounds. Such a delay was judged by the exchanges only, before the
/// daemons' claims were known.
fn is_contradictory(delay: &Delay) -> bool {
    let contradictory = delay.verdict == "inconsistent";
    let report = (delay.value.is_some(), delay.bounds.is_some(), delay.source.as_str());
    assert_eq!(report, (!contradictory, !contradictory, "in-band"), "{delay:?}");
    contradictory
}

/// The edge's daemon is as wrong as in `wrong_clock_with_confident_daemon_is_detected`, but it is not trusted.
#[test]
fn wrong_claim_affects_delays_only_if_trusted() {
    let fault = faults(50.0, 0.0, "discipline = \"unaware\"");
    let testbed = TimeDaemonTestbed::new(|_| Network::direct(), "", &fault, Trust::NotTrusted);
    for host in ["edge", "cloud"] {
        testbed.wait_for_daemon(host, SYNCHRONISED);
    }
    let edge = testbed.hosts.clock_of("edge");
    let sources = testbed.hosts.api.wait_until("/api/v1/links/edge~cloud", |link| {
        let offset = &link["now"]["offset"];
        (offset["verdict"] == "ok").then(|| offset["sources"].as_array().cloned())?
    });
    assert!(!sources.is_empty(), "the offset has no source");
    assert!(sources.iter().all(|source| source["source"] == "in-band"), "{sources:?}");
    let iterations = testbed.stop_with_iterations("verdict.text IN ('ok', 'limited')");
    assert_contains_truth("a wrong claim, not trusted", &iterations, &edge, &HostClock::of_kernel());
}

/// Starts hosts whose daemons claim less than a millisecond while the clocks differ by ten: within the bounds of the
/// exchanges on 5/40 ms.
fn start_with_irrefutable_wrong_claims(trust: Trust) -> TimeDaemonTestbed {
    let wire_direction = |delay_ms| WireProperties { delay_ms, jitter_ms: 0, loss_percent: 0 };
    let wire = |folder: &Path| Network::wire(folder, wire_direction(5), wire_direction(40));
    let testbed = TimeDaemonTestbed::new(wire, "", &faults(-10.0, 0.0, "discipline = \"unaware\""), trust);
    for host in ["edge", "cloud"] {
        testbed.wait_for_daemon(host, SYNCHRONISED);
    }
    testbed
}

/// Waits until the page of the link contains this text.
fn wait_for_page(testbed: &TimeDaemonTestbed, text: &str) {
    wait_until(text, || testbed.hosts.api.get("/links/edge~cloud").filter(|(_, page)| page.contains(text)));
}

#[test]
fn untrusted_claims_within_round_trip_affect_nothing() {
    let testbed = start_with_irrefutable_wrong_claims(Trust::NotTrusted);
    let edge = testbed.hosts.clock_of("edge");
    wait_for_page(&testbed, "as claimed by chrony on both hosts, of the wall clocks, not used");
    let iterations =
        testbed.stop_with_iterations("source.text = 'in-band' AND verdict.text IN ('ok', 'limited')");
    let case = "claims wrong by 10 ms, 5/40 ms, not trusted";
    let (up, down) = assert_contains_truth(case, &iterations, &edge, &HostClock::of_kernel());
    assert!(up.without_value.is_empty() && down.without_value.is_empty(), "{:?}", up.without_value);
    assert!(
        iterations
            .iter()
            .all(|iteration| iteration.up.source == "in-band" && iteration.down.source == "in-band")
    );
}

#[test]
fn delays_by_trusted_claims_are_marked() {
    let testbed = start_with_irrefutable_wrong_claims(Trust::Trusted);
    let edge = testbed.hosts.clock_of("edge");
    wait_for_page(&testbed, "bounds as claimed by chrony");
    let iterations = testbed.stop_with_iterations("source.text = 'chrony'");
    let of_kernel = HostClock::of_kernel();
    let (up, down) = compare(&iterations, &edge, &of_kernel);
    print_line(&format!("claims wrong by 10 ms, 5/40 ms, trusted, upload: {}", up.summary()));
    print_line(&format!("claims wrong by 10 ms, 5/40 ms, trusted, download: {}", down.summary()));
    // Half of the delays suffice, because an interval from a wrong claim may still contain the truth.
    assert!(
        up.outside.len() + down.outside.len() >= MIN_DELAYS as usize / 2,
        "too few intervals miss the truth, although the claims are wrong"
    );
    for iteration in &iterations {
        for (delay, clocks) in [(&iteration.up, [&edge, &of_kernel]), (&iteration.down, [&of_kernel, &edge])]
        {
            let truth = true_delay(delay, clocks[0], clocks[1]);
            let contains_truth = delay.bounds.is_none_or(|bounds| contains(bounds, truth));
            assert!(
                contains_truth || ["chrony", "intersection"].contains(&delay.source.as_str()),
                "{truth}: {delay:?}"
            );
        }
    }
}
