//! Fast links: flow control must not reduce the throughput.

use super::super::Compression;
use super::link::{Link, LinkSettings};
use super::*;

/// Number of events that are offered per second, each of 16 KiB. No store in these tests accepts so many events.
const EVENTS_PER_S: i64 = 1_500;

fn long_text(n: i64) -> String {
    format!("{n:16384}")
}

/// Returns the agents' usual configuration without compression.
fn usual_config() -> SendingConfig {
    SendingConfig {
        window: 32,
        first_pause: Span::from_seconds(1),
        compression: Compression::Never,
        ..SendingConfig::default()
    }
}

/// Returns the number of events stored within four seconds on a connection that is two seconds old, with a backlog.
fn stored_events(settings: LinkSettings) -> u64 {
    let mut link = Link::new(usual_config(), settings);
    link.run(4);
    link.connect();
    link.run(2);
    let before = link.stored;
    link.run(4);
    assert_eq!((link.repeated, link.hellos), (0, 1), "(repeated batches, hellos)");
    assert!(link.agent.accounting().waiting > 0, "events wait all the time");
    link.stored - before
}

#[test]
fn fast_link_is_limited_by_store_only() {
    // Bytes per second; then in milliseconds the one-way delay, the duration of a commit, and the time per second in
    // which the aggregator's host is busy with other work.
    for (bytes_per_s, one_way_ms, commit_ms, busy_ms) in
        [(1_250_000_000, 0, 300, 0), (1_250_000_000, 10, 300, 50), (12_500_000, 1, 10, 50)]
    {
        let settings = LinkSettings {
            bytes_per_s,
            one_way_ms,
            step_ms: 1,
            commit_ms,
            busy_ms,
            is_flow_controlled: true,
            events_per_s: EVENTS_PER_S,
            text: long_text,
        };
        let controlled = stored_events(settings);
        let uncontrolled = stored_events(LinkSettings { is_flow_controlled: false, ..settings });
        let description = format!(
            "{bytes_per_s} B/s, {one_way_ms} ms, commits of {commit_ms} ms, host busy for {busy_ms} ms per second: \
             {controlled} events, {uncontrolled} without control"
        );
        println!("{description}");
        // One commit more or less makes a difference of some percent.
        assert!(10 * controlled >= 9 * uncontrolled, "{description}");
    }
}

/// Returns the number of milliseconds from the connection until two megabytes are stored.
fn millis_until_stored(settings: LinkSettings) -> i64 {
    let mut link = Link::new(usual_config(), settings);
    link.run(1);
    link.connect();
    let connected_at = link.agent.millis;
    while link.stored < 128 {
        link.step();
    }
    link.agent.millis - connected_at
}

#[test]
fn allowance_grows_to_capacity_of_link() {
    for one_way_ms in [0, 1, 10, 25] {
        let settings = LinkSettings {
            bytes_per_s: 1_250_000_000,
            one_way_ms,
            step_ms: 1,
            commit_ms: 1,
            busy_ms: 0,
            is_flow_controlled: true,
            events_per_s: EVENTS_PER_S,
            text: long_text,
        };
        let controlled = millis_until_stored(settings);
        let uncontrolled = millis_until_stored(LinkSettings { is_flow_controlled: false, ..settings });
        println!("{one_way_ms} ms: after {controlled} ms, {uncontrolled} ms without control");
        // The allowance begins with 4 KiB and doubles: a megabyte after eight round trips.
        assert!(
            controlled <= uncontrolled + 10 * (2 * one_way_ms + 1),
            "{one_way_ms} ms: after {controlled} ms, {uncontrolled} ms without control"
        );
    }
}
