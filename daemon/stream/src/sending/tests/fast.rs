//! Fast links: flow control must not reduce the throughput.

use super::super::Compression;
use super::link::{Link, LinkSettings};
use super::*;

/// Number of events of 16 KiB per second, more than any of the stores accepts.
const EVENTS_PER_S: i64 = 1_500;

fn long(n: i64) -> String {
    format!("{n:16384}")
}

/// Returns the agents' usual configuration without compression.
fn usual() -> SendingConfig {
    SendingConfig {
        window: 32,
        first_pause: Span::from_seconds(1),
        compression: Compression::Never,
        ..SendingConfig::default()
    }
}

/// Returns the number of events stored within four seconds on a connection that is two seconds old, with a backlog.
fn stored(setting: LinkSettings) -> u64 {
    let mut link = Link::new(usual(), setting);
    link.run(4);
    link.connect();
    link.run(2);
    let before = link.stored;
    link.run(4);
    assert_eq!((link.repeated, link.hellos), (0, 1), "(batches, greetings) that came again");
    assert!(link.agent.accounting().waiting > 0, "there was something to send all the time");
    link.stored - before
}

#[test]
fn fast_link_is_limited_by_store_only() {
    // Bytes per second; then in milliseconds the one-way delay, the duration of a commit, and the time per second in
    // which the aggregator's host is busy with other work.
    for (bytes_per_s, one_way, commit, deaf) in
        [(1_250_000_000, 0, 300, 0), (1_250_000_000, 10, 300, 50), (12_500_000, 1, 10, 50)]
    {
        let setting = LinkSettings {
            bytes_per_s,
            one_way,
            step: 1,
            commit,
            deaf,
            controlled: true,
            events_per_s: EVENTS_PER_S,
            text: long,
        };
        let with = stored(setting);
        let without = stored(LinkSettings { controlled: false, ..setting });
        let seen = format!(
            "{bytes_per_s} B/s, {one_way} ms, commits of {commit} ms, {deaf} ms away: {with} events, {without} without \
             control"
        );
        println!("{seen}");
        // One commit more or less makes a difference of some percent.
        assert!(10 * with >= 9 * without, "{seen}");
    }
}

/// Returns the milliseconds from the connection until two megabytes are stored.
fn begun(setting: LinkSettings) -> i64 {
    let mut link = Link::new(usual(), setting);
    link.run(1);
    link.connect();
    let connected = link.agent.millis;
    while link.stored < 128 {
        link.step();
    }
    link.agent.millis - connected
}

#[test]
fn window_grows_to_capacity_of_link() {
    for one_way in [0, 1, 10, 25] {
        let setting = LinkSettings {
            bytes_per_s: 1_250_000_000,
            one_way,
            step: 1,
            commit: 1,
            deaf: 0,
            controlled: true,
            events_per_s: EVENTS_PER_S,
            text: long,
        };
        let (with, without) = (begun(setting), begun(LinkSettings { controlled: false, ..setting }));
        println!("{one_way} ms: after {with} ms, {without} ms without control");
        // The allowance begins with 4 KiB and doubles: a megabyte after eight round trips.
        assert!(
            with <= without + 10 * (2 * one_way + 1),
            "{one_way} ms: after {with} ms, {without} ms without"
        );
    }
}
